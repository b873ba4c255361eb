"""Kalman filter for robots, in numpy and float64: all targets of a step at once.

The equations are those of `models.belief`, `models.gate` and `Sensor.covariance`, with covariances in place of
information matrices; `tests/deploy/test_kalman.py` holds the two to 1e-9 of each other. Reasons for a second filter,
measured on two CPU cores with 8 detections a step: JAX compiles again whenever the number of targets exceeds the
padding, which interrupts a loop of 10 ms for 1 s (positions in the plane) to 9 s (positions and velocities in space).
Its update takes 39 us in the plane and 110 to 130 us in space; this one takes 58 and 63 us, without compilation. And
JAX on a robot works in float32 by default, which loses digits of covariances over long runs.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.geometry.fov import FieldOfView
from foveate.geometry.numpy_poses import positions, rotation
from foveate.models import missed_detection
from foveate.models.belief import Belief
from foveate.models.sensor import Sensor

Means = Float[np.ndarray, "n n_y"]
Covariances = Float[np.ndarray, "n n_y n_y"]


def predict(
    mean: Means,
    covariance: Covariances,
    known_input: Float[np.ndarray, "n m_y"],
    A: Float[np.ndarray, "n_y n_y"],
    B: Float[np.ndarray, "n_y m_y"],
    W: Float[np.ndarray, "n_y n_y"],
) -> tuple[Means, Covariances]:
    """A mu + B xi and A P A^T + W of every target."""
    return mean @ A.T + known_input @ B.T, A @ covariance @ A.T + W


def measurement_noise(
    sensor: Sensor,
    V: Float[np.ndarray, "n_z n_z"],
    pose: Float[np.ndarray, "..."],
    point_world: Float[np.ndarray, "n d"],
) -> Float[np.ndarray, "n n_z n_z"]:
    """V in the world frame [m^2] for targets at these positions [m]: rotated with the agent, growing with the range."""
    if sensor.frame == "body":
        V = rotation(pose) @ V @ rotation(pose).T
    distance = np.linalg.norm(point_world - positions(pose), axis=-1)
    return V * (1.0 + sensor.range_growth * distance[:, None, None]) ** 2


def update(
    mean: Means,
    covariance: Covariances,
    measurement: Float[np.ndarray, "n n_z"],
    H: Float[np.ndarray, "n_z n_y"],
    V: Float[np.ndarray, "n n_z n_z"],
    gate_limit: float,
) -> tuple[Means, Covariances, Bool[np.ndarray, " n"]]:
    """Correct every target by its measurement z = H y + N(0, V), unless the gate rejects it.

    The mask returned marks accepted measurements: their squared Mahalanobis distance (z - H p)^T S^-1 (z - H p),
    S = H P H^T + V, is at most `gate_limit`, and the corrected belief is finite.
    """
    S, innovation = H @ covariance @ H.T + V, measurement - mean @ H.T
    distance = np.einsum("ni,ni->n", innovation, _solve(S, innovation[..., None])[..., 0])
    K = _solve(S, H @ covariance).swapaxes(-1, -2)
    # Joseph's form: a sum of semidefinite matrices however K is rounded; (I - K H) P would lose its symmetry.
    rest = np.eye(mean.shape[1]) - K @ H
    corrected = rest @ covariance @ rest.swapaxes(-1, -2) + K @ V @ K.swapaxes(-1, -2)
    moved = mean + np.einsum("nij,nj->ni", K, innovation)
    accepted = (distance <= gate_limit) & np.isfinite(moved).all(axis=1) & np.isfinite(corrected).all(axis=(1, 2))
    return np.where(accepted[:, None], moved, mean), np.where(accepted[:, None, None], corrected, covariance), accepted


def _solve(S: Float[np.ndarray, "n m m"], b: Float[np.ndarray, "n m k"]) -> Float[np.ndarray, "n m k"]:
    """S^-1 b of every target; the least solution where S of any is singular, which must not stop the others."""
    try:
        return np.linalg.solve(S, b)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(S, hermitian=True) @ b


def one_point(
    first_covariance: Float[np.ndarray, "n_y n_y"],
    measurement: Float[np.ndarray, "n n_z"],
    H: Float[np.ndarray, "n_z n_y"],
    V: Float[np.ndarray, "n n_z n_z"],
) -> tuple[Means, Covariances]:
    """Means and covariances from one measurement each: H^+ z, H^+ V H^+T + N P_0 N^T with N = I - H^+ H."""
    back = np.linalg.pinv(H)
    rest = np.eye(len(back)) - back @ H
    return measurement @ back.T, back @ V @ back.T + rest @ first_covariance @ rest.T


def condition_on_missed_detection(
    mean: Float[np.ndarray, " n_y"],
    covariance: Float[np.ndarray, "n_y n_y"],
    Z: Float[np.ndarray, "d n_y"],
    view: FieldOfView,
    pose: Float[np.ndarray, "..."],
    before: Float[np.ndarray, "..."] | None = None,
) -> tuple[Float[np.ndarray, " n_y"], Float[np.ndarray, "n_y n_y"]]:
    """Mean and covariance of a target that was not in view from this pose; those given where float32 cannot say more.

    `before` is the pose of the previous look, if that missed the target too: what it showed is not cut again. This
    calls `models.missed_detection` for one target, so that one compilation serves any number of them.
    """
    last = pose if before is None else before
    poses = (part(each) for each in (pose, last) for part in (rotation, positions))
    arrays = (mean, np.linalg.inv(covariance), Z, *poses)
    outside = _given_missed_detection(view, [jnp.asarray(x, float) for x in arrays], jnp.asarray(before is not None))
    moved, information = np.asarray(outside.mean, float), np.asarray(outside.information, float)
    if not (np.isfinite(moved).all() and np.isfinite(information).all() and np.linalg.eigvalsh(information)[0] > 0):
        return mean, covariance
    return moved, np.linalg.inv(information)


@eqx.filter_jit
def _given_missed_detection(view: FieldOfView, arrays: list[Array], was_missed: Bool[Array, ""]) -> Belief:
    mean, information, Z, R, t, last_R, last_t = arrays

    def is_inside(points_world: Float[Array, "points d"]) -> Bool[Array, " points"]:
        known = was_missed & view.contains((points_world - last_t) @ last_R)
        return view.contains((points_world - t) @ R) & ~known

    return missed_detection.condition_on_missed_detection(Belief(mean, information), Z, is_inside)
