"""Motion of targets over any length of time: A(dt), B(dt), W(dt), for a robot whose loop has no fixed rate."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm, logm

from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.scenario.scenario import Scenario
from foveate.scenario.target import AccelerationTarget, StaticTarget, VelocityTarget

Matrices = tuple[Float[np.ndarray, "n_y n_y"], Float[np.ndarray, "n_y m_y"], Float[np.ndarray, "n_y n_y"]]
"""A, B and W."""
_TOLERANCE = 1e-5
"""Largest difference of the matrices of one step from those that are found again: rounding in float32."""


def motion_over(problem: Problem | Scenario) -> Callable[[float], Matrices]:
    """Function of a length of time [s]: the matrices A, B and W of targets over it.

    Exact for the kinds of targets in continuous time. Others are those of a step of tau, as if they came from
    dy = F y dt + G xi dt + noise of density Q: for the drift target A = I, B = I dt / tau and W(dt) = W dt / tau. The
    function raises InputError where the matrices of a step come from no such motion, or have a schedule.
    """
    if isinstance(problem, Scenario):
        scenario, target = problem, problem.target
        if not scenario.schedule.W and isinstance(target, VelocityTarget | AccelerationTarget | StaticTarget):
            return lambda dt_s: target.motion(scenario.dimension, dt_s)[:3]
        problem = scenario.problem()
    return _Discrete(problem).over


class _Discrete:
    """Continuous motion behind the matrices of one step, found when it is first needed."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self._found = problem, None
        period = problem.period
        A, B, W = (np.asarray(x, float)[0] for x in (period.motion.A, period.motion.B, period.motion.W))
        is_walk = len(period.tau) == 1 and np.array_equal(A, np.eye(len(A)))
        self._walk = (B / float(period.tau[0]), W / float(period.tau[0])) if is_walk else None

    def over(self, dt_s: float) -> Matrices:
        """Matrices over a length of time, by Van Loan (1978); at once for a walk, whose A is the identity."""
        if self._walk is not None:
            B, W = (dt_s * rate for rate in self._walk)
            return np.eye(len(W)), B, W
        if self._found is None:
            self._found = self._continuous()
        F, Q = self._found
        n = len(Q)
        moved = expm(F * dt_s)
        blocks = expm(np.block([[-F[:n, :n], Q], [np.zeros((n, n)), F[:n, :n].T]]) * dt_s)
        W = blocks[n:, n:].T @ blocks[:n, n:]
        return moved[:n, :n], moved[:n, n:], 0.5 * (W + W.T)

    def _continuous(self) -> tuple[np.ndarray, np.ndarray]:
        """[[F, G], [0, 0]] and Q of which the matrices of a step are A, B and W."""
        period = self._problem.period
        A, B, W = (np.asarray(x, float) for x in (period.motion.A, period.motion.B, period.motion.W))
        if len(period.tau) > 1:
            raise InputError("dt_s: the scenario has a schedule, whose steps have lengths of their own; leave dt_s out")
        (A,), (B,), (W,), tau = A, B, W, float(period.tau[0])
        n, m = B.shape
        step = np.block([[A, B], [np.zeros((m, n)), np.eye(m)]])
        problem = f"dt_s: the matrices of a target are those of a step of {tau:g} s, of no motion in continuous time"
        if abs(np.linalg.det(A)) < 1e-12:
            raise InputError(problem)
        F = np.asarray(logm(step)) / tau
        if np.abs(np.imag(F)).max() > _TOLERANCE or np.abs(expm(F.real * tau) - step).max() > _TOLERANCE:
            raise InputError(problem)
        F = F.real
        # W = int_0^tau exp(F s) Q exp(F s)^T ds is linear in Q: with vec, exp(F s) x exp(F s) = exp((F + F) s).
        both = np.kron(F[:n, :n], np.eye(n)) + np.kron(np.eye(n), F[:n, :n])
        big = expm(np.block([[both, np.eye(n * n)], [np.zeros((n * n, 2 * n * n))]]) * tau)[: n * n, n * n :]
        Q = np.linalg.solve(big, W.reshape(-1)).reshape(n, n)
        Q = 0.5 * (Q + Q.T)
        if np.linalg.eigvalsh(Q)[0] < -_TOLERANCE * max(np.abs(Q).max(), 1e-30):
            raise InputError(problem)
        return F, Q
