"""Functions of Python programs and notebooks, one a command: load, train, evaluate, plan, fit, replay."""

import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from foveate.deploy.exported import load_exported
from foveate.deploy.policy import TrainedPolicy
from foveate.errors import InputError
from foveate.evaluation.plan import PlanOptions, evaluate_plans, planning_subject
from foveate.evaluation.report import Evaluation, evaluate_all
from foveate.evaluation.verdict import judge_run, read_verdict
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import adjusted, for_long_horizons, for_scenario
from foveate.experiment.resolve import (
    NamedPolicy,
    experiment_from,
    experiment_of,
    methods_of,
    run_folder,
    scenes_of,
    with_initial_error,
)
from foveate.experiment.resolve import load as load_parts
from foveate.experiment.run_folder import BEST, Validation
from foveate.experiment.subjects import policies_of, subjects_of
from foveate.io.jax_settings import keep_compiled
from foveate.io.validate import check_count, require, seed_number
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

    "any@mine.toml" is the policy for any robot, in the scenario of this file and for its objective. A file of `foveate
    export` (.onnx) decides by onnxruntime. Raises InputError if none exists, or a file is damaged.
    """
    if Path(run).suffix == ".onnx":
        return load_exported(run)
    experiment, network, facts = load_parts(run)
    verdict = read_verdict(run_folder(run)) if experiment == experiment_of(run_folder(run)) else None
    return TrainedPolicy(name=str(run), experiment=experiment, network=network, facts=facts, verdict=verdict)


def train(
    experiment: Scenario | Experiment | str | Path | None = None,
    *,
    like: Preset | None = None,
    algorithm: Learner | None = None,
    epochs: int | None = None,
    episodes: int | None = None,
    steps: int | None = None,
    remat: bool = False,
    window: int | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    verdict: bool = True,
    callback: Callable[[Validation], object] | None = None,
    progress: bool = True,
) -> TrainedPolicy:
    """Train a policy, keep the best one by validation, and judge it beside every heuristic and a planner.

    Warns if the training stopped early, and if the policy is not clearly better than every heuristic.

    Args:
        experiment: Name of preset, TOML file, run folder, `Experiment` or `Scenario`; None: "paper", or as in `out`.
        like: Preset that gives a `Scenario` its network and learner: "true-view" (None) takes minutes, "paper" seconds.
        algorithm: Learner, in place of the experiment's.
        epochs: Iterations, in place of the experiment's; to resume with the experiment of `out`, more than it has done.
        episodes: Episodes per iteration, in place of the experiment's.
        steps: Environment steps of PPO, which has no epochs and episodes.
        remat: Store fewer states of long episodes: the same gradient in less memory.
        window: Truncate the gradient of long episodes after this many steps.
        seed: Seed of weights and scenes; None: 0, or, to resume with the experiment of `out`, its seed.
        out: Run folder; without one, only the returned policy is left (see its `save`).
        resume: Resume the interrupted training in `out`.
        verdict: Judge the policy at the end, which takes seconds; the result is its `verdict`.
        callback: Called with each `Validation` when it is on the disk, say to log it; its exceptions end the training.
        progress: Show a bar on a terminal, a line at each tenth in a notebook; elsewhere log it.

    Returns:
        The best policy, with the experiment it was trained on.

    Raises:
        InputError: Settings do not fit, or `out` already holds a run.
    """
    place = None if out is None else Path(out)
    if resume and place is None:
        raise InputError("resume: expected out, the run folder to resume")
    stored = stored_run(place, epochs) if resume and place is not None and experiment is None else ("paper", 0)
    source, seed = stored[0] if experiment is None else experiment, stored[1] if seed is None else seed
    chosen = adjusted(_experiment(source, like), algorithm, epochs=epochs, episodes=episodes, steps=steps)
    return _trained(for_long_horizons(chosen, remat, window), place, seed, resume, verdict, callback, progress)


def _experiment(source: Scenario | Experiment | str | Path, like: Preset | None) -> Experiment:
    if isinstance(source, Scenario):
        return for_scenario(source, like or "true-view")
    require(like is None, "like", like, "expected None: only a Scenario has no network and learner of its own")
    return experiment_from(source)


def _trained(
    experiment: Experiment,
    out: Path | None,
    seed: int,
    resume: bool,
    verdict: bool,
    callback: Callable[[Validation], object] | None,
    progress: bool,
) -> TrainedPolicy:
    seed_number(seed, "seed")
    keep_compiled()
    name = "a policy" if out is None else str(out)
    with tempfile.TemporaryDirectory() as scratch:
        run = Path(scratch) / "run" if out is None else out
        with training.watched(experiment, name, callback, quiet=not progress) as report:
            outcome = training.train(experiment, run, seed, resume, report)
        if outcome.stopped:
            warnings.warn(f"{name}: the training stopped early: {outcome.stopped}", stacklevel=3)
        if verdict and (run / BEST).exists() and (judged := judge_run(run, quiet=not progress)).unbeaten:
            how = "train for more epochs or another seed; for one robot try foveate.plan with this run and refine=15"
            warnings.warn(f"{name}: {' '.join(judged.sentences)} To continue, {how}", stacklevel=3)
        return replace(load(run), name=name)


def evaluate(
    policy: NamedPolicy | Policy | str | Path | Sequence[NamedPolicy | str | Path],
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
        policy: Trained policy, run folder, name of a preset, or your own `foveate.Policy` with its `scenario`; or a
            list, whose members run in the scenario of the first, each as a method of its own name.
        scenes: File, list, "table1" (default where the scenario's are the paper's), or "own" (of the scenario).
        method: "policy", "random", "still", "nearest", "uncertain", "lawnmower", "price", "window", "post", several, or
            "all"; where detections have no ids, also "explore", "alternate", "lookahead"; in a team also NAME+RULE,
            with targets assigned by "greedy", "hungarian" or "auction".
        protocol: Information from the paper's soft view (surrogate), from real measurements (true), or both.
        episodes: Episodes per scene.
        seed: Seed of the noise.
        scene_seed: Seed of the scenes of table1 or own.
        initial_error: Error of the initial means, as a measurement's (paper) or as the belief claims (consistent).
        scenario: Scenario to evaluate in, in place of the one of training.
        normalised: Add the score between lower bound (0) and omniscient planner (1, no bound); takes minutes once.
        progress: Show a bar.

    Returns:
        Rows and summary of every method under every protocol.

    Raises:
        InputError: An argument is invalid, a file is damaged, or the scenes do not fit the scenario.
    """
    protocols, (subject, *others) = _protocols(protocol, episodes, seed, scene_seed), subjects_of(policy, scenario)
    methods = methods_of(method, subject.experiment.scenario.detections is None)
    subject = replace(subject, experiment=with_initial_error(subject.experiment, initial_error))
    chosen, known = scenes_of(scenes, scene_seed, subject.experiment)
    name = ", ".join(each.name for each in (subject, *others))
    return evaluate_all(
        f"{name} on {chosen}", {"run": name, "scenes": chosen},
        subject.experiment, policies_of(subject, others, methods), known, quiet=not progress,
        protocols=protocols, episodes=episodes, seed=seed, objective=subject.objective, normalised=normalised,
    )  # fmt: skip


def _protocols(protocol: str, episodes: int, seed: int, scene_seed: int) -> tuple[str, ...]:
    """Resolve protocols, check the other arguments of an evaluation, and keep the programs that it compiles."""
    keep_compiled()
    seed_number(seed, "seed")
    seed_number(scene_seed, "scene_seed")
    check_count(episodes, "episodes")
    if protocol in (*PROTOCOLS, "both"):
        return tuple(PROTOCOLS) if protocol == "both" else (protocol,)
    raise InputError(f"protocol {protocol!r}: expected surrogate, true or both")


def plan(
    scenes: str | Path | Sequence[Scene] | None = None,
    *,
    experiment: Scenario | Experiment | str | Path = "paper",
    run: NamedPolicy | str | Path | None = None,
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
        experiment: Name of preset, TOML file, run folder, `Experiment` or `Scenario` to plan in.
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
    settings, policy, name, objective = planning_subject(experiment, run, refine)
    chosen, known = scenes_of(scenes, scene_seed, settings)
    return evaluate_plans(
        settings, options, known, chosen, {"scene_seed": scene_seed, "run": name}, protocols=protocols, policy=policy,
        episodes=episodes, seed=seed, objective=objective, quiet=not progress,
    )  # fmt: skip
