"""Resolution of names: runs and presets to experiments and policies, scenes and methods to lists."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import CONFIG
from foveate.io.progress import logger
from foveate.io.toml import load_toml
from foveate.models.problem import Problem
from foveate.names import ASSIGNMENTS, METHODS, SEARCHERS, Assignment, InitialError, Objective
from foveate.planning.named import assigned_in, heuristic_in
from foveate.policies.assigned import require_common_tracks
from foveate.policies.pointer import PointerPolicy
from foveate.policies.pointer_settings import PointerSettings
from foveate.policies.tokens import token_size
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings, checked, read_scenes
from foveate.simulation.records import Policy
from foveate.simulation.suites import own_suite, table1

TRAINED = Path(__file__).parent / "trained"
"""Folder of the presets' run folders, made by experiments/trained_presets.py."""
Name = str | Path


@dataclass(frozen=True, kw_only=True)
class NamedPolicy:
    """A policy with the experiment of its scenario, as `deploy.policy.RobotPolicy`: trained, heuristic or planner."""

    name: str
    experiment: Experiment
    network: Policy

    def require_serves(self, scenario: Scenario) -> None:
        """Raise InputError if bound to another robot."""


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A policy under evaluation, with its name and the experiment of its scenario.

    `network` loads the policy: a run's heuristics need no checkpoint. `is_trained`: the experiment trained it.
    """

    name: str
    experiment: Experiment
    network: Callable[[], Policy]
    is_trained: bool = True
    trained_tau_s: float | None = None
    """Control period of its training [s]."""

    @property
    def objective(self) -> Objective | None:
        """Objective of its training."""
        return self.experiment.training.objective if self.is_trained else None

    def policy(self, method: str, box_world: Float[Array, "2 d"] | None = None) -> Policy:
        """Return the subject's own policy for "policy", else a heuristic; `lawnmower` and `post` take the box [m]."""
        name, _, rule = method.partition("+")
        scenario = self.experiment.scenario
        policy = self.network() if name == "policy" else heuristic_in(scenario, name, box_world)
        return policy if rule == "" else assigned_in(scenario, policy, cast(Assignment, rule))


def run_folder(run: Name) -> Path:
    """Resolve a run folder, or a preset's name to the package's run folder; an existing run has precedence.

    Of `NAME@SOURCE` it is the folder of NAME.
    """
    folder = Path(run)
    if not folder.exists():
        run = str(run).partition("@")[0]
        folder = Path(run)
    if str(run) in PRESETS and not (folder / CONFIG).is_file():
        return TRAINED / str(run)
    if not folder.is_dir():
        raise InputError(f"{run}: no such run folder or file, and no preset: presets are {', '.join(PRESETS)}")
    return folder


def load(run: Name) -> tuple[Experiment, Policy, dict[str, Any]]:
    """Load the experiment and policy of a run or a preset, and the policy's facts. Raises as `load_run`.

    `NAME@SOURCE` is the policy NAME in the scenario of SOURCE, for its objective (see `experiment_from`).
    """
    experiment, policy, facts = load_run(run_folder(run))
    if (source := _scenario_source(run)) is None:
        return experiment, policy, facts
    experiment = in_scenario(experiment, source.scenario, source.training.objective)
    return experiment, told(policy, experiment), facts


def _scenario_source(run: Name) -> Experiment | None:
    """What comes after the @ of `NAME@SOURCE`; None where there is none, or a file of the whole name."""
    _, at, source = str(run).partition("@")
    return experiment_from(source) if at and not Path(run).exists() else None


def in_scenario(experiment: Experiment, scenario: Scenario, objective: Objective | None = None) -> Experiment:
    """The experiment of a trained policy that is to decide in another scenario.

    `objective` is what the policy is told to do. None keeps that of its training; a policy for any robot then decides
    for the end of episodes that a window holds, and for the mean of longer ones. Raises InputError for a scenario that
    does not fit the network's inputs and outputs: a pointer network takes every robot of its space.
    """
    training, is_pointer = experiment.training, isinstance(experiment.policy, PointerSettings)
    trained, given = (_shape_of(each.problem(), is_pointer) for each in (experiment.scenario, scenario))
    if trained != given:
        raise InputError(f"scenario: has {given}: expected {trained}, as the policy was trained for")
    if isinstance(experiment.policy, PointerSettings) and (rule := experiment.policy.assignment) is not None:
        require_common_tracks(scenario.problem(), "policy.assignment", rule)
    if isinstance(training, ActorCriticSettings):
        if experiment.is_for_any_robot and objective is None:
            scenes = scenario.scenes
            objective = "terminal" if scenes.horizon(scenes.targets_max) <= training.window else "mean"
        training = replace(training, worlds="own", objective=objective or training.objective)
    return replace(experiment, scenario=scenario, training=training)


def told(policy: Policy, experiment: Experiment) -> Policy:
    """The policy, told the objective of an experiment, and the time left where the objective depends on it."""
    if not isinstance(policy, PointerPolicy):
        return policy
    network = experiment.network
    assert isinstance(network, PointerSettings), "of the same kind as its settings"
    return replace(policy, objective=experiment.training.objective, tells_time=network.tells_time is not False)


def experiment_of(run: Name) -> Experiment:
    """Read the experiment of a run or a preset, or of `NAME@SOURCE`."""
    own, source = load_toml(Experiment, run_folder(run) / CONFIG), _scenario_source(run)
    return own if source is None else in_scenario(own, source.scenario, source.training.objective)


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
        return load_toml(Experiment, path / CONFIG)
    if isinstance(source, str) and path.suffix != ".toml" and not path.exists():
        raise InputError(f"{source}: expected a preset ({', '.join(PRESETS)}), a TOML file or a run folder")
    # A copied config.toml may be edited: unlike a run's own, no weights belong to it.
    return load_toml(Experiment, path, logger.warning)


def subject_of(policy: NamedPolicy | Policy | Name, scenario: Scenario | None = None) -> Subject:
    """Resolve a trained policy, a run folder, a preset's name, or a `Policy` with its scenario.

    Raises InputError for anything else, and for a scenario that does not fit the policy's inputs and outputs.
    """
    if isinstance(policy, Policy):
        if scenario is None:
            raise InputError("scenario: expected the scenario of a policy that foveate did not train")
        experiment = Experiment(scenario=scenario)
        return Subject(name=type(policy).__name__, experiment=experiment, network=lambda: policy, is_trained=False)
    if isinstance(policy, Name):
        name, own, network = str(policy), experiment_of(policy), lambda: load(policy)[1]
    elif isinstance(policy, NamedPolicy):
        name, own, network = policy.name, policy.experiment, lambda: policy.network
        policy.require_serves(scenario or own.scenario)
    else:
        raise InputError(f"policy = {policy!r}: expected one of foveate, a run, a preset, or a foveate.Policy")
    tau_s = None if own.is_for_any_robot else own.scenario.tau_s
    if scenario is None:
        return Subject(name=name, experiment=own, network=network, trained_tau_s=tau_s)
    own = in_scenario(own, scenario)
    return Subject(name=name, experiment=own, network=lambda: told(network(), own), trained_tau_s=tau_s)


def _shape_of(problem: Problem, is_pointer: bool) -> str:
    """Describe the sizes on which the inputs and outputs of a network depend."""
    dimensions = f"{problem.agent.space.dimension} dimensions"
    if is_pointer:
        token_size(problem)  # rejects targets that it cannot be told of
        return dimensions
    return f"{dimensions}, states of {problem.motion.state_size} numbers and {len(problem.agent.axes)} of a command"


def with_initial_error(experiment: Experiment, initial_error: InitialError | None) -> Experiment:
    """Replace the error of initial means in an experiment, unless it is None."""
    if initial_error is None:
        return experiment
    scenes = replace(experiment.scenario.scenes, initial_error=initial_error, first_error_std=None)
    return replace(experiment, scenario=replace(experiment.scenario, scenes=scenes))


def methods_of(method: str | Sequence[str], has_ids: bool = True) -> tuple[str, ...]:
    """Return methods' names, each once, with `all` resolved. Raises InputError for an unknown name.

    Those that search are of detections without ids. In a team NAME+RULE assigns targets to robots (see
    `policies.assigned`).
    """
    names, known = [method] if isinstance(method, str) else list(method), (*METHODS, *SEARCHERS)
    for each in names:
        name, plus, rule = each.partition("+")
        if name not in (*known, "all") or (plus and (rule not in ASSIGNMENTS or name == "all")):
            rules = ", ".join(ASSIGNMENTS)
            right = f"expected one of {', '.join(known)}, in a team also NAME+RULE with {rules}, or all"
            raise InputError(f"method {each!r}: {right}")
    everything = METHODS if has_ids else known
    return everything if "all" in names else tuple(dict.fromkeys(names))


def scenes_of(scenes: Name | Sequence[Scene] | None, seed: int, experiment: Experiment) -> tuple[str, list[Scene]]:
    """Resolve a list, a scenes file, table1, or own (the experiment's distribution) to a name and scenes.

    None is table1 in the plane without obstacles where the scenario's scenes are the paper's, else own.
    """
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    planar = experiment.scenario.dimension == 2
    if scenes is None:
        # The paper's beliefs at the start are a choice of their own: a policy trained for others is judged there, too.
        like_paper = replace(settings, initial_error=SceneSettings.initial_error) == SceneSettings()
        scenes = "table1" if planar and problem.obstacles is None and like_paper else "own"
    if not isinstance(scenes, Name):
        return "scenes", checked(scenes, problem.agent.space, settings)
    name = str(scenes)
    if name == "own":
        return name, own_suite(settings, problem, seed)
    if name != "table1":
        return name, read_scenes(Path(name), problem.agent.space, settings)
    if not planar or problem.obstacles is not None:
        raise InputError("scenes table1: the paper's suite is planar, without obstacles: give a scenes file, or own")
    return name, table1(problem, seed)
