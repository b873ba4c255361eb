"""What is known of the targets, as numpy arrays: what a policy decides on, from a tracker or from anywhere."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from foveate.deploy import kalman
from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.simulation.records import Observation

ASYMMETRY = 1e-5
"""Of the largest entry: what rounding in float32 may leave between two that should be equal."""


class Belief:
    """Gaussians over the states of n targets in the world: means, information matrices, and who is there.

    `mean` is (n, n_y), a row a target, which begins with its position [m]. Give `covariance` or its inverse,
    `information`: (n, n_y, n_y), or one matrix (n_y, n_y) for all. `present` (n,) is true where there is a target (by
    default everywhere); what stands elsewhere is padding, and ignored. `known_input` (n, m_y) is the input xi that led
    to a prediction (by default none is known: 0). Raises ValueError for other shapes, numbers of a target that are not
    finite, and matrices that are not symmetric and positive definite.

    All is kept as float64, copied: `mean`, `information`, `present`, `known_input` (None where it was not given).
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
        """How many are there, padding aside."""
        return int(self.present.sum())

    def with_inputs(self, known_input: ArrayLike | None) -> "Belief":
        """The same with these known inputs (n, m_y)."""
        return Belief(self.mean, information=self.information, present=self.present, known_input=known_input)

    def padded(self, size: int) -> "Belief":
        """The same with padding up to `size` rows; as it is where it has as many."""
        if (missing := size - len(self.mean)) <= 0:
            return self
        more = ((0, missing), (0, 0))
        return Belief(
            np.pad(self.mean, more),
            information=np.pad(self.information, (*more, (0, 0))),
            present=np.pad(self.present, more[0]),
            known_input=None if self.known_input is None else np.pad(self.known_input, more),
        )

    def __repr__(self) -> str:
        n_y, spread = self.mean.shape[1], np.sqrt(np.diagonal(self.covariance[self.present], axis1=1, axis2=2))
        padded = f", padded to {len(self.mean)}" * (self.targets < len(self.mean))
        width = f", standard deviations {spread.min():.2g} to {spread.max():.2g}" if self.targets else ""
        return f"Belief({self.targets} targets with states of {n_y} numbers{padded}{width})"


def fitting(belief: Belief, problem: Problem) -> Belief:
    """The belief, with known inputs, 0 where it has none. Raises ValueError where it is of other targets."""
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
    """What a policy sees of a predicted belief at a pose, `left` steps before the end, padded to `size` targets."""
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

    `known_input` are xi, (n, m_y), 0 by default. Raises ValueError where a shape is not that of the problem's targets.
    """
    motion = problem.period.motion
    A, B, W = (np.asarray(x[step % len(motion.A)], float) for x in (motion.A, motion.B, motion.W))
    before = fitting(belief.with_inputs(known_input), problem)
    assert before.known_input is not None, "a belief that fits has them"
    mean, covariance = kalman.predict(before.mean, before.covariance, before.known_input, A, B, W)
    return Belief(mean, covariance=covariance, present=before.present, known_input=before.known_input)


def _mask(present: ArrayLike | None, n: int) -> Bool[np.ndarray, " n"]:
    there = np.ones(n, bool) if present is None else np.array(present)
    if there.shape != (n,) or there.dtype != bool:
        raise InputError(f"present has shape {there.shape} of {there.dtype}: expected ({n},) of bool")
    return there


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
    found = np.where(present[:, None, None], given, identity)
    for i, matrix in enumerate(found):
        finite = bool(np.isfinite(matrix).all())
        symmetric = finite and np.abs(matrix - matrix.T).max() <= ASYMMETRY * np.abs(matrix).max()
        if not symmetric or np.linalg.eigvalsh(matrix)[0] <= 0:
            raise InputError(f"{name}[{i}] = {matrix.tolist()}: expected finite, symmetric and positive definite")
    return 0.5 * (found + found.swapaxes(1, 2))
