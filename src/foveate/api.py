"""Functions of Python programs and notebooks, one a command: load, train, evaluate, plan, fit, replay."""

import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from foveate.deploy.policy import TrainedPolicy
from foveate.errors import InputError
from foveate.evaluation.plan import PlanOptions, PlanSuite, evaluate_plans
from foveate.evaluation.report import Evaluation, evaluate_all
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import adjusted, for_long_horizons, for_scenario
from foveate.experiment.resolve import (
    Trained,
    experiment_from,
    methods_of,
    scenes_of,
    subject_of,
    with_initial_error,
)
from foveate.experiment.resolve import load as load_parts
from foveate.io.validate import check_count, seed_number
from foveate.learning import train as training
from foveate.names import InitialError, Learner, Preset
from foveate.recordings.compare import replay as replay
from foveate.recordings.fit import fit as fit
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import PROTOCOLS, Policy

Protocols = Literal["surrogate", "true", "both"]


def load(run: str | Path) -> TrainedPolicy:
    """Load the best policy of a run folder, or the trained policy that the package ships for a preset.

    Raises InputError, in one line, where there is neither, or a file of it is not what it should be.
    """
    experiment, network, facts = load_parts(run)
    return TrainedPolicy(name=str(run), experiment=experiment, network=network, facts=facts)


def train(
    world: Scenario | Experiment | str | Path = "paper",
    *,
    like: Preset = "true-view",
    algorithm: Learner | None = None,
    epochs: int | None = None,
    episodes: int | None = None,
    steps: int | None = None,
    remat: bool = False,
    window: int | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    progress: bool = True,
) -> TrainedPolicy:
    """Train a policy, and return the best of it by held-out scenes; warns where the training had to stop early.

    Args:
        world: a preset's name, a TOML file as `fit` writes it, a run folder, an `Experiment`, or a `Scenario`.
        like: preset whose network and learner a `Scenario` gets: "true-view" takes minutes, "paper" seconds.
        algorithm: another learner than `world` says.
        epochs: another number of them.
        episodes: another number in each epoch.
        steps: of PPO in place of epochs and episodes.
        remat: for long episodes, the same gradient in less memory.
        window: for long episodes, steps after which the gradient is cut off.
        seed: of weights and scenes.
        out: run folder to keep everything in; without it only the returned policy is left (see its `save`).
        resume: go on with the interrupted training in `out`.
        progress: show a bar on a terminal, a line at each tenth in a notebook.

    Raises:
        InputError: settings that do not fit, or `out` holds a run already.
    """
    seed_number(seed, "seed")
    if resume and out is None:
        raise InputError("resume: expected out, the run folder to go on with")
    experiment = for_scenario(world, like) if isinstance(world, Scenario) else experiment_from(world)
    experiment = for_long_horizons(adjusted(experiment, algorithm, epochs, episodes, steps), remat, window)
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            return _trained(experiment, Path(folder) / "run", "a policy", seed, resume, progress)
    return _trained(experiment, Path(out), str(out), seed, resume, progress)


def _trained(experiment: Experiment, out: Path, name: str, seed: int, resume: bool, progress: bool) -> TrainedPolicy:
    with training.watched(experiment, name, quiet=not progress) as report:
        outcome = training.train(experiment, out, seed, resume, report)
    if outcome.stopped:
        warnings.warn(f"{name}: the training stopped early: {outcome.stopped}", stacklevel=3)
    return replace(load(out), name=name)


def evaluate(
    policy: Trained | Policy | str | Path,
    scenes: str | Path | Sequence[Scene] | None = None,
    *,
    method: str | Sequence[str] = "policy",
    protocol: Protocols = "both",
    episodes: int = 1,
    seed: int = 0,
    scene_seed: int = 2023,
    initial_error: InitialError | None = None,
    scenario: Scenario | None = None,
    normalised: bool = False,
    progress: bool = True,
) -> Evaluation:
    """Evaluate a policy, and heuristics beside it, all on the same scenes with the same noise.

    Args:
        policy: a trained one, a run folder, a preset's name, or a `foveate.Policy` of your own with its `scenario`.
        scenes: a file, a list, "table1" (the paper's), or "own" (drawn from the scenario; default in space).
        method: "policy", "random", "still", "nearest", "uncertain", "lawnmower", several of them, or "all".
        protocol: how information is counted, softly as in the paper or by real measurements.
        episodes: runs of every scene.
        seed: of the noise.
        scene_seed: of the scenes of table1 or own.
        initial_error: of first means, as a measurement's or as the belief claims; None: as the scenario says.
        scenario: another one than the policy was trained for.
        normalised: also the score between lower bound (0) and omniscient planner (1), whose plans take minutes, once.
        progress: show a bar.
    """
    methods, protocols = methods_of(method), _protocols(protocol, episodes, seed, scene_seed)
    subject = subject_of(policy, scenario)
    subject = replace(subject, experiment=with_initial_error(subject.experiment, initial_error))
    chosen, known = scenes_of(scenes, scene_seed, subject.experiment)
    return evaluate_all(
        f"{subject.name} on {chosen}",
        {"run": subject.name, "scenes": chosen},
        subject.experiment,
        {name: subject.policy(name) for name in methods},
        known,
        protocols=protocols,
        episodes=episodes,
        seed=seed,
        normalised=normalised,
        quiet=not progress,
    )


def _protocols(protocol: str, episodes: int, seed: int, scene_seed: int) -> tuple[str, ...]:
    """The protocols that are meant; raises InputError for a wrong argument of an evaluation."""
    seed_number(seed, "seed")
    seed_number(scene_seed, "scene_seed")
    check_count(episodes, "episodes")
    if protocol not in (*PROTOCOLS, "both"):
        raise InputError(f"protocol {protocol!r}: expected surrogate, true or both")
    return tuple(PROTOCOLS) if protocol == "both" else (protocol,)


def plan(
    scenes: str | Path | Sequence[Scene] | None = None,
    *,
    world: Scenario | Experiment | str | Path = "paper",
    run: Trained | str | Path | None = None,
    refine: int | None = None,
    omniscient: bool = False,
    open_loop: bool = False,
    starts: int | None = None,
    iterations: int | None = None,
    window: int | None = None,
    protocol: Protocols = "both",
    episodes: int = 1,
    seed: int = 0,
    scene_seed: int = 2023,
    progress: bool = True,
) -> Evaluation:
    """Evaluate a planner on the scenes and noise of `evaluate`: by default iCR as published, in receding horizon.

    Args:
        scenes: as for `evaluate`.
        world: a preset's name, a TOML file, a run folder, an `Experiment` or a `Scenario` to plan in.
        run: a trained policy, a run folder or a preset's name, in place of `world`.
        refine: steps of ascent from what the policy of `run` would do.
        omniscient: know every future input, true positions, and no noise.
        open_loop: plan once, at the start.
        starts: sequences to begin from; None: as published, omniscient 64.
        iterations: steps of ascent of each; None: the planner's own number.
        window: most steps that a receding-horizon plan looks ahead.
        protocol: how information is counted, and so what is planned for.
        episodes: runs of every scene.
        seed: of the noise.
        scene_seed: of the scenes of table1 or own.
        progress: show a bar.
    """
    options = PlanOptions(
        refine=refine, starts=starts, iterations=iterations, window=window, omniscient=omniscient, open_loop=open_loop
    )
    protocols = _protocols(protocol, episodes, seed, scene_seed)
    if refine is not None and run is None:
        raise InputError(f"refine {refine}: expected the policy to refine: give run")
    subject = None if run is None else subject_of(run)
    experiment = experiment_from(world) if subject is None else subject.experiment
    chosen, known = scenes_of(scenes, scene_seed, experiment)
    policy = None if subject is None or refine is None else subject.network()
    suite = PlanSuite(experiment=experiment, scenes=known, seed=seed, episodes=episodes, policy=policy)
    facts = {"scene_seed": scene_seed, "run": None if subject is None else subject.name}
    return evaluate_plans(suite, options, chosen, facts, protocols=protocols, quiet=not progress)
