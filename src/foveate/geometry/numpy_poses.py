"""Pose algebra in numpy, for recorded episodes and for robots: positions, rotations, and the arc between two poses.

Planar poses are [x, y, yaw], spatial ones 4 x 4 matrices, body to world. `space` has the same in JAX, which would
compile again for every length of an episode; `tests/geometry/test_numpy_poses.py` compares the two.
"""

import numpy as np
from jaxtyping import Float

from foveate.geometry.lie_planar import WRAPPED


def positions(pose: Float[np.ndarray, "..."]) -> Float[np.ndarray, "... d"]:
    """Positions of any number of poses of one kind [m]."""
    return pose[..., :2] if _planar(pose) else pose[..., :3, 3]


def rotation(pose: Float[np.ndarray, "..."]) -> Float[np.ndarray, "d d"]:
    """R of a single pose, body to world."""
    if not _planar(pose):
        return pose[:3, :3]
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[cos, -sin], [sin, cos]])


def rotation_quaternion(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """R = I + 2 q_w n^ + 2 (n^)^2 of a quaternion [q_w; n] of any length but zero, normalised.

    (n^)^2 = n n^T - |n|^2 I.
    """
    n, eye = quaternion[1:], np.eye(3, dtype=quaternion.dtype)
    scale = 2 / np.sum(quaternion * quaternion)
    x, y, z = scale * quaternion[0] * n
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], quaternion.dtype)
    return eye + cross + scale * (n[:, None] * n - np.sum(n * n) * eye)


def placed(pose: Float[np.ndarray, "..."], points_body: Float[np.ndarray, "*m d"]) -> Float[np.ndarray, "*m d"]:
    """World positions of a single pose's body-frame points [m]."""
    return points_body @ rotation(pose).T + positions(pose)


def arc(pose: Float[np.ndarray, "instants ..."], parts: int) -> Float[np.ndarray, "poses ..."]:
    """Poses along the path, `parts` per step, with a constant twist from one pose to the next.

    They are T exp(s log(T^-1 T')) at s = 0, 1/parts, ...: the agent's true path, in space if it turned by at most pi in
    the step. In the plane the yaw counts turns, up to two in a step; only a whole turn, which leads nowhere, is taken
    for none.
    """
    between = (_planar_arc if _planar(pose) else _spatial_arc)(pose[:-1], pose[1:], np.arange(parts) / parts)
    return np.concatenate([between.reshape(-1, *pose.shape[1:]), pose[-1:]])


def _planar(pose: np.ndarray) -> bool:
    return pose.shape[-1] == 3


def _chord_share(share: Float[np.ndarray, " s"], angle: Float[np.ndarray, "steps 1"]) -> tuple[np.ndarray, np.ndarray]:
    """Chord of a share of a step: its length relative to the whole step's, and the angle between the two [rad].

    An arc of angle w has a chord sinc(w / 2) times as long, at half the angle. Shapes (steps, s).
    """
    length = share * np.sinc(share * angle / (2 * np.pi)) / np.sinc(angle / (2 * np.pi))
    return length, -0.5 * (1 - share) * angle


def _planar_arc(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> Float[np.ndarray, "steps s 3"]:
    """The chord of a step, shortened and turned back."""
    x, y, turn = (end - start).T[..., None]
    turn = turn - WRAPPED * np.round(turn / WRAPPED)
    w = np.where(np.abs(np.sin(turn / 2)) > 1e-6, turn, -np.remainder(np.pi - turn, 2 * np.pi) + np.pi)
    length, back = _chord_share(share, w)
    ahead = length * (np.cos(back) * x - np.sin(back) * y), length * (np.sin(back) * x + np.cos(back) * y)
    return start[:, None] + np.stack([*ahead, share * w], axis=-1)


def _spatial_arc(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> Float[np.ndarray, "steps s 4 4"]:
    """The same in the plane across the axis of the screw; the motion along that axis is uniform."""
    angle, axis_body = _turn(start[:, :3, :3].swapaxes(-1, -2) @ end[:, :3, :3])
    length, back = _chord_share(share, angle[:, None])
    axis = np.einsum("kij,kj->ki", start[:, :3, :3], axis_body)
    chord = end[:, :3, 3] - start[:, :3, 3]
    along = axis * np.sum(axis * chord, axis=-1, keepdims=True)
    across, aside = (chord - along)[:, None], np.cross(axis, chord)[:, None]
    turned = length[..., None] * (np.cos(back)[..., None] * across + np.sin(back)[..., None] * aside)
    poses = np.broadcast_to(start[:, None], (*length.shape, 4, 4)).copy()
    poses[..., :3, 3] += share[:, None] * along[:, None] + turned
    poses[..., :3, :3] @= _rotation_about(axis_body, share * angle[:, None])
    return poses


def _turn(rotation: Float[np.ndarray, "k 3 3"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Angle in [0, pi] and unit axis of rotation matrices; the axis is 0 where there is no turn.

    Through the unit quaternion [w, v] that solves Bar-Itzhack's eigenproblem: as exact near pi as near 0, and for
    matrices that rounding has made not quite orthogonal.
    """
    twist = np.stack([rotation[:, i, j] - rotation[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)
    trace = np.trace(rotation, axis1=1, axis2=2)
    K = np.empty((len(rotation), 4, 4))
    K[:, 0, 0] = trace
    K[:, 0, 1:] = K[:, 1:, 0] = twist
    K[:, 1:, 1:] = rotation + rotation.swapaxes(-1, -2) - trace[:, None, None] * np.eye(3)
    quaternion = np.linalg.eigh(K)[1][..., -1]
    vector = quaternion[:, 1:] * np.where(quaternion[:, :1] < 0, -1.0, 1.0)
    sine = np.linalg.norm(vector, axis=-1)
    axis = np.divide(vector, sine[:, None], out=np.zeros_like(vector), where=sine[:, None] > 0)
    return 2 * np.arctan2(sine, np.abs(quaternion[:, 0])), axis


def _rotation_about(axis: Float[np.ndarray, "k 3"], angle: Float[np.ndarray, "k s"]) -> Float[np.ndarray, "k s 3 3"]:
    """Rodrigues: I + sin(angle) [a] + (1 - cos(angle)) [a]^2; the identity where the axis is 0."""
    # Row i of the matrix of a x is e_i x a, since (a x b)_i = e_i . (a x b) = (e_i x a) . b.
    cross = np.cross(np.eye(3), axis[:, None])[:, None]
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)
