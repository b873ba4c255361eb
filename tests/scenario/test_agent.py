"""Settings of agents: every command reaches its axis within its limits; wrong settings are rejected."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.rejections import assert_rejected

from foveate.scenario.agent import DifferentialDrive, FixedWing, FreeBody, Quadrotor

AGENTS = {
    "drive": (DifferentialDrive(space="spatial", v_max_m_s=2.0, w_max_rad_s=0.5), {0: (0.0, 2.0), 5: (-0.5, 0.5)}),
    "quadrotor": (
        Quadrotor(kind="quadrotor", v_max_m_s=3.0, climb_max_m_s=1.0, yaw_rate_max_rad_s=2.0),
        {0: (-3.0, 3.0), 1: (-3.0, 3.0), 2: (-1.0, 1.0), 5: (-2.0, 2.0)},
    ),
    "wing": (
        FixedWing(kind="fixed_wing"),
        {0: (10.0, 20.0), 3: (-1.0, 1.0), 4: (-0.5, 0.5), 5: (-0.2, 0.2)},
    ),
    "free": (
        FreeBody(kind="body", axes=("wy", "vx"), lower=(-1.0, 0.0), upper=(2.0, 3.0)),
        {0: (0.0, 3.0), 4: (-1.0, 2.0)},
    ),
}
"""Settings, and the limits of each axis of the twist [v_x, v_y, v_z, w_x, w_y, w_z] that they command."""


@pytest.mark.parametrize("name", AGENTS)
def test_every_command_reaches_its_axis_within_its_limits(name):
    settings, limits = AGENTS[name]
    agent = settings.agent()
    assert agent.axes == tuple(limits)
    for end, side in ((-1.0, 0), (1.0, 1)):
        twist = np.zeros(6)
        for axis, both in limits.items():
            twist[axis] = both[side]
        np.testing.assert_allclose(agent.twist(jnp.full(len(limits), end)), twist, rtol=1e-12)


def test_commands_are_in_the_order_of_the_axes():
    """That of a command in the settings; the agent's own is the order of the twist."""
    commands = ((-1.0, 0.0), (2.0, 3.0), (0.5, 1.0))
    body = FreeBody(kind="body", axes=("wy", "vx"), lower=(-1.0, 0.0), upper=(2.0, 3.0), commands=commands)
    np.testing.assert_array_equal(body.agent().commands, np.array(commands)[:, ::-1])
    drive = DifferentialDrive(commands=((0.0, 1.0), (4.0, -1.0)))
    np.testing.assert_array_equal(drive.agent().commands, [[0, 1], [4, -1]])
    assert DifferentialDrive().agent().commands is None


BAD = {
    "command too fast": (lambda: DifferentialDrive(commands=((0.0, 0.0), (5.0, 0.0))), "commands = (5.0, 0.0)"),
    "command of one number": (
        lambda: Quadrotor(kind="quadrotor", commands=((1.0,),)),
        "commands = ((1.0,),): expected shape any x 4",
    ),
    "no command": (lambda: FixedWing(kind="fixed_wing", commands=()), "commands = ()"),
    "speeds": (lambda: DifferentialDrive(v_min_m_s=2.0, v_max_m_s=2.0), "v_max_m_s = 2.0"),
    "turn rate": (lambda: DifferentialDrive(w_max_rad_s=0.0), "w_max_rad_s = 0.0"),
    "no axis": (lambda: FreeBody(kind="body", axes=(), lower=(), upper=()), "axes = ()"),
    "unknown axis": (lambda: FreeBody(kind="body", axes=("w",), lower=(-1.0,), upper=(1.0,)), "no axis 'w'"),
    "axis twice": (
        lambda: FreeBody(kind="body", axes=("vx", "vx"), lower=(0.0,) * 2, upper=(1.0,) * 2),
        "each axis once",
    ),
    "limits of another number": (lambda: FreeBody(kind="body", axes=("vx",), lower=(), upper=(1.0,)), "lower = ()"),
    "limits crossed": (lambda: FreeBody(kind="body", axes=("vx",), lower=(1.0,), upper=(0.0,)), "upper = (0.0,)"),
    "no climb": (lambda: Quadrotor(kind="quadrotor", climb_max_m_s=0.0), "climb_max_m_s = 0.0"),
    "hovering wing": (lambda: FixedWing(kind="fixed_wing", v_min_m_s=0.0), "v_min_m_s = 0.0"),
    "slow wing": (lambda: FixedWing(kind="fixed_wing", v_max_m_s=5.0), "v_max_m_s = 5.0"),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    assert_rejected(*BAD[name])
