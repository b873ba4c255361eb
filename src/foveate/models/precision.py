"""What rounding does to beliefs about targets that stay unseen for long, told before an episode."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from foveate.io.progress import logger
from foveate.models.polar import jacobian, noise
from foveate.models.problem import Problem

TOLERATED_NAT = 0.05
"""Error of a log det that is said nothing about: a twentieth of what tells policies apart."""
BEYOND_REPAIR = 100.0
"""Condition times resolution above which a matrix has no digit of its smallest eigenvalue."""
Matrix = Float[np.ndarray, "n_y n_y"]


class _Motion(NamedTuple):
    """Motion over some steps: P becomes A P A^T + W."""

    A: Matrix
    W: Matrix

    def of(self, covariance: Matrix) -> Matrix:
        return self.A @ covariance @ self.A.T + self.W

    def after(self, first: "_Motion") -> "_Motion":
        return _Motion(self.A @ first.A, self.of(first.W))


def rounds_alike(problem: Problem) -> bool:
    """True if it matters little to the filter that a number is computed several times, and rounded otherwise each time.

    That is what XLA's older emitters do (`foveate.io.jax_settings.quick_compilation`): each element of a matrix product
    computes the inverse that it reads anew. It is harmless for positions. A target that was measured once and whose
    velocity is unknown has pivots of three digits in float32; with several versions of them its information becomes
    indefinite, unless its prediction needs no inverse of it.
    """
    motion = problem.motion
    return motion.state_size == motion.dimension or motion.is_reversible


def suits_quick_compilation(problem: Problem) -> bool:
    """True for a problem in the plane whose filter `rounds_alike`; in space the programs would run for longer."""
    return problem.agent.space.dimension == 2 and rounds_alike(problem)


def warn_of_rounding(problem: Problem, steps: int) -> None:
    """Log a warning if beliefs about targets unseen for up to `steps` lose digits that matter in this precision."""
    lost_nat, unseen = max(rounding_error(own, steps) for own in problem.kinds)
    if lost_nat <= TOLERATED_NAT:
        return
    name = str(problem.motion.A.dtype)
    how = f"may be off by some {lost_nat:.1g} nat" if lost_nat < 1.0 else "are wrong or not finite"
    remedy = "; JAX_ENABLE_X64=1 computes in float64" if name == "float32" else ""
    logger.warning(f"{name} has too few digits for these targets: scores {how} where one is unseen for {unseen} "
                   f"steps and then seen{remedy}")  # fmt: skip


def rounding_error(problem: Problem, steps: int) -> tuple[float, int]:
    """Estimate the error [nat] of log det where a target is detected after having been unseen, and the worst time.

    It is the resolution of the numbers times the condition of the predicted correlations (scales of the axes cost no
    digits), after a detection following 1, 2, 4, .. `steps` steps unseen, each rounded up to whole periods of a
    schedule. Only the order of magnitude is meant: in simulated episodes errors are a third to three times as large.
    For a reversible motion, whose prediction needs no inverse, the root of the condition takes its place, an upper
    bound; beyond BEYOND_REPAIR even the matrix itself has lost its smallest eigenvalue.

    Returns:
        Error [nat], infinite where the condition is beyond float64, and the number of steps unseen.
    """
    period = problem.period
    motions = [_Motion(*map(np.asarray, each)) for each in zip(*_floats(period.motion.A, period.motion.W), strict=True)]
    H, noises = _measured(problem, *_floats(period.V))
    first = np.linalg.inv(np.asarray(problem.prior_information, float))
    resolution = float(np.finfo(np.asarray(problem.motion.A).dtype).eps)
    worst = 0.0, 0
    for unseen, covariance in _unseen(first, motions, steps):
        seen = _detected(covariance, H, noises[unseen % len(noises) - 1])
        predicted = motions[unseen % len(motions)].of(seen)
        condition = max(_condition(covariance), _condition(predicted))
        error = resolution * condition
        if problem.motion.is_reversible:
            error = resolution * condition**0.5 if error < BEYOND_REPAIR else np.inf
        worst = max(worst, (error, unseen))
    return worst


def _measured(problem: Problem, V: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H, and V of each step of a period: of a sensor of ranges and angles, for a target straight ahead in mid-view."""
    polar, depth_m = problem.sensor.polar, float(problem.sensor.view.extent.ahead_m)
    if polar is None:
        return np.asarray(problem.sensor.H, float), V
    point_body = np.eye(problem.motion.dimension)[0] * (0.5 * depth_m if np.isfinite(depth_m) else 1.0)
    H = jacobian(np, polar, point_body) @ np.asarray(problem.motion.Z, float)
    return H, np.array([noise(np, polar, each, point_body) for each in V])


def _floats(*arrays: object) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(array, float) for array in arrays)


def _unseen(first: Matrix, motions: list[_Motion], steps: int) -> Iterator[tuple[int, Matrix]]:
    """Covariances after so many steps without a detection: each of the first period, then twice as many, to the end."""
    covariance = first
    for k, motion in enumerate(motions[:steps], start=1):
        covariance = motion.of(covariance)
        yield k, covariance
    whole = motions[0]
    for motion in motions[1:]:
        whole = motion.after(whole)
    powers = [whole]  # of 1, 2, 4, .. periods
    while len(motions) << len(powers) <= steps:
        powers.append(powers[-1].after(powers[-1]))
        yield len(motions) << (len(powers) - 1), powers[-1].of(first)
    periods, covariance = steps // len(motions), first
    for i, power in enumerate(powers):
        if periods >> i & 1:
            covariance = power.of(covariance)
    if periods:
        yield periods * len(motions), covariance


def _detected(covariance: Matrix, H: np.ndarray, V: np.ndarray) -> Matrix:
    """Covariance after a detection, in Joseph's form, which stays positive."""
    gain = np.linalg.solve(H @ covariance @ H.T + V, H @ covariance).T
    rest = np.eye(len(covariance)) - gain @ H
    return rest @ covariance @ rest.T + gain @ V @ gain.T


def _condition(covariance: Matrix) -> float:
    """Condition of the correlations; infinite where rounding in float64 hides it."""
    variances = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variances > 0).all()):
        return np.inf
    values = np.linalg.eigvalsh(covariance / np.sqrt(np.outer(variances, variances)))
    return float(values[-1] / values[0]) if values[0] > 0 else np.inf
