"""The hand-made policies do what they say, by brute force."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.decisions import decide, seen, steered_to
from scipy.stats import kstest

from foveate.names import HEURISTICS
from foveate.planning.named import heuristic_policy
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import TriangleView
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import TRUE, Episode
from foveate.simulation.rollout import rollout

PROBLEM = Scenario().problem()
REVERSING = replace(Scenario(), agent=DifferentialDrive(v_min_m_s=-1.0)).problem()


@pytest.mark.parametrize("method", ["nearest", "uncertain"])
def test_steers_to_the_chosen_target(method):
    rng, policy = np.random.default_rng(0), heuristic_policy(method, PROBLEM, 2.0)
    for _ in range(100):
        pose = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-9, 9)])
        mean, log_dets, present = rng.uniform(-9, 9, (6, 2)), rng.uniform(-2, 9, 6), rng.random(6) < 0.7
        if not present.any():
            continue
        merit = np.linalg.norm(mean - pose[:2], axis=1) if method == "nearest" else log_dets
        choice = min(np.flatnonzero(present), key=lambda j, merit=merit: merit[j])
        _, control = decide(policy, seen(pose, mean, log_dets, present), jax.random.key(0))
        assert steered_to(control, pose, mean[choice])


def test_uncertain_takes_the_nearer_of_equals():
    policy = heuristic_policy("uncertain", PROBLEM, 2.0)
    mean = [[0.0, 8.0], [1.0, -3.0], [5.0, 0.0]] * 2
    _, control = decide(policy, seen([0, 0, 0], mean, [1.0, 1.0, 1.0, 9, 9, 9], np.ones(6, bool)), jax.random.key(0))
    assert steered_to(control, np.zeros(3), [1, -3])


@pytest.mark.parametrize("method", ["nearest", "uncertain"])
def test_ends_in_front_of_its_target(method):
    """A target that stands still: the agent ends at its standoff, facing it, and stays."""
    policy = heuristic_policy(method, REVERSING, 2.0)
    goal = np.array([-6.0, 5.0])
    pose = np.array([0.3, 0.1, 1.0])
    mean = np.tile(goal, (6, 1))
    for _ in range(40):
        action, _ = decide(policy, seen(pose, mean, np.zeros(6), np.ones(6, bool)), jax.random.key(0))
        pose = np.asarray(REVERSING.agent.move(jnp.asarray(pose), action, REVERSING.tau))
    assert np.linalg.norm(goal - pose[:2]) == pytest.approx(1.0, abs=1e-3)  # half the depth
    assert np.cos(np.arctan2(*(goal - pose[:2])[::-1]) - pose[2]) == pytest.approx(1, abs=1e-6)


def test_still_stands_still():
    observation = seen([1, 2, 3], np.ones((6, 2)), np.zeros(6), np.ones(6, bool))
    for problem in (PROBLEM, REVERSING):
        action, control = decide(heuristic_policy("still", problem, 2.0), observation, jax.random.key(0))
        np.testing.assert_allclose(control, 0, atol=1e-15)
        np.testing.assert_allclose(
            problem.agent.move(observation.pose, action, problem.tau), observation.pose, atol=1e-15
        )
    never = replace(Scenario(), agent=DifferentialDrive(v_min_m_s=0.5)).problem()
    _, control = decide(heuristic_policy("still", never, 2.0), observation, jax.random.key(0))
    np.testing.assert_allclose(control, [0.5, 0])


def test_random_covers_the_range_uniformly_and_depends_on_the_key():
    policy = heuristic_policy("random", PROBLEM, 2.0)
    observation = seen([1, 2, 3], np.ones((6, 2)), np.zeros(6), np.ones(6, bool))
    keys = jax.random.split(jax.random.key(0), 4000)
    action, control = jax.jit(jax.vmap(lambda key: decide(policy, observation, key)))(keys)
    for axis, (low, high) in enumerate([(0, 4), (-np.pi / 3, np.pi / 3)]):
        assert kstest(control[:, axis], "uniform", (low, high - low)).pvalue > 0.01
    assert abs(np.corrcoef(np.asarray(action).T)[0, 1]) < 0.05
    assert len(np.unique(np.asarray(action)[:, 0])) > 3900
    again = decide(policy, observation, keys[7])[0]
    np.testing.assert_array_equal(again, action[7])


def sweep(policy, problem, box, steps=300):
    """The poses of a long episode with targets at two corners of a box."""
    episode = Episode(
        pose=jnp.array([box[0][0] + 1.0, box[1][1], 0.5]),
        mean=jnp.asarray(box, float),
        present=jnp.ones(2, bool),
        inputs=jnp.zeros((steps, 2, 2)),
        horizon=jnp.asarray(steps),
    )
    run = jax.jit(lambda episode: rollout(problem, policy, episode, TRUE, jax.random.key(0)).pose)
    return np.asarray(run(episode))


@pytest.mark.parametrize("given", [False, True])
def test_lawnmower_leaves_no_point_of_the_box_further_than_a_view(given):
    """A box that six lanes can cover: no point of it is ever further away than the view is deep, at some instant.

    With `given` the box is not that of the first beliefs.
    """
    low, high = np.array([-8.0, -3.0]), np.array([10.0, 9.0])
    slow = replace(Scenario(), agent=DifferentialDrive(v_max_m_s=1.5), view=TriangleView(depth_m=2.0)).problem()
    policy = heuristic_policy("lawnmower", slow, 2.0, jnp.stack([low, high]) if given else None)
    box = [low, high] if not given else [low + 5, low + 6]
    path = sweep(policy, slow, box)[:, :2]
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 25).T), axis=-1).reshape(-1, 2)
    furthest = np.linalg.norm(grid[:, None] - path[None], axis=-1).min(axis=1).max()
    assert furthest < 2.0
    last = path[-1]
    assert (last > low - 3).all()
    assert (last < high + 3).all(), "it stays about its box"


@pytest.mark.parametrize("method", HEURISTICS)
def test_without_a_target_the_action_is_defined(method):
    policy = heuristic_policy(method, PROBLEM, 2.0)
    mean = np.full((6, 2), 1e6)
    action, control = decide(policy, seen([1, 2, 3], mean, np.zeros(6), np.zeros(6, bool)), jax.random.key(0))
    assert np.isfinite(action).all()
    assert (np.abs(action) <= 1).all()
    if method != "random":
        np.testing.assert_allclose(control[0], 0, atol=1e-12)


def test_unknown_method():
    with pytest.raises(ValueError, match=r"method 'nearst': expected one of random, still, nearest"):
        heuristic_policy("nearst", PROBLEM, 2.0)
