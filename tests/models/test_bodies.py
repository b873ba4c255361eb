"""Ways past bodies: against brute force along the way, shapely's discs, and simulated drives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from foveate.models.bodies import aim_past, share_clear

SHARES = np.linspace(0.0, 1.0, 2001)


def ways(count, d):
    """Starts about the origin, and ends; some along one axis, some nowhere."""
    rng = np.random.default_rng(d)
    before = rng.uniform(-2.0, 3.0, (count, d))
    way = rng.normal(0, 3, (count, d)) * (rng.uniform(size=(count, d)) < 0.8)
    return before, before + way


@pytest.mark.parametrize("d", [2, 3])
def test_a_way_ends_where_a_fine_walk_along_it_comes_too_near(d):
    before, after = ways(200, d)
    rng = np.random.default_rng(7)
    points = (before + rng.uniform(size=(200, 1)) * (after - before))[:, None] + rng.normal(0, 1.5, (200, 3, d))
    exist, distance = rng.uniform(size=(200, 3)) < 0.7, 0.8
    apart = np.linalg.norm(before[:, None] - points, axis=-1)
    exist &= apart > distance
    walk = before[:, None] + SHARES[:, None] * (after - before)[:, None]
    gaps = np.linalg.norm(walk[:, :, None] - points[:, None], axis=-1)
    near = ((gaps < distance) & exist[:, None]).any(axis=-1)
    expected = np.where(near.any(axis=1), SHARES[near.argmax(axis=1)], 1.0)
    clear = jax.jit(jax.vmap(lambda *each: share_clear(*each, jnp.asarray(distance))))
    found = clear(before, after, points, exist)
    np.testing.assert_allclose(found, expected, atol=1e-3)
    assert 25 < near.any(axis=1).sum() < 175, "else one of the cases is not tested"


def test_too_near_a_point_a_way_may_only_lead_away():
    point, exist, distance = jnp.zeros((1, 2)), jnp.ones(1, bool), jnp.asarray(1.0)
    start = jnp.array([0.5, 0.0])
    for end, share in (([0.4, 0.0], 0.0), ([0.4, 2.0], 0.0), ([0.5, 2.0], 1.0), ([3.0, 0.0], 1.0), ([0.5, 0.0], 1.0)):
        assert share_clear(start, jnp.array(end), point, exist, distance) == share, end
    assert share_clear(start, jnp.array([0.4, 0.0]), jnp.zeros((0, 2)), jnp.ones(0, bool), distance) == 1.0


def planes(count):
    """Random goals, standoffs and bodies around an agent at the origin that is not too near to any."""
    rng = np.random.default_rng(4)
    goals, bodies = rng.uniform(-8, 8, (count, 2)), rng.uniform(-6, 6, (count, 3, 2))
    there = (rng.uniform(size=(count, 3)) < 0.8) & (np.linalg.norm(bodies, axis=-1) > 1.0)
    return goals, rng.uniform(0, 3, count), bodies, there


def test_the_aim_is_the_goal_unless_a_disc_is_on_the_way():
    """By shapely: the way, as far as it is driven, and discs of the kept distance; a disc about the goal is none."""
    inputs, radius = planes(1500), 0.96
    radii = jnp.full(3, radius)
    aims = np.asarray(jax.jit(jax.vmap(lambda *each: aim_past(*each, radii)))(*inputs))
    changed = 0
    for aim, goal, standoff, bodies, there in zip(aims, *inputs, strict=True):
        discs = shapely.buffer(shapely.points(bodies[there]), radius, quad_segs=200)
        length = np.hypot(*goal)
        way = shapely.LineString([(0, 0), goal * max(length - standoff, 0.0) / length])
        hits = [disc for disc in discs if way.intersects(disc) and not disc.contains(shapely.Point(goal))]
        if not hits:
            np.testing.assert_allclose(aim, goal, atol=1e-9)
            continue
        changed += 1
        first = min(hits, key=lambda disc: shapely.distance(shapely.Point(0, 0), way.intersection(disc)))
        tangent = shapely.LineString([(0, 0), aim])
        # On the tangent: it touches the disc, to the precision of its polygon, and does not enter it.
        assert shapely.distance(tangent, first.centroid) == pytest.approx(radius, abs=2e-3)
        assert np.hypot(*aim) == pytest.approx(length, abs=1e-5)
        # On the goal's side.
        middle = np.asarray(first.centroid.coords[0])
        side = np.array([-middle[1], middle[0]])
        assert np.sign(side @ aim) == np.sign(side @ goal)
    assert 90 < changed < 1410, "else one of the cases is not tested"


@pytest.mark.parametrize("d", [2, 3])
def test_straight_behind_a_body_and_nearer_than_kept_the_aim_leads_away(d):
    body, nobody = jnp.eye(d)[:1] * 3.0, jnp.zeros(1, bool)
    goal, one, radius = jnp.eye(d)[0] * 6.0, jnp.ones(1, bool), jnp.array([1.2])
    aim = np.asarray(aim_past(goal, 0.0, body, one, radius))
    angle = np.arcsin(1.2 / 3.0)
    expected = 6.0 * np.array([np.cos(angle), np.sin(angle), 0.0])[:d]
    np.testing.assert_allclose(aim, expected, atol=1e-5)
    np.testing.assert_array_equal(aim_past(goal, 0.0, body, nobody, radius), goal)
    np.testing.assert_array_equal(aim_past(goal, 0.0, jnp.zeros((0, d)), jnp.zeros(0, bool), jnp.zeros(0)), goal)
    # The way ends before the body, or the body is at the goal, or behind.
    for standoff, place in ((4.5, 3.0), (0.0, 5.5), (0.0, -1.1)):
        np.testing.assert_array_equal(aim_past(goal, standoff, jnp.eye(d)[:1] * place, one, radius), goal)
    above = np.asarray(aim_past(goal[::-1], 0.0, body[:, ::-1], one, radius))  # straight above, in space
    np.testing.assert_allclose(np.sort(np.abs(above))[-2:], np.sort(np.abs(expected))[-2:], atol=1e-5)
    for off in (1.1e-6, 2e-6, 1e-5):  # hardly beside
        almost = np.asarray(aim_past(goal.at[1].set(6.0 * off), 0.0, body, one, radius))
        np.testing.assert_allclose(almost, expected, atol=1e-3)
    near = np.asarray(aim_past(goal + 0.1, 0.0, body / 3.0, one, radius))
    assert near[0] < 0 < near[1], "beside the body and a little away from it"


def test_gradients_of_an_aim_are_those_of_differences_and_finite_in_padding():
    bodies = jnp.array([[3.0, 0.4], [jnp.nan, 0.0]])
    value = jax.jit(
        lambda goal: jnp.sum(jnp.sin(aim_past(goal, 0.5, bodies, jnp.array([True, False]), jnp.full(2, 1.2))))
    )
    goal = jnp.array([7.0, 0.3])
    slope = np.asarray(jax.grad(value)(goal))
    for i, step in enumerate(1e-6 * np.eye(2)):
        assert slope[i] == pytest.approx(float(value(goal + step) - value(goal - step)) / 2e-6, abs=1e-6)
    assert np.isfinite(jax.grad(value)(jnp.zeros(2))).all()
