"""Counts of simulated steps and planned scenes."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest

from foveate.bench import simulation
from foveate.planning.named import heuristic_policy
from foveate.planning.shooting import PlanSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.environment import Environment, reset, step
from foveate.simulation.records import PROTOCOLS
from foveate.simulation.suites import own_suite


@pytest.fixture
def five(tiny, monkeypatch, clock):
    """Five targets for 2 steps in each of 2 episodes; every call takes 2 s."""
    monkeypatch.setattr(simulation, "ENVIRONMENTS", 2)
    monkeypatch.setattr(simulation, "in_turn", clock)
    return replace(tiny, scenario=Scenario(scenes=SceneSettings(targets_min=5, targets_max=5, steps=2)))


def test_steps_of_targets_are_counted(five, clock):
    metrics = {metric.key: metric.value for metric in simulation.simulation(five, 1)}
    scenes = own_suite(five.scenario.scenes, five.scenario.problem())
    assert metrics == {
        "rollout_target_steps_per_s": pytest.approx(2 * 5 * 2 / 2.0),
        "evaluation_target_steps_per_s": pytest.approx(len(scenes) * 4 * 5 * 2 / 2.0),
        "evaluation_episodes_per_s": pytest.approx(len(scenes) * 4 / 2.0),
    }
    rollouts, evaluation = clock.results
    assert rollouts.shape == (2, 2, 5)
    assert evaluation.log_det.shape == (len(scenes) * 4, 2, 5)


def test_an_evaluation_is_measured_beside_its_bare_simulation(five, clock, monkeypatch):
    """Both of the same episodes: the rows have the log determinants of the bare trace."""
    problem = five.scenario.problem()
    monkeypatch.setattr(simulation, "load", lambda preset: (five, heuristic_policy("nearest", problem, 2.0), {}))
    (metric,) = simulation.evaluation("mine", 1)
    assert (metric.key, metric.value, metric.better) == ("evaluate_over_limit", 1.0, "lower")
    rows, trace = clock.results
    assert len(rows) == len(own_suite(five.scenario.scenes, problem))
    np.testing.assert_allclose([row.score for row in rows], trace.log_det[:, -1].mean(axis=-1), rtol=1e-5)


@pytest.mark.slow
def test_steps_of_environments_are_counted(five, clock):
    (metric,) = simulation.environments(five, 1)
    assert (metric.key, metric.value) == ("env_steps_per_s_2", pytest.approx(32 * 2 / 2.0))
    (rewards,) = clock.results
    environment = Environment(five.scenario.problem(), five.scenario.scenes, PROTOCOLS["true"], True)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (32, 2, 2)).astype(np.float32)
    keys = jax.random.split(jax.random.key(0), 2)
    expected = np.stack([rewards_of(environment, keys[i], actions[:, i]) for i in range(2)], axis=1)
    np.testing.assert_allclose(rewards, expected, rtol=1e-5, atol=1e-5)


@eqx.filter_jit
def rewards_of(environment, key, actions):
    """Rewards of one environment, which begins its next episode where one ends."""

    def one(current, action):
        current, transition = step(environment, current, action)
        current = jax.lax.cond(transition.done, lambda: reset(environment, current.key), lambda: current)
        return current, transition.reward

    return jax.lax.scan(one, reset(environment, key), actions)[1]


@pytest.mark.slow
def test_planned_scenes_are_counted(five, clock, monkeypatch):
    monkeypatch.setattr(simulation, "PLANNED_SCENES", 3)
    monkeypatch.setattr(simulation, "OMNISCIENT", {"true": PlanSettings(starts=1, iterations=1)})
    (metric,) = simulation.planning(five, 1)
    assert (metric.key, metric.value, metric.better) == ("planner_scenes_per_s", pytest.approx(3 / 2.0), "higher")
    (scores,) = clock.results
    assert scores.shape == (3,)
