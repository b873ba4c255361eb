"""Borders and distances against brute force along the way, and against exact reflection in a folded line."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.geometry.space import SPACES
from foveate.models.bodies import Bodies, share_clear
from foveate.models.region import Region
from foveate.scenario.agent import FreeBody
from foveate.scenario.field_of_view import ConeView
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

LOW, HIGH = np.array([-2.0, 1.0, 0.0]), np.array([3.0, 4.0, 10.0])
SHARES = np.linspace(0.0, 1.0, 2001)


def region(d=3, restitution=1.0, **kinds):
    return Region(jnp.asarray(LOW[:d]), jnp.asarray(HIGH[:d]), jnp.asarray(restitution), **kinds)


def ways(count, d):
    """Starts inside of the region, and ends anywhere about it; some along one axis, some nowhere."""
    rng = np.random.default_rng(d)
    before = rng.uniform(LOW[:d], HIGH[:d], (count, d))
    way = rng.normal(0, 3, (count, d)) * (rng.uniform(size=(count, d)) < 0.8)
    return before, before + way


@pytest.mark.parametrize("d", [2, 3])
def test_a_way_ends_where_a_fine_walk_along_it_meets_the_border(d):
    before, after = ways(200, d)
    walk = before[:, None] + SHARES[:, None] * (after - before)[:, None]
    outside = ((walk < LOW[:d]) | (walk > HIGH[:d])).any(axis=-1)
    expected = np.where(outside.any(axis=1), SHARES[outside.argmax(axis=1)], 1.0)
    found = np.asarray(jax.jit(jax.vmap(region(d).share_inside))(before, after))
    np.testing.assert_allclose(found, expected, atol=1e-3)
    assert ((found == 1.0) == ~outside.any(axis=1)).all()
    assert 25 < (found < 1).sum() < 175, "else one of the cases is not tested"
    stays = np.asarray(jax.jit(jax.vmap(region(d, agent="stay").share_inside))(before, after))
    np.testing.assert_array_equal(stays, np.where(found < 1, 0.0, 1.0))


def test_a_way_that_begins_outside_may_only_lead_inwards():
    box = region(2)
    assert box.share_inside(jnp.array([5.0, 2.0]), jnp.array([6.0, 2.0])) == 0.0
    assert box.share_inside(jnp.array([5.0, 2.0]), jnp.array([2.0, 3.0])) == 1.0


def test_gradients_of_a_stopped_way_are_those_of_differences():
    """Of the position where the way ends, at a border and at a target, by where it would have ended."""
    box, points = region(2), jnp.array([[0.0, 2.0]])

    def at_border(after):
        before = jnp.array([1.0, 2.0])
        return jnp.sum(jnp.array([1.0, 2.0]) * (before + box.share_inside(before, after) * (after - before)))

    def at_target(after):
        before = jnp.array([2.0, 2.5])
        share = share_clear(before, after, points, jnp.ones(1, bool), jnp.asarray(0.7))
        return jnp.sum(jnp.array([1.0, 2.0]) * (before + share * (after - before)))

    for value, after in ((at_border, [4.5, 3.0]), (at_target, [-0.5, 1.8])):
        slope, value = np.asarray(jax.jit(jax.grad(value))(jnp.array(after))), jax.jit(value)
        assert np.abs(slope).max() > 0.05
        for i, step in enumerate(1e-6 * np.eye(2)):
            difference = (value(jnp.array(after + step)) - value(jnp.array(after - step))) / 2e-6
            np.testing.assert_allclose(slope[i], difference, atol=1e-7)
    standing = jax.jit(jax.grad(lambda after: at_target(after) + at_border(after)))(jnp.array([2.0, 2.5]))
    assert np.isfinite(standing).all()


def test_a_straight_flight_between_walls_is_a_folded_line():
    """Without loss, a flight in small steps is the exact triangle wave of its free flight, at the same speed."""
    box, tau, steps = region(2), 0.1, 400
    start, velocity = np.array([0.3, 2.0]), np.array([1.7, -0.9])

    def step(carry, _):
        position, velocity = carry
        after = box.put_back(position + tau * velocity, velocity)
        return after, after

    begin = (jnp.asarray(start), jnp.asarray(velocity))
    found, speeds = (np.asarray(x) for x in jax.lax.scan(step, begin, length=steps)[1])
    free = start + tau * velocity * np.arange(1, steps + 1)[:, None]
    width = HIGH[:2] - LOW[:2]
    phase = np.mod(free - LOW[:2], 2 * width)
    np.testing.assert_allclose(found, LOW[:2] + np.where(phase > width, 2 * width - phase, phase), atol=1e-9)
    np.testing.assert_allclose(speeds, velocity * np.where(phase > width, -1, 1), atol=1e-12)


def test_loss_at_a_wall_and_targets_that_stop():
    """Beyond a border by h: back inside by e h, velocities outwards times -e, those inwards as they were."""
    position = jnp.array([[3.5, 2.0], [-3.0, 4.25], [0.0, 0.0], [30.0, 2.0]])
    velocity = jnp.array([[1.0, 1.0], [2.0, 0.5], [0.0, -1.0], [9.0, 0.0]])
    damped, slower = region(2, 0.4).put_back(position, velocity)
    np.testing.assert_allclose(damped, [[2.8, 2.0], [-1.6, 3.9], [0.0, 1.4], [-2.0, 2.0]], atol=1e-12)
    np.testing.assert_allclose(slower, [[-0.4, 1.0], [2.0, -0.2], [0.0, 0.4], [-3.6, 0.0]], atol=1e-12)
    stopped, still = region(2, 0.4, targets="stop").put_back(position, velocity)
    np.testing.assert_allclose(stopped, np.clip(position, LOW[:2], HIGH[:2]), atol=0)
    np.testing.assert_allclose(still, [[0.0, 1.0], [2.0, 0.0], [0.0, 0.0], [0.0, 0.0]], atol=0)


FLIGHT = Scenario(
    agent=FreeBody(kind="body", axes=("vx", "wy", "wz"), lower=(-2.0, -1.0, -1.0), upper=(2.0, 1.0, 1.0)),
    view=ConeView(shape="cone"),
    region=RegionSettings(low_m=(-3.0,) * 3, high_m=(3.0,) * 3),
    keep_off_m=1.0,
    scenes=SceneSettings(centre_m=(0.0,) * 3, half_side_m=(1.0,) * 3, drift_m_s=(0.0,) * 3, half_side_per_target_m=0.0),
)


def test_a_stopped_body_turns_as_commanded():
    """In space: the rotation is that of the free motion, the position is on the line to where that ends."""
    problem, space = FLIGHT.problem(), SPACES["spatial"]
    pose = space.upright(jnp.array([2.5, 0.0, 0.0]), jnp.asarray(0.3))
    action, nobody = jnp.array([1.0, 0.2, -0.4]), jnp.zeros(1, bool)
    free = problem.agent.move(pose, action, problem.tau)
    found = problem.move(pose, action, Bodies(jnp.zeros((1, 3)), nobody))
    np.testing.assert_array_equal(found[:3, :3], free[:3, :3])
    way, part = free[:3, 3] - pose[:3, 3], found[:3, 3] - pose[:3, 3]
    np.testing.assert_allclose(np.cross(way, part), 0, atol=1e-12)
    assert found[0, 3] == pytest.approx(3.0, abs=1e-12)
    target = jnp.asarray(pose[:3, 3] + 0.8 * way)[None]
    before_it = problem.move(pose, action, Bodies(target - jnp.array([0.0, 0.0, 0.9]), jnp.ones(1, bool)))
    assert np.linalg.norm(before_it[:3, 3] - target[0] + np.array([0.0, 0.0, 0.9])) >= 1.0 - 1e-9
    inside = space.upright(jnp.zeros(3), jnp.asarray(0.3))
    unstopped = problem.move(inside, action, Bodies(jnp.full((1, 3), 2.0), jnp.ones(1, bool)))
    np.testing.assert_array_equal(unstopped, problem.agent.move(inside, action, problem.tau))
