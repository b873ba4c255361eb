"""Functions of Python programs and notebooks, one a command: load, train, evaluate, plan, fit, replay."""

import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from foveate.deploy.policy import TrainedPolicy
from foveate.errors import InputError
from foveate.evaluation.plan import PlanOptions, evaluate_plans
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
from foveate.learning.run_files import stored_run
from foveate.names import InitialError, Learner, Preset
from foveate.recordings.compare import replay as replay
from foveate.recordings.fit import fit as fit
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import PROTOCOLS, Policy

Protocols = Literal["surrogate", "true", "both"]


def load(run: str | Path) -> TrainedPolicy:
    """Load the best policy of a run folder, or the trained policy that the package ships for a preset.

    Raises InputError if neither exists, or a file is damaged.
    """
    experiment, network, facts = load_parts(run)
    return TrainedPolicy(name=str(run), experiment=experiment, network=network, facts=facts)


def train(
    experiment: Scenario | Experiment | str | Path | None = None,
    *,
    like: Preset = "true-view",
    algorithm: Learner | None = None,
    epochs: int | None = None,
    episodes: int | None = None,
    steps: int | None = None,
    remat: bool = False,
    window: int | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    progress: bool = True,
) -> TrainedPolicy:
    """Train a policy and keep the best one by validation; warns if the training stopped early.

    Args:
        experiment: Name of a preset, TOML file as `fit` writes it, run folder, `Experiment`, or `Scenario`; None: the
            preset "paper", or, to resume, the experiment of `out`.
        like: Preset that gives a `Scenario` its network and learner: "true-view" takes minutes, "paper" seconds.
        algorithm: Learner, in place of the experiment's.
        epochs: Iterations, in place of the experiment's.
        episodes: Episodes per iteration, in place of the experiment's.
        steps: Environment steps of PPO, which has no epochs and episodes.
        remat: Store fewer states of long episodes: the same gradient in less memory.
        window: Truncate the gradient of long episodes after this many steps.
        seed: Seed of weights and scenes; None: 0, or, to resume with the experiment of `out`, its seed.
        out: Run folder; without one, only the returned policy is left (see its `save`).
        resume: Resume the interrupted training in `out`.
        progress: Show a bar on a terminal, or a line at each tenth in a notebook.

    Returns:
        The best policy, with the experiment it was trained on.

    Raises:
        InputError: Settings do not fit, or `out` already holds a run.
    """
    if resume and out is None:
        raise InputError("resume: expected out, the run folder to resume")
    stored = stored_run(Path(out)) if resume and out is not None and experiment is None else ("paper", 0)
    experiment, seed = stored[0] if experiment is None else experiment, stored[1] if seed is None else seed
    seed_number(seed, "seed")
    chosen = for_scenario(experiment, like) if isinstance(experiment, Scenario) else experiment_from(experiment)
    chosen = for_long_horizons(
        adjusted(chosen, algorithm, epochs=epochs, episodes=episodes, steps=steps), remat, window
    )
    return _trained(chosen, None if out is None else Path(out), seed, resume, progress)


def _trained(experiment: Experiment, out: Path | None, seed: int, resume: bool, progress: bool) -> TrainedPolicy:
    if out is not None:
        return _trained_in(out, str(out), experiment, seed, resume, progress)
    with tempfile.TemporaryDirectory() as folder:
        return _trained_in(Path(folder) / "run", "a policy", experiment, seed, resume, progress)


def _trained_in(out: Path, name: str, experiment: Experiment, seed: int, resume: bool, progress: bool) -> TrainedPolicy:
    with training.watched(experiment, name, quiet=not progress) as report:
        outcome = training.train(experiment, out, seed, resume, report)
    if outcome.stopped:
        warnings.warn(f"{name}: the training stopped early: {outcome.stopped}", stacklevel=4)
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
    """Evaluate a policy, and heuristics beside it, on the same scenes with the same noise.

    Args:
        policy: Trained policy, run folder, name of a preset, or your own `foveate.Policy` with its `scenario`.
        scenes: File, list, "table1" (the paper's; default in the plane), or "own" (of the scenario; default in space).
        method: "policy", "random", "still", "nearest", "uncertain", "lawnmower", several of them, or "all".
        protocol: Information from the paper's soft view (surrogate), from real measurements (true), or both.
        episodes: Episodes per scene.
        seed: Seed of the noise.
        scene_seed: Seed of the scenes of table1 or own.
        initial_error: Error of the initial means, as a measurement's (paper) or as the belief claims (consistent).
        scenario: Scenario to evaluate in, in place of the one of training.
        normalised: Add the score between lower bound (0) and omniscient planner (1), whose plans take minutes, once.
        progress: Show a bar.

    Returns:
        Rows and summary of every method under every protocol.

    Raises:
        InputError: An argument is invalid, a file is damaged, or the scenes do not fit the scenario.
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
        protocols=protocols, episodes=episodes, seed=seed, normalised=normalised, quiet=not progress,
    )  # fmt: skip


def _protocols(protocol: str, episodes: int, seed: int, scene_seed: int) -> tuple[str, ...]:
    """Resolve protocols, and check the other arguments of an evaluation."""
    seed_number(seed, "seed")
    seed_number(scene_seed, "scene_seed")
    check_count(episodes, "episodes")
    if protocol not in (*PROTOCOLS, "both"):
        raise InputError(f"protocol {protocol!r}: expected surrogate, true or both")
    return tuple(PROTOCOLS) if protocol == "both" else (protocol,)


def plan(
    scenes: str | Path | Sequence[Scene] | None = None,
    *,
    experiment: Scenario | Experiment | str | Path = "paper",
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
        scenes: As for `evaluate`.
        experiment: Name of a preset, TOML file, run folder, `Experiment` or `Scenario` to plan in.
        run: Trained policy, run folder or name of a preset, in place of `experiment`.
        refine: Ascent steps from the actions of the policy of `run`.
        omniscient: Know all inputs and true positions in advance, without noise.
        open_loop: Plan once, at the start.
        starts: Initial action sequences; None: as published, 64 if omniscient.
        iterations: Ascent steps from each; None: the planner's default.
        window: Longest horizon of a receding-horizon plan [steps].
        protocol: Protocol that is planned for and evaluated under.
        episodes: Episodes per scene.
        seed: Seed of the noise.
        scene_seed: Seed of the scenes of table1 or own.
        progress: Show a bar.

    Returns:
        A row per protocol, scene and episode, and their summary.

    Raises:
        InputError: An argument is invalid, `refine` has no `run`, or the planner cannot plan in the scenario.
    """
    options = PlanOptions(refine=refine, starts=starts, iterations=iterations, window=window, omniscient=omniscient,
                          open_loop=open_loop)  # fmt: skip
    protocols = _protocols(protocol, episodes, seed, scene_seed)
    settings, policy, name = _planning_subject(experiment, run, refine)
    chosen, known = scenes_of(scenes, scene_seed, settings)
    return evaluate_plans(
        settings, options, known, chosen, {"scene_seed": scene_seed, "run": name}, protocols=protocols, policy=policy,
        episodes=episodes, seed=seed, quiet=not progress,
    )  # fmt: skip


def _planning_subject(
    experiment: Scenario | Experiment | str | Path, run: Trained | str | Path | None, refine: int | None
) -> tuple[Experiment, Policy | None, str | None]:
    """Resolve the experiment to plan in, the policy to refine, and the name of the run."""
    if refine is not None and run is None:
        raise InputError(f"refine {refine}: expected the policy to refine: give run")
    if run is None:
        return experiment_from(experiment), None, None
    subject = subject_of(run)
    return subject.experiment, None if refine is None else subject.network(), subject.name
