"""The agent's body: limits that hold to the last bit, and motion against numerical integration of the kinematics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from foveate.geometry.space import SPACES
from foveate.models.agent import Agent

LIMITS = {
    "paper": ([0.0, -np.pi / 3], [4.0, np.pi / 3]),
    "reverse": ([-0.7, -0.1], [0.3, 2.9]),
    "never stops": ([0.1, -1.0], [1.3, 1.0]),
}


def drive(limits, dtype=float):
    lower, upper = LIMITS[limits]
    return Agent(SPACES["planar"], (0, 2), jnp.asarray(lower, dtype), jnp.asarray(upper, dtype))


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_limits_hold_exactly_whatever_the_action(limits, dtype):
    agent = drive(limits, dtype)
    rng = np.random.default_rng(0)
    near = 1 + np.arange(-20, 21)[:, None] * np.finfo(dtype).eps * np.ones(2)
    actions = np.concatenate([near, -near, rng.uniform(-1, 1, (2000, 2)), rng.normal(0, 1e6, (200, 2))])
    actions = np.concatenate([actions, [[np.inf, -np.inf], [0, 0]]]).astype(dtype)
    control, back = map(np.asarray, jax.jit(jax.vmap(lambda a: (c := agent.control(a), agent.action(c))))(actions))
    assert control.dtype == dtype
    assert (control >= np.asarray(agent.lower)).all()
    assert (control <= np.asarray(agent.upper)).all()
    inside = np.abs(actions) <= 1
    lower, upper = (np.asarray(x, float) for x in LIMITS[limits])
    expected = lower + (np.clip(actions, -1, 1) + 1) / 2 * (upper - lower)
    np.testing.assert_allclose(control, expected, rtol=0, atol=8 * np.finfo(dtype).eps * np.abs(upper).max())
    np.testing.assert_array_equal(control[(actions >= 1).all(axis=1)][0], agent.upper)
    np.testing.assert_array_equal(control[(actions <= -1).all(axis=1)][0], agent.lower)
    np.testing.assert_allclose(back[inside], actions[inside], rtol=0, atol=40 * np.finfo(dtype).eps)
    assert (np.abs(back) <= 1).all()


def test_action_of_an_unreachable_control_is_the_nearest():
    agent = drive("never stops")
    np.testing.assert_allclose(agent.control(agent.action(jnp.array([0.0, 9.0]))), [0.1, 1.0], atol=1e-15)


COMMANDS = np.array([[0.0, -1.0], [0.0, 1.0], [4.0, 0.0], [2.0, 0.5]])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_set_of_commands(dtype):
    """Always one of them to the last bit, the nearest in units of the limits; its own action has each command."""
    free = drive("paper", dtype)
    agent = Agent(free.space, free.axes, free.lower, free.upper, jnp.asarray(COMMANDS, dtype))
    actions = np.random.default_rng(0).uniform(-1.5, 1.5, (500, 2)).astype(dtype)
    found = np.asarray(jax.jit(jax.vmap(agent.control))(actions))
    assert found.dtype == dtype
    scale = np.array([4.0, 2 * np.pi / 3])
    wanted = (np.clip(actions, -1, 1) + 1) / 2 * scale + [0.0, -np.pi / 3]
    order = [int(np.argmin([np.hypot(*((command - each) / scale)) for command in COMMANDS])) for each in wanted]
    assert len(set(order)) == 4
    np.testing.assert_array_equal(found, COMMANDS.astype(dtype)[order])
    own = jax.vmap(lambda command: agent.control(agent.action(command)))(agent.commands)
    np.testing.assert_array_equal(own, agent.commands)


def test_the_derivative_of_a_set_of_commands_is_that_of_the_limits():
    free = drive("paper")
    agent = Agent(free.space, free.axes, free.lower, free.upper, jnp.asarray(COMMANDS))
    action = jnp.array([0.2, -0.3])
    np.testing.assert_allclose(jax.jacobian(agent.control)(action), np.diag([2.0, np.pi / 3]), atol=1e-12)


def test_twist_puts_every_command_on_its_axis():
    limits = jnp.array([1.0, 2.0, 3.0, 4.0])
    agent = Agent(SPACES["spatial"], (0, 2, 1, 5), -limits, limits)
    np.testing.assert_allclose(agent.twist(jnp.ones(4)), [1, 3, 2, 0, 0, 4])


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-8), (np.float32, 3e-6)])
def test_planar_motion_solves_the_unicycle_equation(dtype, tolerance):
    limit = jnp.array([3.0, 3.0], dtype)
    agent = Agent(SPACES["planar"], (0, 2), -limit, limit)
    pose, v = np.array([1.0, -2.0, 2.5], dtype), 2.3

    @jax.jit
    def move(control, tau):
        action = agent.action(control)
        return agent.control(action), agent.move(jnp.asarray(pose), action, tau)

    for w in (0.0, 1e-12, -1e-8, 1e-5, -1e-3, 0.1, 1.0, -2.9, 2.9):
        for tau in (0.1, 1.0):
            control, moved = move(np.array([v, w], dtype), np.asarray(tau, dtype))
            assert moved.dtype == dtype
            assert w != 0.0 or control[1] == 0.0, "standing straight ahead must be possible exactly"
            exact = solve_ivp(unicycle, (0, tau), pose.astype(float), "DOP853", rtol=1e-12, atol=1e-12, args=(v, w))
            np.testing.assert_allclose(moved, exact.y[:, -1], atol=tolerance)


def unicycle(t, state, v, w):
    return [v * np.cos(state[2]), v * np.sin(state[2]), w]


def test_spatial_motion_solves_the_rigid_body_equation():
    """d/dt position = R v, d/dt R = R hat(w), integrated with R as nine numbers."""
    limits = 3.0 * jnp.ones(6)
    agent = Agent(SPACES["spatial"], tuple(range(6)), -limits, limits)
    twist, tau = np.array([1.0, -0.5, 0.3, 0.4, -0.9, 1.1]), 0.8
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = Rotation.from_rotvec([0.3, 1.0, -2.0]).as_matrix(), [1, 2, 3]

    def rate(t, flat):
        R, w = flat[3:].reshape(3, 3), twist[3:]
        return np.concatenate([R @ twist[:3], np.cross(R, w).ravel()])

    flat = np.concatenate([start[:3, 3], start[:3, :3].ravel()])
    # A row r of R hat(w) is hat(w)^T r = -w x r = r x w.
    end = solve_ivp(rate, (0, tau), flat, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    moved = jax.jit(lambda u, tau: agent.move(jnp.asarray(start), agent.action(u), tau))(twist, tau)
    np.testing.assert_allclose(moved[:3, 3], end[:3], atol=1e-8)
    np.testing.assert_allclose(moved[:3, :3], end[3:].reshape(3, 3), atol=1e-8)
