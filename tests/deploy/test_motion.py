"""Motion over any length of time, against matrix exponentials of the equations of motion."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from foveate.deploy.motion import motion_over
from foveate.errors import InputError
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings
from foveate.scenario.target import AccelerationTarget, DriftTarget, LinearTarget, VelocityTarget

TAU, Q2 = 0.5, np.array([[0.3, 0.1], [0.1, 0.2]])
STILL = SceneSettings(drift_m_s=(0.0, 0.0), jitter_m_s=0.0)
Q = tuple(map(tuple, Q2.tolist()))
zero, one = np.zeros((2, 2)), np.eye(2)
KINDS = {
    # F and the density of the noise, with dy = F y dt + noise.
    "drift": (DriftTarget(W=((0.2, 0.05), (0.05, 0.1))), zero, np.array([[0.4, 0.1], [0.1, 0.2]])),
    "velocity": (
        VelocityTarget(kind="constant_velocity", Q=Q),
        np.block([[zero, one], [zero, zero]]),
        np.block([[zero, zero], [zero, Q2]]),
    ),
    "forgetful": (
        VelocityTarget(kind="constant_velocity", Q=Q, memory_s=2.0),
        np.block([[zero, one], [zero, -0.5 * one]]),
        np.block([[zero, zero], [zero, Q2]]),
    ),
    "acceleration": (
        AccelerationTarget(kind="constant_acceleration", Q=Q),
        np.block([[zero, one, zero], [zero, zero, one], [zero, zero, zero]]),
        np.block([[zero, zero, zero], [zero, zero, zero], [zero, zero, Q2]]),
    ),
}


@pytest.mark.parametrize("dt", [0.05, 0.5, 3.0])
@pytest.mark.parametrize("given", ["scenario", "problem"])
@pytest.mark.parametrize("kind", KINDS)
def test_matrices_are_those_of_the_equation_of_motion(kind, given, dt):
    target, F, density = KINDS[kind]
    scenario = Scenario(tau_s=TAU, target=target)
    A, B, W = motion_over(scenario if given == "scenario" else scenario.problem())(dt)
    noise = quad_vec(lambda s: expm(F * s) @ density @ expm(F * s).T, 0.0, dt)[0]
    # Of a problem only one step is known, from which the motion is found again.
    tolerance = {"rtol": 1e-9, "atol": 1e-11} if given == "scenario" else {"rtol": 1e-6, "atol": 1e-7}
    np.testing.assert_allclose(A, expm(F * dt), **tolerance)
    np.testing.assert_allclose(W, noise, **tolerance)
    if kind == "drift":
        np.testing.assert_allclose(B, dt / TAU * one, **tolerance)
    else:  # a known derivative, held over the step
        into = np.eye(len(F))[:, -2:]
        np.testing.assert_allclose(B, quad_vec(lambda s: expm(F * s) @ into, 0.0, dt)[0], **tolerance)


def test_steps_of_no_motion_in_continuous_time_are_refused():
    def linear(A, W):
        rows = [tuple(map(tuple, np.asarray(x, float).tolist())) for x in (A, W, np.eye(2))]
        return LinearTarget(kind="linear", A=rows[0], B=rows[2], W=rows[1], Z=rows[2], prior=rows[2])

    swap = linear([[0, 1], [1, 0]], np.eye(2))  # no square root
    forgets = linear(np.zeros((2, 2)), np.eye(2))
    for target in (swap, forgets):
        with pytest.raises(InputError, match=r"dt_s: the matrices of a target are those of a step of 0\.5 s"):
            motion_over(Scenario(tau_s=TAU, target=target, scenes=STILL))(0.1)
    with pytest.raises(InputError, match="dt_s: the scenario has a schedule"):
        motion_over(Scenario(schedule=ScheduleSettings(tau_s=(1.0, 0.5))))(0.1)
