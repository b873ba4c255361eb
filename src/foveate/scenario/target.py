"""Settings of targets: their motion in a step of tau seconds, and the initial belief about them.

Each kind has `motion(dimension, tau_s)`, the matrices A, B, W, Z of y' = A y + B xi + w, w ~ N(0, W), with position
Z y, and `prior_covariance(dimension)`, the covariance of the initial belief.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from foveate.io.settings import Settings, tag
from foveate.io.validate import Matrix, at_least, covariance, matrix, positive, require

Motion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""A (n_y, n_y), B (n_y, m_y), W (n_y, n_y), Z (d, n_y)."""
_VARIANCES = ("initial_variance_m2", "initial_velocity_variance_m2_s2", "initial_acceleration_variance_m2_s4")


_NODES = np.polynomial.legendre.leggauss(32)
"""Nodes and weights on [-1, 1]."""


def integrators(order: int, tau_s: float, intensity: np.ndarray) -> Motion:
    """Exact motion of the `order`-fold integral of white noise of spectral density `intensity` (d, d).

    The state is (position, velocity, ...), `order` vectors of d numbers; the known input is the noisy derivative
    itself, held over the step. With a = order - 1 - i and b = order - 1 - j: A_ij = tau^(j - i) / (j - i)!,
    W_ij = tau^(a + b + 1) / (a! b! (a + b + 1)) (Bar-Shalom, Li & Kirubarajan 2001, section 6.2).
    """
    powers = [tau_s**k / math.factorial(k) for k in range(order + 1)]
    A, W, B = np.zeros((order, order)), np.zeros((order, order)), np.zeros((order, 1))
    for i in range(order):
        a = order - 1 - i
        B[i] = powers[a + 1]
        for j in range(order):
            b = order - 1 - j
            A[i, j] = powers[j - i] if j >= i else 0.0
            W[i, j] = tau_s ** (a + b + 1) / (math.factorial(a) * math.factorial(b) * (a + b + 1))
    eye, d = np.eye(len(intensity)), len(intensity)
    return np.kron(A, eye), np.kron(B, eye), np.kron(W, intensity), np.eye(d, order * d)


def forgetful(tau_s: float, memory_s: float, intensity: np.ndarray) -> Motion:
    """Motion with a velocity that decays as exp(-t / memory_s), driven by white noise (integrated Ornstein-Uhlenbeck).

    With the response phi(s) = (memory (1 - exp(-s / memory)), exp(-s / memory)) of position and velocity to an impulse
    of acceleration s ago, B = int_0^tau phi ds and W = int_0^tau phi phi^T ds. Gauss-Legendre quadrature avoids
    cancellation for long memories, and is exact except for rounding while tau is below 20 times the memory.
    """
    nodes, weights = _NODES
    weights = 0.5 * tau_s * weights

    def response(s: np.ndarray) -> np.ndarray:
        return np.stack([-memory_s * np.expm1(-s / memory_s), np.exp(-s / memory_s)])

    phi = response(0.5 * tau_s * (nodes + 1.0))
    eye, d = np.eye(len(intensity)), len(intensity)
    A = np.column_stack([[1.0, 0.0], response(np.asarray(tau_s))])
    B, W = (phi @ weights)[:, None], (phi * weights) @ phi.T
    return np.kron(A, eye), np.kron(B, eye), np.kron(W, intensity), np.eye(d, 2 * d)


def require_predictable(A: np.ndarray, W: np.ndarray, name: str) -> None:
    """Raise InputError if the predicted covariance A P A^T + W is singular for definite P."""
    smallest = np.linalg.svd(np.hstack([A, W]), compute_uv=False).min()
    singular = smallest <= 1e-12 * max(np.abs(A).max(), np.abs(W).max())
    right = "the predicted covariance A P A^T + W is singular: W must add noise wherever A loses rank"
    require(not singular, name, (A.tolist(), W.tolist()), right)


class _DiagonalPrior(Settings):
    """Initial belief of targets whose state is a position, or with its derivatives."""

    def prior_covariance(self, dimension: int) -> np.ndarray:
        """Covariance of the initial belief [m^2, m^2/s^2, m^2/s^4]."""
        variances = [float(getattr(self, name)) for name in _VARIANCES if hasattr(self, name)]
        return np.diag(np.repeat(variances, dimension))


@dataclass(frozen=True, kw_only=True)
class StaticTarget(_DiagonalPrior):
    """A target that does not move: y' = y. It takes no drift."""

    kind: Literal["static"] = tag("static")
    initial_variance_m2: float = 2.0
    """Variance of a position in the initial belief, on each axis."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "initial_variance_m2")

    def motion(self, dimension: int, tau_s: float) -> Motion:
        """Motion over one step: A (n_y, n_y), B (n_y, m_y), W (n_y, n_y), Z (d, n_y)."""
        eye = np.eye(dimension)
        return eye, np.zeros((dimension, 0)), 0.0 * eye, eye


@dataclass(frozen=True, kw_only=True)
class DriftTarget(_DiagonalPrior):
    """Position only: y' = y + xi + w, the paper's target. `process_std_m` is in [m] per step; `W` replaces it."""

    kind: Literal["drift"] = "drift"
    process_std_m: float = 0.05
    W: Matrix | None = None
    initial_variance_m2: float = 2.0
    """Variance of a position in the initial belief, on each axis."""

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(0, self, "process_std_m")
        positive(self, "initial_variance_m2")
        if self.W is not None:
            covariance(self.W, "W", len(self.W), definite=False)

    def motion(self, dimension: int, tau_s: float) -> Motion:
        """Motion over one step: A (n_y, n_y), B (n_y, m_y), W (n_y, n_y), Z (d, n_y)."""
        eye = np.eye(dimension)
        W = self.process_std_m**2 * eye if self.W is None else covariance(self.W, "W", dimension, definite=False)
        return eye, eye, W, eye


@dataclass(frozen=True, kw_only=True)
class VelocityTarget(_DiagonalPrior):
    """Nearly constant velocity: y = (position, velocity), acceleration is white noise.

    Its spectral density is `acceleration_m2_s3` [m^2/s^3] on each axis, or the matrix `Q`. With `memory_s` the velocity
    decays with that time constant [s], as for targets that turn and circle: a lost target is then believed to be near
    its last position, not to go straight on for ever. A target's drift is its first velocity; the known input is an
    acceleration [m/s^2].
    """

    kind: Literal["constant_velocity"] = tag("constant_velocity")
    acceleration_m2_s3: float = 0.1
    Q: Matrix | None = None
    memory_s: float | None = None
    initial_variance_m2: float = 2.0
    """Variance of a position in the initial belief, on each axis."""
    initial_velocity_variance_m2_s2: float = 1.0
    """Variance of a velocity, likewise."""

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(0, self, "acceleration_m2_s3")
        positive(self, *_VARIANCES[:2])
        if self.Q is not None:
            covariance(self.Q, "Q", len(self.Q), definite=self.memory_s is not None)
        if self.memory_s is not None:
            positive(self, "memory_s")
            # The information about a velocity that decays without noise grows without bound.
            right = "expected > 0 with memory_s"
            require(self.Q is not None or self.acceleration_m2_s3 > 0, "acceleration_m2_s3", 0.0, right)

    def motion(self, dimension: int, tau_s: float) -> Motion:
        """Motion over one step: A (n_y, n_y), B (n_y, m_y), W (n_y, n_y), Z (d, n_y)."""
        density = _density(self.acceleration_m2_s3, self.Q, dimension)
        if self.memory_s is None:
            return integrators(2, tau_s, density)
        require(tau_s < 20 * self.memory_s, "memory_s", self.memory_s, f"expected > tau / 20 = {tau_s / 20:g}")
        return forgetful(tau_s, self.memory_s, density)


@dataclass(frozen=True, kw_only=True)
class AccelerationTarget(_DiagonalPrior):
    """Nearly constant acceleration: y = (position, velocity, acceleration), jerk is white noise.

    Its spectral density is `jerk_m2_s5` [m^2/s^5] on each axis, or the matrix `Q`. A target's drift is its first
    velocity; the known input is a jerk [m/s^3]. In float32 beliefs keep their digits for 1,000 steps unseen; set
    JAX_ENABLE_X64=1 for longer episodes.
    """

    kind: Literal["constant_acceleration"] = tag("constant_acceleration")
    jerk_m2_s5: float = 0.1
    Q: Matrix | None = None
    initial_variance_m2: float = 2.0
    """Variance of a position in the initial belief, on each axis."""
    initial_velocity_variance_m2_s2: float = 1.0
    """Variance of a velocity, likewise."""
    initial_acceleration_variance_m2_s4: float = 0.25
    """Variance of an acceleration, likewise."""

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(0, self, "jerk_m2_s5")
        positive(self, *_VARIANCES)
        if self.Q is not None:
            covariance(self.Q, "Q", len(self.Q), definite=False)

    def motion(self, dimension: int, tau_s: float) -> Motion:
        """Motion over one step: A (n_y, n_y), B (n_y, m_y), W (n_y, n_y), Z (d, n_y)."""
        return integrators(3, tau_s, _density(self.jerk_m2_s5, self.Q, dimension))


def _density(intensity: float, Q: Matrix | None, dimension: int) -> np.ndarray:
    """Spectral density of the driving noise (d, d)."""
    return intensity * np.eye(dimension) if Q is None else covariance(Q, "Q", dimension, definite=False)


@dataclass(frozen=True, kw_only=True)
class LinearTarget(Settings):
    """A linear-Gaussian target y' = A y + B xi + w, w ~ N(0, W), position Z y.

    `A` (n_y x n_y), `B` (n_y x m_y), `W` (n_y x n_y, semidefinite) and `Z` (d x n_y, of rank d) are those of one step
    of any length; `prior` (n_y x n_y) is the covariance of the initial belief.
    """

    kind: Literal["linear"] = tag("linear")
    A: Matrix
    B: Matrix
    W: Matrix
    Z: Matrix
    prior: Matrix

    def __post_init__(self) -> None:
        super().__post_init__()
        size = len(self.A)
        A = matrix(self.A, "A", (size, size))
        matrix(self.B, "B", (size, None))
        W = covariance(self.W, "W", size, definite=False)
        covariance(self.prior, "prior", size, definite=True)
        require_predictable(A, W, "A, W")

    def motion(self, dimension: int, tau_s: float) -> Motion:
        """Motion over one step: A (n_y, n_y), B (n_y, m_y), W (n_y, n_y), Z (d, n_y)."""
        Z = matrix(self.Z, "Z", (dimension, len(self.A)))
        require(int(np.linalg.matrix_rank(Z)) == dimension, "Z", self.Z, f"expected rank {dimension}")
        return np.array(self.A), np.array(self.B), np.array(self.W), Z

    def prior_covariance(self, dimension: int) -> np.ndarray:
        """Covariance of the initial belief."""
        return np.array(self.prior)


TargetSettings = StaticTarget | DriftTarget | VelocityTarget | AccelerationTarget | LinearTarget
