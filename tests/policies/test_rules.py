"""The rule with a price of the way, and the fixed post, by brute force."""

from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.decisions import bearing_to, decide, seen, steered_to

from foveate.planning.named import heuristic_policy
from foveate.policies.rules import Post
from foveate.scenario.agent import DifferentialDrive, FreeBody
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario

PROBLEM = Scenario().problem()
WIDE = replace(Scenario(), agent=DifferentialDrive(v_max_m_s=1.0), view=SectorView(depth_m=3.0)).problem()
PAN = FreeBody(kind="body", space="planar", axes=("wz",), lower=(-1.0,), upper=(1.0,))
TURNING = replace(Scenario(), agent=PAN, view=SectorView(depth_m=6.0, angle_deg=40.0)).problem()
KEY = jax.random.key(0)


def way(pose, point, half_angle, reach, turn, speed):
    """Steps of turning until a point is between the sides of a view, and of driving until it is near enough."""
    bearing, distance = abs(bearing_to(pose, point)), np.linalg.norm(point - pose[:2])
    return max(bearing - half_angle, 0) / turn + max(distance - reach, 0) / speed


def scattered(rng, count=6):
    """A random pose and beliefs, not all of them present."""
    pose = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-9, 9)])
    return pose, rng.uniform(-9, 9, (count, 2)), rng.uniform(0, 4, count), rng.random(count) < 0.7


@pytest.mark.parametrize(
    ("problem", "depth", "half_angle", "speed"),
    [(PROBLEM, 2.0, np.pi / 3, 4.0), (WIDE, 3.0, np.pi / 4, 1.0)],
    ids=["triangle", "sector"],
)
def test_price_takes_the_least_sum_of_information_and_steps(problem, depth, half_angle, speed):
    rng, policy, far = np.random.default_rng(0), heuristic_policy("price", problem, depth), 0
    for _ in range(200):
        pose, mean, log_dets, present = scattered(rng)
        if not present.any():
            continue
        steps = np.array([way(pose, point, half_angle, depth, np.pi / 3, speed) for point in mean])
        choice = min(np.flatnonzero(present), key=lambda j, cost=log_dets + 0.5 * steps: cost[j])
        far += log_dets[choice] > log_dets[present].min()
        _, control = decide(policy, seen(pose, mean, log_dets, present), KEY)
        assert steered_to(control, pose, mean[choice])
    assert far > 20, "the price matters"


def test_price_without_a_drive_ignores_what_stays_out_of_reach():
    """Of two targets the less certain one is too far to be seen, ever."""
    policy = heuristic_policy("price", TURNING, 6.0)
    mean = np.array([[0.0, 20.0], [0.0, -4.0]])
    _, control = decide(policy, seen([0, 0, 0], mean, [-3.0, 5.0], np.ones(2, bool)), KEY)
    assert control[0] == pytest.approx(-1.0)


def best_places(agent, mean, depth):
    """The most means within `depth` of a place, and all places that have them: midway, or half a depth before one.

    Places outside of the box of the means are moved to its border.
    """
    places = [0.5 * (a + b) for a, b in combinations(mean, 2)]
    places += [p + 0.5 * depth * (agent - p) / np.linalg.norm(agent - p) for p in mean]
    places = np.clip(places, mean.min(axis=0), mean.max(axis=0))
    counts = np.array([(np.linalg.norm(mean - place, axis=1) <= depth).sum() for place in places])
    return counts.max(), places[counts == counts.max()]


def test_the_post_is_the_nearest_place_with_the_most_in_reach():
    rng, post, counts = np.random.default_rng(1), Post(PROBLEM, 4.0), set()
    start = jax.jit(lambda observation: post.start(observation))
    for _ in range(60):
        pose, mean, log_dets, present = scattered(rng)
        mean *= 0.8
        if not present.any():
            continue
        count, places = best_places(pose[:2], mean[present], 4.0)
        nearest = places[np.argmin(np.linalg.norm(places - pose[:2], axis=1))]
        np.testing.assert_allclose(start(seen(pose, mean, log_dets, present)), nearest, atol=1e-9)
        counts.add(count)
    assert len(counts) > 2, "different numbers are in reach"


def test_a_post_is_within_the_given_box_and_defined_without_targets():
    box = jnp.array([[1.0, -2.0], [3.0, 4.0]])
    for present in (np.ones(2, bool), np.zeros(2, bool)):
        place = Post(PROBLEM, 4.5, box).start(seen([9, 9, 0], [[0.0, 0.0], [2.0, 8.0]], np.zeros(2), present))
        np.testing.assert_allclose(place, [1.0, 4.0] if present.all() else [2.0, 1.0])
    alone = Post(PROBLEM, 4.0).start(seen([9, 9, 0], [[0.0, 0.0]], np.zeros(1), np.zeros(1, bool)))
    np.testing.assert_allclose(alone, [9, 9])


def test_at_its_post_it_turns_from_target_to_target_and_stays():
    """Two targets apart; the agent goes between them, and looks at the less certain one of those in reach."""
    policy = heuristic_policy("post", PROBLEM, 2.0)
    mean, log_dets = np.array([[4.0, 1.5], [4.0, -1.5], [30.0, 0.0]]), np.array([0.0, 0.0, -9.0])
    pose, memory = np.zeros(3), policy.start(seen(np.zeros(3), mean, log_dets, np.ones(3, bool)))
    step = jax.jit(lambda observation, memory: policy(observation, memory, KEY))
    for _ in range(12):
        action, memory = step(seen(pose, mean, log_dets, np.ones(3, bool)), memory)
        pose = np.asarray(PROBLEM.agent.move(jnp.asarray(pose), action, PROBLEM.tau))
    place = pose[:2]
    assert np.linalg.norm(place - [4, 0]) < 0.2
    for least, other in ((0, 1), (1, 0)):
        log_dets[[least, other]] = 0.0, 5.0
        for _ in range(4):
            action, memory = step(seen(pose, mean, log_dets, np.ones(3, bool)), memory)
            pose = np.asarray(PROBLEM.agent.move(jnp.asarray(pose), action, PROBLEM.tau))
        np.testing.assert_array_equal(pose[:2], place)
        assert bearing_to(pose, mean[least]) == pytest.approx(0, abs=1e-6)
    away = mean + 50.0  # nobody in reach: to the nearest
    action, _ = step(seen(pose, away, log_dets, np.ones(3, bool)), memory)
    goal = away[np.argmin(np.linalg.norm(away - place, axis=1))]
    turn = np.clip(bearing_to(pose, goal), -np.pi / 3, np.pi / 3)
    np.testing.assert_allclose(PROBLEM.agent.control(action), [0.0, turn], atol=1e-9)


def test_a_post_without_a_drive_is_where_the_agent_stands():
    policy = heuristic_policy("post", TURNING, 6.0)
    mean, present = np.array([[0.0, 5.0], [0.0, -4.0]]), np.ones(2, bool)
    for log_dets, turn in (([1.0, 2.0], 1.0), ([2.0, 1.0], -1.0)):
        _, control = decide(policy, seen([0, 0, 0], mean, log_dets, present), KEY)
        np.testing.assert_allclose(control, [turn])
