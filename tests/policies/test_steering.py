"""The steering law brings points into view, in as many steps as it says, for every kind of agent."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.geometry.space import SPACES
from foveate.models.agent import Agent
from foveate.policies.steering import MAX_STEPS, MAX_UNIT, limit, steer, steps_to_view, view_units
from foveate.scenario.agent import DifferentialDrive, FreeBody, Quadrotor
from foveate.scenario.field_of_view import ConeView, SectorView

TAU = jnp.asarray(0.5)
SECTOR = SectorView(depth_m=6.0, angle_deg=60.0).view()
CONE = ConeView(shape="cone", depth_m=6.0, angle_deg=60.0).view()
DRIVE = DifferentialDrive(v_max_m_s=2.0, w_max_rad_s=0.6).agent()
PAN = FreeBody(kind="body", space="planar", axes=("wz",), lower=(-0.6,), upper=(0.6,)).agent()
HOLONOMIC = FreeBody(
    kind="body", space="planar", axes=("vx", "vy", "wz"), lower=(-2.0, -1.0, -0.6), upper=(2.0, 1.0, 0.6)
).agent()
QUADROTOR = Quadrotor(kind="quadrotor").agent()
PAN_TILT = FreeBody(kind="body", axes=("wy", "wz"), lower=(-0.6, -0.6), upper=(0.6, 0.6)).agent()


def follow(agent: Agent, point_world, steps: int, standoff_m: float = 3.0):
    """Poses of an agent that steers from the origin to a fixed point, (steps + 1) of them."""

    def step(pose, _):
        pose = agent.move(pose, steer(agent, TAU, agent.space.to_body(pose, point_world), standoff_m), TAU)
        return pose, pose

    first = agent.space.identity()
    return jnp.concatenate([first[None], jax.lax.scan(step, first, None, steps)[1]])


@pytest.mark.parametrize(
    ("agent", "view"), [(DRIVE, SECTOR), (PAN, SECTOR), (HOLONOMIC, SECTOR), (QUADROTOR, CONE), (PAN_TILT, CONE)]
)
def test_points_come_into_view_in_about_the_steps_it_says(agent, view):
    rng = np.random.default_rng(0)

    @jax.jit
    def run(point):
        body = jax.vmap(lambda pose: agent.space.to_body(pose, point))(follow(agent, point, 80))
        return view.contains(body), steps_to_view(agent, TAU, view.extent, point)

    for _ in range(60):
        point = rng.uniform(-12, 12, agent.space.dimension) * (1.0, 1.0, 0.4)[: agent.space.dimension]
        if "vx" not in [agent.space.axes[axis] for axis in agent.axes]:
            point *= 5.5 / np.linalg.norm(point)
        visible, parts = run(jnp.asarray(point))
        assert visible[-1]
        taken, expected = int(jnp.argmax(visible)), float(parts.sum())
        assert abs(taken - expected) <= 3.0 + 0.4 * expected


def test_one_step_ends_at_the_standoff_and_faces_the_point():
    for agent in (DRIVE, HOLONOMIC):
        point = jnp.asarray([3.9, 0.3])
        body = agent.space.to_body(follow(agent, point, 1)[1], point)
        np.testing.assert_allclose(jnp.linalg.norm(body), 3.0, atol=0.02)
        assert abs(float(jnp.arctan2(body[1], body[0]))) < 0.05


def test_an_agent_with_sideways_speed_moves_in_a_straight_line():
    """Also while it turns, and where a limit cuts its speed."""
    point = jnp.asarray([-4.0, 9.0])
    positions = np.asarray(jax.vmap(HOLONOMIC.space.position)(follow(HOLONOMIC, point, 6)))
    normal = np.array([9.0, 4.0]) / np.hypot(9.0, 4.0)
    offsets = positions @ normal
    assert np.abs(offsets).max() < 1e-6
    assert np.linalg.norm(positions[-1]) > 2.0


def test_what_cannot_come_into_view_takes_the_most_steps():
    _, drive = steps_to_view(PAN, TAU, SECTOR.extent, jnp.asarray([50.0, 0.0]))
    assert drive == MAX_STEPS
    turn, _ = steps_to_view(PAN, TAU, SECTOR.extent, jnp.asarray([0.0, 5.0]))
    np.testing.assert_allclose(turn, (np.pi / 2 - np.pi / 6) / 0.3, rtol=1e-5)


def test_view_units_move_by_the_size_of_the_view():
    """But for MAX_UNIT at most: the depth of 6 m is six times what one period covers from the middle of the range."""
    units = view_units(HOLONOMIC, TAU, SECTOR.extent)
    still = HOLONOMIC.control(jnp.zeros(3))
    np.testing.assert_allclose(
        units * 0.5 * (HOLONOMIC.upper - HOLONOMIC.lower) * TAU, [MAX_UNIT * 1.0, MAX_UNIT * 0.5, np.pi / 6]
    )
    np.testing.assert_allclose(still, 0.0)
    assert limit(HOLONOMIC, "vy") == 1.0
    assert SPACES["planar"].axes == ("vx", "vy", "wz")
