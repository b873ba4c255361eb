"""The suite of worlds: every file is an experiment that can be simulated, and equals what it says it is."""

import re
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

import foveate
from foveate.api import fit
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.presets import PRESETS
from foveate.io.toml import load_toml
from foveate.planning.named import heuristic_policy
from foveate.policies.pointer_settings import PointerSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout

ROOT = Path(__file__).parents[1]
WORLDS = {path.stem: path for path in sorted((ROOT / "benchmarks" / "worlds").glob("*.toml"))}
TRACKS = ROOT / ".." / "shared" / "tracks"
WANTED = {
    *("paper", "search", "quadrotor", "pan", "pan-tilt", "tutorial", "zara01", "sind"),
    *("rest-200", "set-tracking", "commands-12", "fast-drone", "slow-robot", "crowd-20", "long-1000"),
    *("team-tracking", "team-lossy", "team-rooms", "team-patrol", "regions", "team-discover"),
    *("rooms", "circles", "streets", "forest"),
    *(f"discover-{kind}" for kind in ("sparse", "dense", "births", "clutter", "misses", "space")),
}


def test_the_suite_is_complete():
    assert set(WORLDS) == WANTED


COMPILED = ("paper", "commands-12", "regions", "search", "team-lossy", "pan-tilt")
"""Worlds that run; of the others, which have no part of their own, the program is made and not run."""


QUICK = ("paper", "pan", "commands-12")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in WORLDS]
)
def test_a_world_is_an_experiment_that_can_be_simulated(name):
    """Two steps of a heuristic."""
    scenario = load_toml(Experiment, WORLDS[name]).scenario
    problem, short = scenario.problem(), replace(scenario.scenes, steps=2)
    policy = heuristic_policy("uncertain", problem, float(scenario.view.depth_m))

    @jax.jit
    def played(key):
        return rollout(problem, policy, training_episode(problem, short, key, noise=True), TRUE, key)

    trace = (played if name in COMPILED else partial(jax.eval_shape, played))(jax.random.key(0))
    beliefs = scenario.scenes.targets_max if scenario.detections is None else scenario.detections.tracks
    assert trace.log_det.shape == (2, beliefs)
    if name in COMPILED:
        assert np.isfinite(trace.log_det).all()
        assert np.isfinite(trace.pose).all()


@pytest.mark.parametrize("name", WORLDS)
def test_networks_and_learners_of_a_world_are_the_defaults(name):
    """But for the objective, which belongs to the world, and rays among obstacles.

    Robots with assigned targets begin with the weights of a preset, and train in small steps.
    """
    experiment = load_toml(Experiment, WORLDS[name])
    training, policy, changed = experiment.training, experiment.policy, {}
    among_obstacles = experiment.scenario.obstacles is not None
    settings = PointerSettings(kind="pointer", rays=policy.rays)
    if policy.assignment is not None:
        assert experiment.scenario.team is not None
        assert policy.begin_with == ("rooms" if among_obstacles else "any")
        parts = "assignment", "begin_with", "clips_features", "dynamic_window"
        settings = replace(settings, **{part: getattr(policy, part) for part in parts})
        changed = {part: getattr(training, part) for part in ("epochs", "learning_rate", "action_std")}
    expected = ActorCriticSettings(algorithm="actor-critic", objective=training.objective)
    assert training == replace(expected, **changed)
    assert policy == settings
    assert (policy.rays > 0) == among_obstacles


@pytest.mark.parametrize("name", sorted(set(WORLDS) & set(PRESETS)))
def test_a_world_of_a_presets_name_has_its_scenario_and_objective(name):
    experiment = load_toml(Experiment, WORLDS[name])
    assert experiment.scenario == PRESETS[name].scenario
    if isinstance(PRESETS[name].training, ActorCriticSettings):
        assert experiment.training.objective == PRESETS[name].training.objective


def test_the_world_of_the_tutorial_is_that_of_its_page():
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    (block,) = [b for b in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if b.startswith("scenario = ")]
    names = {"foveate": foveate}
    exec(compile(block, "tutorial.md", "exec"), names)
    assert load_toml(Experiment, WORLDS["tutorial"]).scenario == names["scenario"]


@pytest.mark.parametrize(("name", "file"), [("zara01", "ped_ucy_zara01"), ("sind", "ped_sind_chongqing")])
def test_the_world_of_a_recording_is_what_fit_makes_of_it(name, file):
    path = TRACKS / f"{file}.csv"
    if not path.exists():
        pytest.skip(f"no {path.name} beside the repository")
    experiment = load_toml(Experiment, WORLDS[name])
    fitted = fit(path).experiment
    assert experiment.training.objective == fitted.training.objective
    for part in fields(fitted.scenario):
        assert_close(getattr(experiment.scenario, part.name), getattr(fitted.scenario, part.name), part.name)


def assert_close(found, expected, where):
    """Equal, numbers to a part in a million: those of a fit differ in rounding between machines."""
    if hasattr(expected, "__dataclass_fields__"):
        assert type(found) is type(expected), where
        for part in fields(expected):
            assert_close(getattr(found, part.name), getattr(expected, part.name), f"{where}.{part.name}")
    elif isinstance(expected, int | float | tuple) and not isinstance(expected, bool):
        np.testing.assert_allclose(found, expected, rtol=1e-6, err_msg=where)
    else:
        assert found == expected, where
