"""The paper's suite of scenes: its counts and distributions, the same in both precisions."""

import json
import subprocess
import sys

import jax
import numpy as np
import pytest
from helpers.distributions import uniform

from foveate.experiment.presets import PRESETS
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings, scenes_digest
from foveate.simulation.episodes import Drawn, Noise, episode_of
from foveate.simulation.suites import Cell, own_suite, scene_episodes, scene_noise, suite, table1

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


@pytest.mark.parametrize(
    ("preset", "seed", "digest"),
    [
        ("table1", 2023, "dd4a3cdd29b3e621"),
        ("table1", 7, "9274039c3089c33d"),
        ("paper", 2023, "9719edbac5f2b65b"),
        ("quadrotor", 2023, "4426b847a738baa0"),
    ],
)
def test_suites_are_those_of_version_0_1_0(preset, seed, digest):
    """Digests of what that version drew, cell by cell."""
    if preset == "table1":
        assert scenes_digest(table1(PAPER.problem(), seed)) == digest
    else:
        scenario = PRESETS[preset].scenario
        assert scenes_digest(own_suite(scenario.scenes, scenario.problem(), seed)) == digest


@pytest.mark.parametrize("preset", ["paper", "quadrotor"])
def test_episodes_equal_those_made_scene_by_scene_bit_for_bit(preset):
    """Scene by scene, with numpy's padding; and some numbers of version 0.1.0, to seven digits.

    That version drew targets with velocities by eigenvectors, and so otherwise on every machine.
    """
    scenario = PRESETS[preset].scenario
    problem, settings = scenario.problem(), scenario.scenes
    scenes = own_suite(settings, problem)[29:90:30]
    n, steps, d = len(scenes[-1].targets), scenes[-1].horizon, problem.agent.space.dimension
    rows = []
    for scene in scenes:
        more = n - len(scene.targets)
        drawn = {
            "pose": problem.agent.space.from_numbers(scene.agent),
            "position": np.pad(np.reshape(scene.targets, (-1, d)), ((0, more), (0, 0))),
            "drift": np.pad(np.reshape(scene.drift, (-1, d)), ((0, more), (0, 0))),
            "present": np.arange(n) < len(scene.targets),
            "horizon": np.array(scene.horizon),
        }
        for k in range(2):
            noise = scene_noise(problem, scene, 5, k)
            pads = ((0, steps - scene.horizon), (0, more), (0, 0))
            rows.append((drawn, {name: np.pad(x, pads[3 - x.ndim :]) for name, x in noise.items()}))
    drawn, noise = jax.tree.map(lambda *parts: np.stack(parts), *rows)
    make = jax.vmap(lambda drawn, noise: episode_of(problem, settings, Drawn(**drawn), Noise(**noise)))
    expected = jax.jit(make)(drawn, noise)
    found = scene_episodes(problem, settings, scenes, 5, 2)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)
    if preset == "paper":
        np.testing.assert_allclose(found.truth.state[3, 2, 1], [3.9402337168, -7.8765259406], atol=1e-9)
        np.testing.assert_allclose(found.mean[5, 0], [-5.8332035811, 7.2125564407], atol=1e-9)


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
    scenes = suite(settings, PAPER.problem(), seed=1, cells=[Cell(2, True)], count=4)
    assert [len(s.targets) for s in scenes] == [2] * 4
    assert {s.horizon for s in scenes} == {5}
    assert np.abs([s.targets for s in scenes]).max() <= 1
    other = suite(settings, PAPER.problem(), seed=2, cells=[Cell(2, True)], count=4)
    assert not {s.agent for s in scenes} & {s.agent for s in other}
