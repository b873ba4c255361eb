"""Write the files of a training at every validation, and read them back to resume it."""

import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from foveate.errors import InputError
from foveate.experiment.checkpoint import (
    accepted_digests,
    extend_config,
    load_tree,
    save_tree,
    stored_facts,
    write_config,
)
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import PPOSettings
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS, VERDICT, Validation, claim
from foveate.io.files import append_line, read_text, sole_writer, write_atomic
from foveate.io.strict_json import parse_json
from foveate.io.toml import read_toml
from foveate.learning.selection import Progress
from foveate.learning.tensorboard import Events
from foveate.simulation.records import Policy


@dataclass(frozen=True, kw_only=True)
class RunFiles:
    """Files of one training in its run folder `out`.

    `config_digest` is that of the stored config.toml, which an older version may have written differently (None: that
    of the experiment).
    """

    out: Path
    experiment: Experiment
    seed: int
    config_digest: str | None = None

    def save(self, progress: Progress, validation: Validation, events: Events) -> None:
        """Save a validated training."""
        if validation.best:
            self.save_best(progress.best.policy, validation)
        # The last file decides where a resumed training continues; if killed before it, all is written again.
        self.append(validation, events)
        self.save_last(progress, epoch=validation.epoch, elapsed_s=validation.elapsed_s)

    def save_best(self, policy: Policy, validation: Validation) -> None:
        """Save the best policy."""
        # No time in it: the same experiment and seed give the same file.
        facts = {"seed": self.seed, "epoch": validation.epoch, "held_out": validation.held_out}
        save_tree(self.out / BEST, policy, self.experiment, "policy", facts, self.config_digest)

    def append(self, validation: Validation, events: Events) -> None:
        """Append a validation to the metrics and the TensorBoard events."""
        # JSON has no NaN and no infinity, and TensorBoard draws none.
        row: dict[str, Any] = {
            name: None if isinstance(x, float) and not math.isfinite(x) else x for name, x in asdict(validation).items()
        }
        append_line(self.out / METRICS, json.dumps(row))
        names = ("objective", "gradient_norm", "held_out", "at_limit", "epochs_per_s")
        events.add({name: row[name] for name in names if row[name] is not None}, validation.epoch)

    def save_last(self, progress: Progress, epoch: int, elapsed_s: float) -> None:
        """Save the state that a resumed training continues from."""
        facts = {"seed": self.seed, "epoch": epoch, "elapsed_s": elapsed_s}
        save_tree(self.out / LAST, progress, self.experiment, "training", facts, self.config_digest)


def stored_run(run: Path, epochs: int | None = None) -> tuple[Experiment, int]:
    """Read experiment and seed of a run folder, to resume its training, up to `epochs` in all if given.

    Learning rates and action std then fall over the longer training. Raises InputError for a folder without a training
    that can be resumed, and unless it has done fewer than `epochs`.
    """
    if not (run / CONFIG).exists():
        raise InputError(f"{run}: holds no training to resume: begin one there")
    experiment, digest = read_toml(Experiment, run / CONFIG)
    if isinstance(experiment.training, PPOSettings):
        raise InputError(f"{run}: was trained by PPO, which cannot be resumed: train again")
    facts = stored_facts(run / LAST, "training")
    if epochs is not None:
        done = _fact(run / LAST, facts, "epoch", int)
        if epochs <= done:
            raise InputError(f"epochs {epochs}: expected more than the {done} that {run} has done")
        experiment = replace(experiment, training=replace(experiment.training, epochs=epochs))
        with sole_writer(run):
            (run / VERDICT).unlink(missing_ok=True)  # of the policy before
            extend_config(run, experiment, digest)
    return experiment, _fact(run / LAST, facts, "seed", int)


def start_run(out: Path, experiment: Experiment, seed: int, begun: Progress) -> tuple[RunFiles, Progress, float]:
    """Make the run folder and save the training before its first epoch; return its files, its state and 0 seconds."""
    claim(out, experiment)
    files = RunFiles(out=out, experiment=experiment, seed=seed)
    files.save_last(begun, epoch=0, elapsed_s=0.0)
    # Last, since it makes the folder a run: a training killed before has nothing to resume.
    write_config(out, experiment)
    return files, begun, 0.0


def resume_run(out: Path, experiment: Experiment, seed: int, begun: Progress) -> tuple[RunFiles, Progress, float]:
    """Read a training, in the structure of `begun`; return its files, its state and its duration so far [s].

    Lines of the metrics after that state are removed. Raises InputError for another experiment or seed.
    """
    stored, digest = read_toml(Experiment, out / CONFIG)
    if stored != experiment:
        raise InputError(f"{out}: is the run of another experiment: expected that of its {CONFIG}")
    progress, facts = load_tree(out / LAST, begun, "training", accepted_digests(out, digest))
    if (trained := _fact(out / LAST, facts, "seed", int)) != seed:
        raise InputError(f"{out}: was trained with seed {trained}: expected the same, got {seed}")
    lines = read_text(out / METRICS, "metrics of a run").splitlines()
    epochs = [_epoch_of(out, lines, i) for i in range(len(lines))]
    # Killed between the line of the untrained policy and its state, a training validates that policy again.
    done = int(progress.learner.epoch) if progress.is_validated else -1
    kept = [line for line, epoch in zip(lines, epochs, strict=True) if epoch <= done]
    write_atomic(out / METRICS, "".join(f"{line}\n" for line in kept).encode())
    files = RunFiles(out=out, experiment=experiment, seed=seed, config_digest=digest)
    return files, progress, float(_fact(out / LAST, facts, "elapsed_s", float, int))


def _fact(path: Path, facts: dict[str, Any], name: str, *kinds: type) -> Any:
    """A fact of a saved training. Raises InputError where there is none, or one of another type."""
    if type(facts.get(name)) not in kinds:
        raise InputError(f"{path}: facts: {name} = {facts.get(name)!r:.60}: expected a number, as foveate wrote it")
    return facts[name]


def _epoch_of(out: Path, lines: list[str], i: int) -> int | float:
    """The epoch of a line of metrics; infinite for a last line that was cut while it was written."""
    try:
        return int(parse_json(lines[i])["epoch"])
    except (ValueError, KeyError, TypeError) as error:
        if i < len(lines) - 1:
            raise InputError(f"{out / METRICS}: line {i + 1}: is damaged: delete it to resume without it") from error
        return float("inf")
