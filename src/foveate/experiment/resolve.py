"""Resolve names: a run folder or preset to its experiment and policy, scenes and methods to what they stand for.

The package ships a trained policy of every preset, as a run folder like any other; experiments/trained_presets.py
made them.
"""

import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import CONFIG
from foveate.io.toml import load_toml
from foveate.models.problem import Problem
from foveate.names import METHODS, InitialError
from foveate.policies.heuristics import heuristic
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, checked, read_scenes
from foveate.simulation.records import Policy
from foveate.simulation.suites import own_suite, table1

TRAINED = Path(__file__).parent / "trained"
"""The run folders of the presets."""
Name = str | Path


@typing.runtime_checkable
class Trained(typing.Protocol):
    """A policy with the experiment that trained it: `deploy.policy.TrainedPolicy`."""

    name: str
    experiment: Experiment
    network: Policy


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A policy under evaluation, with its name and the experiment whose scenario it acts in."""

    name: str
    experiment: Experiment
    network: Callable[[], Policy]
    """Loads the policy: heuristics need no checkpoint."""

    def policy(self, method: str, box_world: Float[Array, "2 d"] | None = None) -> Policy:
        """Resolve a method's name: `policy` or a heuristic; the box [m] is for the lawnmower."""
        if method == "policy":
            return self.network()
        scenario = self.experiment.scenario
        return heuristic(method, scenario.problem(), float(scenario.view.depth_m), box_world)


def run_folder(run: Name) -> Path:
    """Resolve a run folder, or the name of a preset to the run folder that the package ships for it.

    Any folder that holds a run comes first. Raises InputError where there is neither.
    """
    folder = Path(run)
    if str(run) in PRESETS and not (folder / CONFIG).is_file():
        return TRAINED / str(run)
    if not folder.is_dir():
        raise InputError(f"{run}: no such run folder, and no preset: presets are {', '.join(PRESETS)}")
    return folder


def load(run: Name) -> tuple[Experiment, Policy, dict[str, Any]]:
    """Load experiment and policy of a run or preset, and the facts saved with them. Raises InputError as `load_run`."""
    return load_run(run_folder(run))


def experiment_of(run: Name) -> Experiment:
    """The experiment of a run or a preset."""
    return load_toml(Experiment, run_folder(run) / CONFIG)


def experiment_from(source: Experiment | Scenario | Name) -> Experiment:
    """Resolve what to train or simulate: an experiment, a scenario, a preset's name, a TOML file, or a run folder."""
    if isinstance(source, Experiment):
        return source
    if isinstance(source, Scenario):
        return Experiment(scenario=source)
    if isinstance(source, str) and source in PRESETS:
        return PRESETS[source]
    path = Path(source)
    if path.is_dir():
        path = path / CONFIG
    elif isinstance(source, str) and path.suffix != ".toml" and not path.exists():
        raise InputError(f"{source}: expected a preset ({', '.join(PRESETS)}), a TOML file or a run folder")
    return load_toml(Experiment, path)


def subject_of(policy: Trained | Policy | Name, scenario: Scenario | None = None) -> Subject:
    """Resolve a trained policy, a run folder, a preset's name, or a `Policy` with the scenario to act in.

    Raises InputError for anything else, and for a scenario of another kind than the policy was trained for.
    """
    if isinstance(policy, Policy):
        if scenario is None:
            raise InputError("scenario: expected the scenario of a policy that foveate did not train")
        experiment = Experiment(scenario=scenario)
        return Subject(name=type(policy).__name__, experiment=experiment, network=lambda: policy)
    if isinstance(policy, Name):
        name, own, network = str(policy), experiment_of(policy), lambda: load(policy)[1]
    elif isinstance(getattr(policy, "experiment", None), Experiment):
        name, own, network = policy.name, policy.experiment, lambda: policy.network
    else:
        right = "expected one of foveate, a run, a preset, or a foveate.Policy"
        raise InputError(f"policy = {policy!r}: {right}")
    if scenario is not None:
        trained, given = (_shape_of(each.problem()) for each in (own.scenario, scenario))
        if trained != given:
            raise InputError(f"scenario: has {given}: expected {trained}, as the policy was trained for")
        own = replace(own, scenario=scenario)
    return Subject(name=name, experiment=own, network=network)


def _shape_of(problem: Problem) -> str:
    """Dimensions that the inputs and outputs of a network depend on."""
    n_y, axes = problem.motion.state_size, len(problem.agent.axes)
    return f"{problem.agent.space.dimension} dimensions, states of {n_y} numbers and {axes} of a command"


def with_initial_error(experiment: Experiment, initial_error: InitialError | None) -> Experiment:
    """Set the error of the first means; None keeps the experiment's own."""
    if initial_error is None:
        return experiment
    scenario = experiment.scenario
    scenes = replace(scenario.scenes, initial_error=initial_error)
    return replace(experiment, scenario=replace(scenario, scenes=scenes))


def methods_of(method: str | Sequence[str]) -> tuple[str, ...]:
    """Resolve names of methods, each once, `all` to all. Raises InputError for an unknown name."""
    names = [method] if isinstance(method, str) else list(method)
    for name in names:
        if name not in (*METHODS, "all"):
            raise InputError(f"method {name!r}: expected one of {', '.join(METHODS)}, or all")
    return METHODS if "all" in names else tuple(dict.fromkeys(names))


def scenes_of(scenes: Name | Sequence[Scene] | None, seed: int, experiment: Experiment) -> tuple[str, list[Scene]]:
    """Resolve scenes and their name: a list, a file, table1, or own; None is table1 in the plane, own in space."""
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    planar = experiment.scenario.dimension == 2
    if scenes is None:
        scenes = "table1" if planar else "own"
    if not isinstance(scenes, Name):
        return "scenes", checked(scenes, problem.agent.space, settings)
    name = str(scenes)
    if name == "own":
        return name, own_suite(settings, problem, seed)
    if name != "table1":
        return name, read_scenes(Path(name), problem.agent.space, settings)
    if not planar:
        raise InputError("scenes table1: the paper's suite is planar: give a scenes file, or own")
    return name, table1(problem, seed)
