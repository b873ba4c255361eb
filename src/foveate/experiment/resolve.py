"""What the name of a run or of a preset means: a folder, an experiment, a policy, scenes.

The package brings a trained policy of every preset, as a run folder like any other; experiments/trained_presets.py
made them.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import CONFIG
from foveate.io.toml import load_toml
from foveate.policies.heuristics import heuristic
from foveate.scenario.scenes import Scene, read_scenes
from foveate.simulation.records import Policy
from foveate.simulation.suites import own_suite, table1

TRAINED = Path(__file__).parent / "trained"
"""The run folders of the presets."""


Name = str | Path


def run_folder(run: Name) -> Path:
    """The run folder of that name, or the one that the package brings of the preset of that name.

    Any folder that holds a run comes first. Raises ValueError where there is neither.
    """
    folder = Path(run)
    if str(run) in PRESETS and not (folder / CONFIG).is_file():
        return TRAINED / str(run)
    if not folder.is_dir():
        raise InputError(f"{run}: no such run folder, and no preset: presets are {', '.join(PRESETS)}")
    return folder


def load(run: Name) -> tuple[Experiment, Policy, dict[str, Any]]:
    """Experiment and policy of a run or a preset, and the facts saved with it. Raises ValueError as `load_run`."""
    return load_run(run_folder(run))


def experiment_of(run: Name) -> Experiment:
    """The experiment of a run or a preset."""
    return load_toml(Experiment, run_folder(run) / CONFIG)


def with_initial_error(experiment: Experiment, initial_error: Literal["paper", "consistent"] | None) -> Experiment:
    """The experiment with this first error of beliefs; with its own where None is given."""
    if initial_error is None:
        return experiment
    scenario = experiment.scenario
    scenes = replace(scenario.scenes, initial_error=initial_error)
    return replace(experiment, scenario=replace(scenario, scenes=scenes))


def policy_of(run: Name, method: str, experiment: Experiment, box_world: Float[Array, "2 d"] | None = None) -> Policy:
    """The policy that a method's name means for a run: `policy`, its own, or one made by hand for its world."""
    if method == "policy":
        return load(run)[1]
    scenario = experiment.scenario
    return heuristic(method, scenario.problem(), float(scenario.view.depth_m), box_world)


def scenes_of(name: Name | None, seed: int, experiment: Experiment) -> tuple[str, list[Scene]]:
    """The scenes that a name means, and the name: a file, table1, or own; None is table1 in the plane, own in space."""
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    planar = experiment.scenario.dimension == 2
    chosen = str(name) if name is not None else ("table1" if planar else "own")
    if chosen == "own":
        return chosen, own_suite(settings, problem, seed)
    if chosen != "table1":
        return chosen, read_scenes(Path(chosen), problem.agent.space, settings)
    if not planar:
        raise InputError("scenes table1: the paper's suite is planar: give a scenes file, or own")
    return chosen, table1(problem, seed)
