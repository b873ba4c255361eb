"""Resolution of names: runs and presets to experiments and policies, scenes and methods to lists.

The package has a run folder for each preset, made by experiments/trained_presets.py.
"""

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
"""Folder of the presets' run folders."""
Name = str | Path


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A policy with the experiment that trained it, as `deploy.policy.TrainedPolicy`."""

    name: str
    experiment: Experiment
    network: Policy


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A policy under evaluation, with its name and the experiment of its scenario.

    `network` loads the policy: a run's heuristics need no checkpoint.
    """

    name: str
    experiment: Experiment
    network: Callable[[], Policy]

    def policy(self, method: str, box_world: Float[Array, "2 d"] | None = None) -> Policy:
        """Return the subject's own policy for "policy", else a heuristic; the lawnmower needs the box [m]."""
        if method == "policy":
            return self.network()
        scenario = self.experiment.scenario
        return heuristic(method, scenario.problem(), float(scenario.view.depth_m), box_world)


def run_folder(run: Name) -> Path:
    """Resolve a run folder, or a preset's name to the package's run folder; an existing run has precedence."""
    folder = Path(run)
    if str(run) in PRESETS and not (folder / CONFIG).is_file():
        return TRAINED / str(run)
    if not folder.is_dir():
        raise InputError(f"{run}: no such run folder, and no preset: presets are {', '.join(PRESETS)}")
    return folder


def load(run: Name) -> tuple[Experiment, Policy, dict[str, Any]]:
    """Load the experiment and policy of a run or a preset, and the policy's facts. Raises as `load_run`."""
    return load_run(run_folder(run))


def experiment_of(run: Name) -> Experiment:
    """Read the experiment of a run or a preset."""
    return load_toml(Experiment, run_folder(run) / CONFIG)


def experiment_from(source: Experiment | Scenario | Name) -> Experiment:
    """Resolve an experiment, a scenario, a preset's name, a TOML file, or a run folder to an experiment."""
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
    """Resolve a trained policy, a run folder, a preset's name, or a `Policy` with its scenario.

    Raises InputError for anything else, and for a scenario that does not fit the policy's inputs and outputs.
    """
    if isinstance(policy, Policy):
        if scenario is None:
            raise InputError("scenario: expected the scenario of a policy that foveate did not train")
        experiment = Experiment(scenario=scenario)
        return Subject(name=type(policy).__name__, experiment=experiment, network=lambda: policy)
    if isinstance(policy, Name):
        name, own, network = str(policy), experiment_of(policy), lambda: load(policy)[1]
    elif isinstance(policy, Trained):
        name, own, network = policy.name, policy.experiment, lambda: policy.network
    else:
        raise InputError(f"policy = {policy!r}: expected one of foveate, a run, a preset, or a foveate.Policy")
    if scenario is not None:
        trained, given = (_shape_of(each.problem()) for each in (own.scenario, scenario))
        if trained != given:
            raise InputError(f"scenario: has {given}: expected {trained}, as the policy was trained for")
        own = replace(own, scenario=scenario)
    return Subject(name=name, experiment=own, network=network)


def _shape_of(problem: Problem) -> str:
    """Describe the sizes on which the inputs and outputs of a network depend."""
    n_y, axes = problem.motion.state_size, len(problem.agent.axes)
    return f"{problem.agent.space.dimension} dimensions, states of {n_y} numbers and {axes} of a command"


def with_initial_error(experiment: Experiment, initial_error: InitialError | None) -> Experiment:
    """Replace the error of initial means in an experiment, unless it is None."""
    if initial_error is None:
        return experiment
    scenes = replace(experiment.scenario.scenes, initial_error=initial_error)
    return replace(experiment, scenario=replace(experiment.scenario, scenes=scenes))


def methods_of(method: str | Sequence[str]) -> tuple[str, ...]:
    """Return methods' names, each once, with `all` resolved. Raises InputError for an unknown name."""
    names = [method] if isinstance(method, str) else list(method)
    for name in names:
        if name not in (*METHODS, "all"):
            raise InputError(f"method {name!r}: expected one of {', '.join(METHODS)}, or all")
    return METHODS if "all" in names else tuple(dict.fromkeys(names))


def scenes_of(scenes: Name | Sequence[Scene] | None, seed: int, experiment: Experiment) -> tuple[str, list[Scene]]:
    """Resolve a list, a scenes file, table1, or own (the experiment's distribution) to a name and scenes.

    None is table1 in the plane, own in space.
    """
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
