"""The paper's suite of scenes: its counts and distributions, the same in both precisions."""

import json
import subprocess
import sys

import numpy as np
import pytest
from helpers.distributions import uniform

from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.suites import scene_episodes, suite, table1

PAPER = Scenario()


@pytest.fixture(scope="module")
def suite180():
    return table1(PAPER.problem())


def test_table1_is_the_papers_suite(suite180):
    scenes = suite180
    assert len(scenes) == len({scene.id for scene in scenes}) == 180
    for biased in (False, True):
        for n in (3, 5, 7):
            cell = [s for s in scenes if len(s.targets) == n and (s.motion == "biased") == biased]
            assert len(cell) == 30
            assert {s.horizon for s in cell} == {3 * n}
            assert uniform([s.targets for s in cell], -2 * n, 2 * n)
            assert uniform([s.agent[:2] for s in cell], -2, 2)
            assert uniform([s.agent[2] for s in cell], -np.pi, np.pi)
            drift = np.array([s.drift for s in cell])
            assert (drift == drift[:, :1]).all(), "one drift for all targets of a scene"
            assert uniform(drift[:, 0], -0.8, 0.8) if biased else not drift.any()


IN_SINGLE_PRECISION = """
import json
import jax.numpy as jnp
from dataclasses import asdict
from foveate.scenario.scenario import Scenario
from foveate.simulation.suites import scene_episodes, table1
scenario = Scenario()
problem = scenario.problem()
assert problem.tau.dtype == jnp.float32
scenes = table1(problem)
episode = scene_episodes(problem, scenario.scenes, scenes[::60], 0, 1)
print(json.dumps([[asdict(s) for s in scenes], episode.truth.state.tolist(), episode.mean.tolist()]))
"""


@pytest.fixture(scope="module")
def in_single_precision():
    command = [sys.executable, "-c", IN_SINGLE_PRECISION]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


@pytest.mark.slow
def test_table1_is_the_same_in_both_precisions(suite180, in_single_precision):
    """A scene is what its file says: written by one process, it must be the one that another would draw."""
    scenes, _, _ = in_single_precision
    ours = json.loads(json.dumps([vars(s) for s in suite180]))
    different = sum(a != b for a, b in zip(ours, scenes, strict=True))
    assert different == 0, f"{different} of 180 scenes differ"


@pytest.mark.slow
def test_episodes_are_nearly_the_same_in_both_precisions(suite180, in_single_precision):
    _, truth, mean = in_single_precision
    episode = scene_episodes(PAPER.problem(), PAPER.scenes, suite180[::60], 0, 1)
    np.testing.assert_allclose(truth, episode.truth.state, atol=3e-5)
    np.testing.assert_allclose(mean, episode.mean, atol=1e-5)


def test_a_suite_of_other_settings_keeps_them():
    settings = SceneSettings(half_side_m=(1.0, 1.0), half_side_per_target_m=0.0, steps=5)
    scenes = suite(settings, PAPER.problem(), seed=1, targets=2, count=4, biased=True)
    assert [len(s.targets) for s in scenes] == [2] * 4
    assert {s.horizon for s in scenes} == {5}
    assert np.abs([s.targets for s in scenes]).max() <= 1
    other = suite(settings, PAPER.problem(), seed=2, targets=2, count=4, biased=True)
    assert not {s.agent for s in scenes} & {s.agent for s in other}
