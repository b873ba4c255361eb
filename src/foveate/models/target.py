"""Motion of one target: y' = A y + B xi + w, w ~ N(0, W) (paper, equation 2)."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.types import Mean, Point

LARGEST = 9
"""Longest state whose prediction by reversal is used: it is written out in elementwise operations."""
MIN_DECAY = 0.3
"""Smallest number on the diagonal of a triangular A whose inverse still costs no digits: what a step leaves of a
velocity."""
FINEST = 100.0
"""Largest variance that the process noise of a step adds, per variance of a measurement, for a prediction by reversal:
0.001 nat are lost then, more where a measurement is much finer across than along."""


class LinearGaussian(eqx.Module):
    """Linear-Gaussian motion of one target.

    W is the covariance of the process noise per step, Z gives the position [m] of a state. Where n_y is a multiple of
    d, the state is read as d-vectors (position, velocity, ...) that turn with the frame. `is_reversible`, known before
    compilation, says that A is upper triangular and that its inverse costs no digits (`models.belief`).
    """

    A: Float[Array, "n_y n_y"]
    B: Float[Array, "n_y m_y"]
    W: Float[Array, "n_y n_y"]
    Z: Float[Array, "d n_y"]
    is_reversible: bool = eqx.field(static=True, default=False)

    @classmethod
    def of(
        cls, A: np.ndarray, B: np.ndarray, W: np.ndarray, Z: np.ndarray, gains: Sequence[np.ndarray] = ()
    ) -> "LinearGaussian":
        """The motion of these matrices, which says by their values whether it is reversible.

        It is not if measurements with these `gains` H^T V^-1 H (n_y, n_y) are much finer than its noise: a reversed
        prediction subtracts what the noise takes from what the measurement told, which in float32 is off by some 1e-7
        times the square of the ratio.
        """
        A, size = np.asarray(A), len(A)
        # Positions alone lose no digits by two inverses, which for them cost less.
        reversible = len(Z) < size <= LARGEST and not np.tril(A, -1).any() and np.diag(A).min() > MIN_DECAY
        ratios = [float(np.linalg.eigvals(W @ gain).real.max()) for gain in gains]
        parts = (jnp.asarray(part, float) for part in (A, B, W, Z))
        return cls(*parts, is_reversible=bool(reversible) and max(ratios, default=0.0) <= FINEST)

    @property
    def dimension(self) -> int:
        """Dimension d of space."""
        return self.Z.shape[0]

    @property
    def state_size(self) -> int:
        """Length n_y of the state."""
        return self.A.shape[0]

    @property
    def input_size(self) -> int:
        """Length m_y of the known input."""
        return self.B.shape[1]

    @property
    def begins_with_position(self) -> bool:
        """True if a state is d-vectors of which the first is the position, Z = [I 0]."""
        d, n_y = self.Z.shape
        return n_y % d == 0 and np.array_equal(self.Z, np.eye(d, n_y))

    @property
    def takes_drift(self) -> bool:
        """True if a target can have a drift velocity: as the input of a position, or as the second part of a state."""
        d, n_y = self.Z.shape
        if n_y == d:
            return self.begins_with_position and np.array_equal(self.B, np.eye(d))
        return n_y >= 2 * d and np.array_equal(self.Z, np.eye(d, n_y))

    def position(self, state: Float[Array, "*b n_y"]) -> Float[Array, "*b d"]:
        """zeta(y) = Z y [m]."""
        return jnp.matmul(state, self.Z.T, precision="highest")

    def state_at(self, position_world: Point) -> Mean:
        """The state at a position with every other component 0 (the least-norm solution of Z y = position)."""
        return jnp.linalg.pinv(self.Z) @ position_world

    def advance(self, state: Float[Array, "*b n_y"], known_input: Float[Array, "*b m_y"]) -> Float[Array, "*b n_y"]:
        """A y + B xi, without the noise."""
        moved = jnp.matmul(state, self.A.T, precision="highest")
        return moved + jnp.matmul(known_input, self.B.T, precision="highest")
