"""Work of `foveate train`."""

import os
import sys
from pathlib import Path

import jax

from foveate.cli.common import print_tables
from foveate.cli.train import Train
from foveate.errors import InputError
from foveate.evaluation.verdict import judge_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import PPOSettings, TrainingSettings
from foveate.experiment.overrides import with_changes
from foveate.experiment.presets import adjusted, for_long_horizons, rule_for
from foveate.experiment.resolve import experiment_from
from foveate.experiment.run_folder import BEST, CONFIG, Outcome
from foveate.learning.devices import ProcessLost, folder_of_this_process
from foveate.learning.run_files import stored_run
from foveate.learning.train import train, watched
from foveate.policies.pointer_settings import PointerSettings


def run(options: Train) -> int:
    """Train, and print how it went, with the verdict."""
    try:
        experiment, seed = _resumed(options) if options.resume is not None else (_begun(options), options.seed)
        if options.coordinator is not None and not isinstance(experiment.training, TrainingSettings):
            raise InputError("--coordinator: expected a training by the policy gradient")
        outcome = _train(experiment, options.folder, seed, options.resume is not None)
        status = _report(outcome, options.folder)
        if options.verdict and jax.process_index() == 0 and (options.folder / BEST).exists():
            _judge(options.folder, experiment)
        return status
    except ProcessLost as error:
        how = f"its last validation is kept: resume with  foveate train --resume {options.folder}"
        print(f"foveate: {error}; {how}", file=sys.stderr, flush=True)
        # Not by sys.exit, which would wait for the lost process.
        os._exit(1)


def _begun(options: Train) -> Experiment:
    """Experiment of the options."""
    if options.preset is not None and options.config is not None:
        raise InputError("--preset and --config: each is a whole experiment: give one of them")
    experiment = with_changes(
        experiment_from(options.config or options.preset or "paper"),
        [change for changes in options.set for change in changes],
    )
    budget = {name: getattr(options, name) for name in ("epochs", "episodes", "steps")}
    experiment = adjusted(experiment, options.algorithm, **budget)
    return for_long_horizons(experiment, options.remat, options.window)


def _resumed(options: Train) -> tuple[Experiment, int]:
    """Experiment and seed of the run to resume. Raises InputError for options that would change them."""
    for name in ("preset", "config", "set", "algorithm", "episodes", "steps", "out", "window", "remat"):
        if getattr(options, name) not in (None, False, ()):
            raise InputError(f"--{name} and --resume: a run resumes with its own settings")
    if options.epochs is not None and options.coordinator is not None:
        raise InputError("--epochs and --resume: expected a training of one process, without --coordinator")
    if options.seed != 0:
        raise InputError("--seed and --resume: a run resumes with its own seed")
    return stored_run(options.folder, options.epochs)


def _train(experiment: Experiment, out: Path, seed: int, resume: bool) -> Outcome:
    """Train; when interrupted or failed, print how to resume."""
    try:
        with (
            folder_of_this_process(out, resume) as folder,
            watched(experiment, str(out), quiet=jax.process_index() > 0) as report,
        ):
            return train(experiment, folder, seed, resume, report)
    except (KeyboardInterrupt, OSError) as error:
        by_hand = isinstance(error, KeyboardInterrupt)
        if by_hand or (out / CONFIG).exists():
            how = _resume_hint(out, isinstance(experiment.training, PPOSettings))
            print(f"{'interrupted' if by_hand else 'failed'}: {how}", file=sys.stderr)
        raise


def _resume_hint(out: Path, by_ppo: bool) -> str:
    """Describe what an unfinished training leaves."""
    if by_ppo:
        return "its best policy so far is kept" if (out / BEST).exists() else "it has no policy yet"
    if not (out / CONFIG).exists():
        return "nothing was trained yet"
    return f"its last validation is kept: resume with  foveate train --resume {out}"


def _report(outcome: Outcome, out: Path) -> int:
    best = f"best of {outcome.epochs} iterations at {outcome.best_epoch}, held-out score {outcome.best_score:.2f}"
    print(f"{out}: {best}")
    if outcome.rollbacks:
        print(f"{out}: collapsed and was rolled back to its best {outcome.rollbacks} times (metrics.jsonl says when)")
    if outcome.stopped:
        print(f"{out}: stopped early: {outcome.stopped}", file=sys.stderr)
    return 1 if outcome.stopped else 0


def _judge(out: Path, experiment: Experiment) -> None:
    """Print the verdict, and how to continue where a heuristic is not clearly beaten."""
    training, longer, how = experiment.training, "again, with more --steps", ""
    if not isinstance(training, PPOSettings):
        longer = f"foveate train --resume {out} --epochs {2 * training.epochs}"
        how = f"; the verdict follows with  foveate train --resume {out}"
    try:
        verdict = judge_run(out)
    except KeyboardInterrupt:
        print(f"interrupted: the training is complete{how}", file=sys.stderr)
        raise
    print_tables(verdict.table)
    print("\n".join(verdict.sentences))
    if not verdict.unbeaten:
        return
    print("To continue:")
    print(f"  train for longer:      {longer}")
    print("  train another policy:  with another --seed; keep the one with the best verdict")
    if "window" in verdict.unbeaten and _may_begin_at_window(experiment):
        print(f"  begin at window:       foveate train --config {out / CONFIG} --set policy.dynamic_window=true")
    team, has_ids = experiment.scenario.problem().team, experiment.scenario.detections is None
    if team is not None and (has_ids or team.radio.kind == "perfect") and not _assigns(experiment):
        rule, anew = rule_for(experiment.scenario), "" if experiment.begins_with is None else " policy.begin_with="
        print(f"  assign targets:        foveate evaluate {out} --scenes own --protocol true --method policy+hungarian")
        print(f"  train with these:      foveate train --config {out / CONFIG} --set policy.assignment={rule}{anew}")
    elif team is None and has_ids:
        print(f"  refine each decision:  foveate plan --run {out} --scenes own --refine 15")


def _assigns(experiment: Experiment) -> bool:
    return isinstance(experiment.policy, PointerSettings) and experiment.policy.assignment is not None


def _may_begin_at_window(experiment: Experiment) -> bool:
    network = experiment.network
    if not isinstance(network, PointerSettings) or network.dynamic_window or network.begin_with:
        return False
    return network.fits_window(experiment.scenario.problem())
