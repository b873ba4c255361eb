"""The update of a Gaussian by a measurement of a `Polar` sensor, in numpy and in JAX.

It is that of an extended Kalman filter, with three changes, each measured (docs/sensors.md):

* it is linearised where the target was measured, not where it was predicted: at the first look of a wide belief the
  predicted direction is wrong, and so would be the ellipse (Bell & Cathey 1993, the iterated filter);
* half the trace of (Hessian x covariance)^2 of what is left is added to the noise, the second-order term of the
  Taylor series (Bar-Shalom, Li & Kirubarajan 2001, section 10.3.3);
* it is not taken where the belief, after it, has a standard deviation above half of its range: around the sensor no
  straight line stands for a ray or a circle.
"""

from typing import Any, NamedTuple

import numpy as np

from foveate.models.polar import (
    Numbers,
    Polar,
    coordinates_of,
    hessians,
    jacobian,
    names_of,
    noise,
    position,
    replaced,
    residual,
)

MAX_STD_PER_RANGE = 0.5
"""Largest standard deviation of a position after an update, per range, for which the update is taken."""
NODES = 16
"""Number of values that represent a coordinate that is not measured, within the view."""


class Reach(NamedTuple):
    """How far a view reaches: range [m], bearing and elevation to either side [rad]."""

    range_m: Any
    bearing_rad: Any
    elevation_rad: Any


def reach_of(xp: Any, extent: Any) -> Reach:
    """The reach of a view with this `geometry.fov.Extent`."""
    return Reach(
        extent.ahead_m, xp.minimum(extent.half_width_rad, np.pi), xp.minimum(extent.half_height_rad, np.pi / 2)
    )


class Update(NamedTuple):
    """Corrected mean, and the linear measurement (H, V) that led to it; `is_taken` says whether it may be used."""

    mean: Numbers
    H: Numbers
    V: Numbers
    is_taken: Numbers


def _transposed(xp: Any, matrix: Numbers) -> Numbers:
    return xp.swapaxes(matrix, -1, -2)


def _product(xp: Any, *matrices: Numbers) -> Numbers:
    """Product of small matrices, summed elementwise: accelerators round matmul to fewer bits."""
    result = matrices[0]
    for matrix in matrices[1:]:
        result = xp.sum(result[..., :, :, None] * matrix[..., None, :, :], axis=-2)
    return result


def _times(xp: Any, matrix: Numbers, vector: Numbers) -> Numbers:
    return xp.sum(matrix * vector[..., None, :], axis=-1)


def second_order(xp: Any, polar: Polar, q: Numbers, covariance: Numbers) -> Numbers:
    """Half tr(M_i C M_i C), M_i the Hessians (.., n_z): variance of what a linear h leaves out, for N(q, C)."""
    product = _product(xp, hessians(xp, polar, q), covariance[..., None, :, :])
    half = 0.5 * xp.sum(product * _transposed(xp, product), axis=(-1, -2))
    return xp.where(half > 0, half, 0.0)  # not by rounding below it


def _start(xp: Any, polar: Polar, q: Numbers, spread: Numbers, z: Numbers, V: Numbers) -> Numbers:
    """Where to linearise: as measured, or, of what is not measured, as predicted.

    A coordinate that is known better than measured stays as predicted: to follow its noise would bend a ray's belief
    anew at every look, and so make up information along it.
    """
    if polar.is_full(q.shape[-1]):
        return replaced(xp, polar, q, z)
    J = jacobian(xp, polar, q)
    known, measured = (xp.diagonal(M, axis1=-2, axis2=-1) for M in (_product(xp, J, spread, _transposed(xp, J)), V))
    share = xp.where(known > measured, known / (known + measured), 0.0)
    own = coordinates_of(xp, polar, q)
    return replaced(xp, polar, q, own + share * residual(xp, polar, z, own))


def update(
    xp: Any, inverse: Any, polar: Polar, mean: Numbers, covariance: Numbers, z: Numbers, V: Numbers, frame: tuple
) -> Update:
    """Correct N(mean, covariance) by the measurement z = h(q) + N(0, V).

    Args:
        xp: Module that computes, numpy or jax.numpy.
        inverse: Its inverse of symmetric, positive definite matrices.
        polar: The measured coordinates.
        mean: Predicted mean (.., n_y) in the world.
        covariance: Predicted covariance (.., n_y, n_y).
        z: Measurement (.., n_z) [m, rad].
        V: Covariance of its noise at range 0 (n_z, n_z).
        frame: Rotation (d, d) body to world, position (d,) of the sensor [m], and Z (d, n_y), y's position.
    """
    R, t, Z = frame
    turn = _product(xp, R.T, Z)
    q = _times(xp, turn, mean) - _times(xp, R.T, t)
    body = _product(xp, turn, covariance, turn.T)
    point = _start(xp, polar, q, body, z, noise(xp, polar, V, q))

    def corrected(point: Numbers, extra: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        J, here = jacobian(xp, polar, point), noise(xp, polar, V, point)
        here = here + xp.eye(len(polar.coordinates)) * extra[..., None, :]
        H = _product(xp, J, turn)
        cross = _product(xp, covariance, _transposed(xp, H))
        K = _product(xp, cross, inverse(_product(xp, H, cross) + here))
        innovation = residual(xp, polar, z, coordinates_of(xp, polar, point)) - _times(xp, J, q - point)
        # Joseph's form: in float32 the difference of two wide covariances may be negative.
        gain = _product(xp, turn, K)
        rest = xp.eye(len(t)) - _product(xp, gain, J)
        left = _product(xp, rest, body, _transposed(xp, rest)) + _product(xp, gain, here, _transposed(xp, gain))
        return mean + _times(xp, K, innovation), H, here, left

    zero = xp.zeros_like(z)
    if polar.is_full(q.shape[-1]):
        point = _times(xp, turn, corrected(point, zero)[0]) - _times(xp, R.T, t)
    left = corrected(point, zero)[3]
    moved, H, here, left = corrected(point, second_order(xp, polar, point, left))
    after = _times(xp, turn, moved) - _times(xp, R.T, t)
    variance = xp.trace(left, axis1=-2, axis2=-1)
    is_taken = variance <= MAX_STD_PER_RANGE**2 * xp.sum(after * after, axis=-1)
    return Update(moved, H, here, is_taken & xp.all(xp.isfinite(moved), axis=-1))


def squared_distance(
    xp: Any, inverse: Any, polar: Polar, mean: Numbers, covariance: Numbers, z: Numbers, V: Numbers, frame: tuple
) -> Numbers:
    """Squared Mahalanobis distance of a measurement to its prediction; arguments as `update`."""
    R, t, Z = frame
    turn = _product(xp, R.T, Z)
    q = _times(xp, turn, mean) - _times(xp, R.T, t)
    body, J = _product(xp, turn, covariance, turn.T), jacobian(xp, polar, q)
    extra = second_order(xp, polar, q, body)
    S = (
        _product(xp, J, body, _transposed(xp, J))
        + noise(xp, polar, V, q)
        + xp.eye(len(polar.coordinates)) * extra[..., None, :]
    )
    innovation = residual(xp, polar, z, coordinates_of(xp, polar, q))
    return xp.sum(innovation * _times(xp, inverse(S), innovation), axis=-1)


def one_point(xp: Any, polar: Polar, z: Numbers, V: Numbers, reach: Reach, dimension: int) -> tuple[Numbers, Numbers]:
    """Mean (.., d) and covariance (.., d, d) in the body frame of a position from one measurement.

    A coordinate that is not measured is anywhere within the view's reach, uniformly over its area or volume.
    """
    names, unit = names_of(dimension), (np.arange(NODES) + 0.5) / NODES
    ranges = {"range": unit * reach.range_m, "bearing": (2 * unit - 1) * reach.bearing_rad}
    ranges["elevation"] = (2 * unit - 1) * reach.elevation_rad
    free = [name for name in names if name not in polar.coordinates]
    grids = xp.meshgrid(*[ranges[name] for name in free], indexing="ij") if free else []
    every: dict[Any, Numbers] = {name: grid.ravel() for name, grid in zip(free, grids, strict=True)}
    for i, name in enumerate(polar.coordinates):
        every[name] = z[..., i, None]
    shape = xp.zeros_like(sum(every.values()))
    every = {name: value + shape for name, value in every.items()}
    density = every["range"] ** (dimension - 1) if "range" in free else 1.0 + shape
    density = density * xp.cos(every["elevation"]) if "elevation" in free else density
    weight = density / xp.sum(density, axis=-1, keepdims=True)
    points = position(xp, every)
    mean = xp.sum(weight[..., None] * points, axis=-2)
    apart = points - mean[..., None, :]
    # dq/dz of the measured coordinates: columns of the orthogonal frame, long as the inverse of the Jacobian's rows.
    J = jacobian(xp, polar, points)
    columns = _transposed(xp, J / xp.sum(J * J, axis=-1, keepdims=True))
    each = _product(xp, columns, noise(xp, polar, V, points), _transposed(xp, columns))
    each = each + apart[..., :, None] * apart[..., None, :]
    return mean, xp.sum(weight[..., None, None] * each, axis=-3)
