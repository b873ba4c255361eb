"""Beliefs about the targets as numpy arrays, from any tracker: the input of a policy."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from foveate.deploy import kalman
from foveate.errors import InputError
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.simulation.records import Observation

SYMMETRY_TOLERANCE = 1e-5
"""Largest asymmetry of a matrix relative to its largest entry: rounding in float32."""
LARGEST, LARGEST_VARIANCE = 1e18, 1e36
"""Largest size of means and of variances (the least is its inverse): float32 holds the squares of the former."""
MAX_STEPS = 2**31 - 1
"""Most steps left: an int32."""


class Belief:
    """Gaussian beliefs over the states of n targets in the world: means, information matrices, and a mask of padding.

    Attributes are float64 copies with the names of the arguments. Raises InputError for a wrong shape, a number that is
    not finite, and a matrix that is not symmetric and positive definite.

    Args:
        mean: (n, n_y), a row per target, which begins with its position [m].
        covariance: (n, n_y, n_y), or one matrix (n_y, n_y) for all; give this or `information`.
        information: The inverse of `covariance`, likewise.
        present: (n,) of bool, false for rows of padding, which are ignored; by default all true.
        known_input: (n, m_y), the inputs xi that led to a prediction; by default None, which means 0.
        step_s: Length of the predicted step [s], as a `Tracker` knows it; None where it is unknown.
    """

    def __init__(
        self,
        mean: ArrayLike,
        *,
        covariance: ArrayLike | None = None,
        information: ArrayLike | None = None,
        present: ArrayLike | None = None,
        known_input: ArrayLike | None = None,
        step_s: float | None = None,
    ) -> None:
        if (covariance is None) == (information is None):
            raise InputError("covariance, information: expected one of them")
        rows = numbers("mean", mean)
        if rows.ndim != 2 or rows.shape[1] < 1:
            raise InputError(f"mean has shape {rows.shape}: expected (n, n_y), a row a target")
        mask = np.ones(len(rows), bool) if present is None else np.array(present)
        if mask.shape != (len(rows),) or mask.dtype != bool:
            raise InputError(f"present has shape {mask.shape} of {mask.dtype}: expected ({len(rows)},) of bool")
        self.step_s = step_s
        self.present: Bool[np.ndarray, " n"] = mask
        self.mean: Float[np.ndarray, "n n_y"] = _rows("mean", rows, mask)
        self.information: Float[np.ndarray, "n n_y n_y"]
        if covariance is not None:
            self.information = inverses(_matrices("covariance", covariance, mask, rows.shape[1]))
            if not (finite := np.isfinite(self.information).all(axis=(1, 2))).all():
                raise InputError(f"covariance[{finite.argmin()}]: expected one with an inverse")
        else:
            self.information = _matrices("information", information, mask, rows.shape[1])
        self.known_input: Float[np.ndarray, "n m_y"] | None = None
        if known_input is not None:
            self.known_input = _rows("known_input", numbers("known_input", known_input), mask)

    @property
    def covariance(self) -> Float[np.ndarray, "n n_y n_y"]:
        """Inverses of `information`."""
        return np.linalg.inv(self.information)

    @property
    def targets(self) -> int:
        """Number of targets, without padding."""
        return int(self.present.sum())

    def with_inputs(self, known_input: ArrayLike | None) -> "Belief":
        """Copy with these known inputs (n, m_y)."""
        return Belief(
            self.mean,
            information=self.information,
            present=self.present,
            known_input=known_input,
            step_s=self.step_s,
        )

    def padded(self, size: int) -> "Belief":
        """Copy padded to at least `size` rows."""
        if (missing := size - len(self.mean)) <= 0:
            return self
        added = ((0, missing), (0, 0))
        return Belief(
            np.pad(self.mean, added),
            information=np.pad(self.information, (*added, (0, 0))),
            present=np.pad(self.present, added[0]),
            known_input=None if self.known_input is None else np.pad(self.known_input, added),
            step_s=self.step_s,
        )

    def __repr__(self) -> str:
        n_y, deviation = self.mean.shape[1], np.sqrt(np.diagonal(self.covariance[self.present], axis1=1, axis2=2))
        padded = f", padded to {len(self.mean)}" * (self.targets < len(self.mean))
        interval = f", standard deviations {deviation.min():.2g} to {deviation.max():.2g}" if self.targets else ""
        return f"Belief({self.targets} targets with states of {n_y} numbers{padded}{interval})"


def fitting(belief: Belief, problem: Problem) -> Belief:
    """Belief with known inputs, 0 by default. Raises InputError unless its sizes are the problem's."""
    (n, n_y), size, m_y = belief.mean.shape, problem.motion.state_size, problem.motion.input_size
    if n_y != size:
        raise InputError(f"mean has shape {(n, n_y)}: expected {(n, size)}, as target states have {size} numbers")
    if belief.known_input is None:
        return belief.with_inputs(np.zeros((n, m_y)))
    if belief.known_input.shape != (n, m_y):
        raise InputError(f"known_input has shape {belief.known_input.shape}: expected {(n, m_y)}")
    return belief


def observation(
    belief: Belief, problem: Problem, pose: Float[np.ndarray, "..."], left: int, size: int = 0, step: int = 0
) -> Observation:
    """Observation of a policy from a predicted belief at a pose, `left` steps before the end, padded to `size`."""
    belief = fitting(belief, problem).padded(size)
    period = len(problem.period.tau)
    return Observation(
        # A step beyond int32, after months of a fast loop, stands for an earlier one of the same matrices.
        step=jnp.asarray(step % (MAX_STEPS // period * period), int),
        left=jnp.asarray(whole_steps("steps_left", left, -MAX_STEPS), int),
        pose=jnp.asarray(pose, float),
        mean=jnp.asarray(belief.mean, float),
        information=jnp.asarray(belief.information, float),
        present=jnp.asarray(belief.present),
        known_input=jnp.asarray(belief.known_input, float),
        robot=Robot.of(problem).at(jnp.asarray(step)),
    )


def check_belief(belief: Belief) -> None:
    """Raise InputError for anything but a belief."""
    require(isinstance(belief, Belief), "belief", belief, "expected a foveate.Belief, as Belief(means, covariance=..)")


def predicted(belief: Belief, problem: Problem, known_input: ArrayLike | None = None, step: int = 0) -> Belief:
    """Belief one step ahead: A mu + B xi and A P A^T + W, with the matrices of that step of the problem.

    `known_input` are xi, (n, m_y), 0 by default. Raises InputError where a shape is not that of the problem's targets.
    """
    check_belief(belief)
    motion = problem.period.motion
    A, B, W = (np.asarray(x[step % len(motion.A)], float) for x in (motion.A, motion.B, motion.W))
    before = fitting(belief.with_inputs(known_input), problem)
    assert before.known_input is not None, "a belief that fits has them"
    mean, covariance = kalman.predict(before.mean, before.covariance, before.known_input, A, B, W)
    return Belief(mean, covariance=covariance, present=before.present, known_input=before.known_input)


def _rows(name: str, rows: np.ndarray, present: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "n numbers"]:
    """Finite rows, 0 in padding."""
    if rows.ndim != 2 or len(rows) != len(present):
        raise InputError(f"{name} has shape {rows.shape}: expected ({len(present)}, ..), a row a target")
    kept = np.where(present[:, None], rows, 0.0)
    if not (finite := np.isfinite(kept).all(axis=1)).all():
        raise InputError(f"{name}[{finite.argmin()}] = {kept[finite.argmin()].tolist()}: expected finite numbers")
    return kept


def _matrices(
    name: str, value: ArrayLike | None, present: Bool[np.ndarray, " n"], n_y: int
) -> Float[np.ndarray, "n _ _"]:
    """Symmetric, positive definite matrices, the identity in padding."""
    n, array = len(present), numbers(name, value)
    if array.shape not in ((n, n_y, n_y), (n_y, n_y)):
        raise InputError(f"{name} has shape {array.shape}: expected ({n}, {n_y}, {n_y}), or ({n_y}, {n_y}) for all")
    matrices = np.where(present[:, None, None], array, np.eye(n_y))
    if not (proper := _are_proper(matrices)).all():
        i = proper.argmin()
        raise InputError(f"{name}[{i}] = {matrices[i].tolist()}: expected finite, symmetric and positive definite")
    return 0.5 * (matrices + matrices.swapaxes(1, 2))


def _are_proper(matrices: Float[np.ndarray, "n s s"]) -> Bool[np.ndarray, " n"]:
    """True for finite, symmetric, positive definite matrices."""
    finite = np.all(np.isfinite(matrices), axis=(1, 2))
    safe = np.where(finite[:, None, None], matrices, np.eye(matrices.shape[1]))
    with np.errstate(over="ignore"):
        asymmetry = np.abs(safe - safe.swapaxes(1, 2)).max(axis=(1, 2))
    symmetric = asymmetry <= SYMMETRY_TOLERANCE * np.abs(safe).max(axis=(1, 2))
    diagonal = np.diagonal(safe, axis1=1, axis2=2)
    positive = np.all(diagonal > 0, axis=1)
    # Of the correlations: different scales of the axes cost no digits.
    scale = np.sqrt(np.where(positive[:, None], diagonal, 1.0))
    correlations = safe / scale[:, :, None] / scale[:, None, :]
    return finite & symmetric & positive & (np.linalg.eigvalsh(correlations)[:, 0] > 0)


def are_usable(mean: Float[np.ndarray, "n n_y"], covariance: Float[np.ndarray, "n n_y n_y"]) -> Bool[np.ndarray, " n"]:
    """True for beliefs that a policy can be told, in float32: the others are too vague, or beyond rounding."""
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        in_range = (np.abs(mean) <= LARGEST).all(axis=1) & (variances <= LARGEST_VARIANCE).all(axis=1)
        in_range &= (variances >= 1.0 / LARGEST_VARIANCE).all(axis=1)
    return in_range & _are_proper(covariance) & np.isfinite(inverses(covariance)).all(axis=(1, 2))


def inverses(matrices: Float[np.ndarray, "n s s"]) -> Float[np.ndarray, "n s s"]:
    """Inverse of every matrix; NaN where there is none."""
    try:
        return np.linalg.inv(matrices)
    except np.linalg.LinAlgError:  # of one, which must not stop the others
        return np.stack([_inverse(matrix) for matrix in matrices])


def _inverse(matrix: Float[np.ndarray, "s s"]) -> Float[np.ndarray, "s s"]:
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


def numbers(name: str, value: ArrayLike | None) -> np.ndarray:
    """Copy of an array as float64. Raises InputError where it is none."""
    try:
        return np.array(value, float)
    except (ValueError, TypeError) as error:  # ragged rows, texts, complex numbers
        raise InputError(f"{name}: expected numbers in rows of one length ({error})") from error


def whole_steps(name: str, value: Any, least: int) -> int:
    """A whole number of steps from `least` to `MAX_STEPS`. Raises InputError for another."""
    try:
        steps = int(value)
    except (ValueError, TypeError, OverflowError):
        steps = least - 1
    if steps != value or not least <= steps <= MAX_STEPS:
        raise InputError(f"{name} = {value!r}: expected a whole number from {least} to {MAX_STEPS}")
    return steps
