"""Beliefs about the targets as numpy arrays, from a tracker or from anywhere: the basis of a policy's decision."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from foveate.deploy import kalman
from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.simulation.records import Observation

SYMMETRY_TOLERANCE = 1e-5
"""Largest difference of two entries that should be equal, in parts of the largest entry: rounding in float32."""


class Belief:
    """Gaussians over the states of n targets in the world: means, information matrices, and a mask of padding.

    Attributes have the names of the arguments, as float64 copies; `known_input` is None where it was not given.

    Args:
        mean: (n, n_y), a row per target, which begins with its position [m].
        covariance: (n, n_y, n_y), or one matrix (n_y, n_y) for all; give this or `information`.
        information: The inverse of `covariance`, likewise.
        present: (n,) of bool, false for rows of padding, which are ignored; by default all true.
        known_input: (n, m_y), the inputs xi that led to a prediction; by default 0.

    Raises:
        InputError: A shape is wrong, a number of a target is not finite, or a matrix is not symmetric and positive
            definite.
    """

    def __init__(
        self,
        mean: ArrayLike,
        *,
        covariance: ArrayLike | None = None,
        information: ArrayLike | None = None,
        present: ArrayLike | None = None,
        known_input: ArrayLike | None = None,
    ) -> None:
        if (covariance is None) == (information is None):
            raise InputError("covariance, information: expected one of them")
        given = np.array(mean, float)
        if given.ndim != 2 or given.shape[1] < 1:
            raise InputError(f"mean has shape {given.shape}: expected (n, n_y), a row a target")
        self.present: Bool[np.ndarray, " n"] = _mask(present, len(given))
        self.mean: Float[np.ndarray, "n n_y"] = _rows("mean", given, self.present)
        if covariance is not None:
            self.information: Float[np.ndarray, "n n_y n_y"] = np.linalg.inv(
                _matrices("covariance", covariance, given, self.present)
            )
        else:
            self.information = _matrices("information", information, given, self.present)
        self.known_input: Float[np.ndarray, "n m_y"] | None = None
        if known_input is not None:
            self.known_input = _rows("known_input", np.array(known_input, float), self.present)

    @property
    def covariance(self) -> Float[np.ndarray, "n n_y n_y"]:
        """The inverses of `information`."""
        return np.linalg.inv(self.information)

    @property
    def targets(self) -> int:
        """Number of targets, without padding."""
        return int(self.present.sum())

    def with_inputs(self, known_input: ArrayLike | None) -> "Belief":
        """The same with these known inputs (n, m_y)."""
        return Belief(self.mean, information=self.information, present=self.present, known_input=known_input)

    def padded(self, size: int) -> "Belief":
        """The same with padding up to at least `size` rows."""
        if (missing := size - len(self.mean)) <= 0:
            return self
        added = ((0, missing), (0, 0))
        return Belief(
            np.pad(self.mean, added),
            information=np.pad(self.information, (*added, (0, 0))),
            present=np.pad(self.present, added[0]),
            known_input=None if self.known_input is None else np.pad(self.known_input, added),
        )

    def __repr__(self) -> str:
        n_y, spread = self.mean.shape[1], np.sqrt(np.diagonal(self.covariance[self.present], axis1=1, axis2=2))
        padded = f", padded to {len(self.mean)}" * (self.targets < len(self.mean))
        width = f", standard deviations {spread.min():.2g} to {spread.max():.2g}" if self.targets else ""
        return f"Belief({self.targets} targets with states of {n_y} numbers{padded}{width})"


def fitting(belief: Belief, problem: Problem) -> Belief:
    """The belief with known inputs, 0 where it has none. Raises InputError unless its sizes are the problem's."""
    (n, n_y), size, m_y = belief.mean.shape, problem.motion.state_size, problem.motion.input_size
    if n_y != size:
        raise InputError(
            f"mean has shape {(n, n_y)}: expected {(n, size)}, states of these targets have {size} numbers"
        )
    if belief.known_input is None:
        return belief.with_inputs(np.zeros((n, m_y)))
    if belief.known_input.shape != (n, m_y):
        raise InputError(f"known_input has shape {belief.known_input.shape}: expected {(n, m_y)}")
    return belief


def observation(
    belief: Belief, problem: Problem, pose: Float[np.ndarray, "..."], left: int, size: int = 0, step: int = 0
) -> Observation:
    """Observation of a policy from a predicted belief at a pose, `left` steps before the end, padded to `size`."""
    known = fitting(belief, problem).padded(size)
    assert known.known_input is not None, "a belief that fits has them"
    return Observation(
        step=jnp.asarray(step, int),
        left=jnp.asarray(left, int),
        pose=jnp.asarray(pose, float),
        mean=jnp.asarray(known.mean, float),
        information=jnp.asarray(known.information, float),
        present=jnp.asarray(known.present),
        known_input=jnp.asarray(known.known_input, float),
    )


def predicted(belief: Belief, problem: Problem, known_input: ArrayLike | None = None, step: int = 0) -> Belief:
    """The belief one step ahead: A mu + B xi and A P A^T + W, with the matrices of that step of the problem.

    `known_input` are xi, (n, m_y), 0 by default. Raises InputError where a shape is not that of the problem's targets.
    """
    motion = problem.period.motion
    A, B, W = (np.asarray(x[step % len(motion.A)], float) for x in (motion.A, motion.B, motion.W))
    before = fitting(belief.with_inputs(known_input), problem)
    assert before.known_input is not None, "a belief that fits has them"
    mean, covariance = kalman.predict(before.mean, before.covariance, before.known_input, A, B, W)
    return Belief(mean, covariance=covariance, present=before.present, known_input=before.known_input)


def _mask(present: ArrayLike | None, n: int) -> Bool[np.ndarray, " n"]:
    mask = np.ones(n, bool) if present is None else np.array(present)
    if mask.shape != (n,) or mask.dtype != bool:
        raise InputError(f"present has shape {mask.shape} of {mask.dtype}: expected ({n},) of bool")
    return mask


def _rows(name: str, rows: np.ndarray, present: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "n numbers"]:
    """Finite rows, 0 in padding."""
    if rows.ndim != 2 or len(rows) != len(present):
        raise InputError(f"{name} has shape {rows.shape}: expected ({len(present)}, ..), a row a target")
    kept = np.where(present[:, None], rows, 0.0)
    if not (fine := np.isfinite(kept).all(axis=1)).all():
        raise InputError(f"{name}[{fine.argmin()}] = {kept[fine.argmin()].tolist()}: expected finite numbers")
    return kept


def _matrices(
    name: str, value: ArrayLike | None, mean: Float[np.ndarray, "n n_y"], present: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n n_y n_y"]:
    """Symmetric, positive definite matrices, the identity in padding."""
    (n, n_y), given, identity = mean.shape, np.array(value, float), np.eye(mean.shape[1])
    if given.shape not in ((n, n_y, n_y), (n_y, n_y)):
        raise InputError(f"{name} has shape {given.shape}: expected ({n}, {n_y}, {n_y}), or ({n_y}, {n_y}) for all")
    matrices = np.where(present[:, None, None], given, identity)
    for i, matrix in enumerate(matrices):
        finite = bool(np.isfinite(matrix).all())
        symmetric = finite and np.abs(matrix - matrix.T).max() <= SYMMETRY_TOLERANCE * np.abs(matrix).max()
        if not symmetric or np.linalg.eigvalsh(matrix)[0] <= 0:
            raise InputError(f"{name}[{i}] = {matrix.tolist()}: expected finite, symmetric and positive definite")
    return 0.5 * (matrices + matrices.swapaxes(1, 2))
