"""The filter of `kalman` for sensors that measure in coordinates of their own: `models.polar_filter` in numpy."""

import numpy as np
from jaxtyping import Bool, Float

from foveate.deploy.kalman import Covariances, Means
from foveate.geometry.numpy_poses import positions, rotation
from foveate.models import polar_filter
from foveate.models.polar import Polar
from foveate.models.sensor import Sensor

Masks = tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]


def update(
    polar: Polar,
    mean: Means,
    covariance: Covariances,
    measurement: Float[np.ndarray, "n n_z"],
    V: Float[np.ndarray, "n_z n_z"],
    frame: tuple[np.ndarray, ...],
    gate_limit: float,
) -> tuple[Means, Covariances, Masks]:
    """Correct every target by its measurement, unless the gate rejects it or its belief cannot use it.

    `frame` is the rotation and position of the sensor, and Z. The masks returned mark corrected beliefs, and those that
    cannot use a measurement in the gate.
    """
    given = (np, _inverse, polar, mean, covariance, measurement, V, frame)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        passes = polar_filter.squared_distance(*given) <= gate_limit
        after = polar_filter.update(*given)
        K = covariance @ after.H.swapaxes(-1, -2) @ _inverse(after.H @ covariance @ after.H.swapaxes(-1, -2) + after.V)
        # Joseph's form, as in `kalman.update`.
        rest = np.eye(mean.shape[1]) - K @ after.H
        corrected = rest @ covariance @ rest.swapaxes(-1, -2) + K @ after.V @ K.swapaxes(-1, -2)
    accepted = passes & after.is_taken & np.isfinite(corrected).all(axis=(1, 2))
    mean = np.where(accepted[:, None], after.mean, mean)
    return mean, np.where(accepted[:, None, None], corrected, covariance), (accepted, passes & ~accepted)


def one_point(
    sensor: Sensor,
    first_covariance: Float[np.ndarray, "n_y n_y"],
    measurement: Float[np.ndarray, "n n_z"],
    V: Float[np.ndarray, "n_z n_z"],
    frame: tuple[np.ndarray, ...],
) -> tuple[Means, Covariances]:
    """Means and covariances from one measurement each: a position within the view, the rest as at first."""
    assert sensor.polar is not None, "for sensors that measure in their own coordinates"
    R, t, Z = frame
    extent = sensor.view.extent
    reach = polar_filter.Reach(*map(float, polar_filter.reach_of(np, extent)))
    middle, spread = polar_filter.one_point(np, sensor.polar, measurement, V, reach, len(t))
    back = np.linalg.pinv(Z)
    rest, turned = np.eye(len(back)) - back @ Z, back @ R
    return middle @ turned.T + back @ t, turned @ spread @ turned.T + rest @ first_covariance @ rest.T


def frame_of(pose: Float[np.ndarray, "..."], Z: Float[np.ndarray, "d n_y"]) -> tuple[np.ndarray, ...]:
    """Rotation and position of a sensor at a pose, and Z."""
    pose = np.asarray(pose, float)
    return rotation(pose), positions(pose), Z


def _inverse(S: Float[np.ndarray, "n m m"]) -> Float[np.ndarray, "n m m"]:
    """S^-1 of every target; the pseudo-inverse where S of any is singular, which must not stop the others."""
    try:
        return np.linalg.inv(S)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(np.where(np.isfinite(S), S, 0.0), hermitian=True)
