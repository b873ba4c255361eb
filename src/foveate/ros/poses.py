"""Poses of the robot over the last seconds: where it was when a detector looked."""

from bisect import bisect_right

import numpy as np
from jaxtyping import Float

from foveate.geometry.numpy_poses import rotation_quaternion
from foveate.ros.records import Position, Quaternion


def matrix_of(position: Position, quaternion: Quaternion) -> Float[np.ndarray, "4 4"] | None:
    """Transform from body to world; None where numbers are not finite, or the quaternion is zero."""
    x, y, z, w = quaternion
    numbers, n = np.array(position, float), np.array([w, x, y, z], float)
    if not np.isfinite(numbers).all() or not np.isfinite(n).all() or not n.any():
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_quaternion(n / np.abs(n).max()), numbers
    return T


def heading(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """[x, y, yaw] of a body that may roll and pitch: where its x axis points, seen from above."""
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def between(
    a: tuple[Position, Quaternion], b: tuple[Position, Quaternion], share: float
) -> tuple[Position, Quaternion]:
    """A share of the way from a to b: on the straight line, and turning at a constant rate (slerp)."""
    p, q = (np.array(each[0], float) for each in (a, b))
    m, n = (np.array(each[1], float) / np.linalg.norm(each[1]) for each in (a, b))
    if m @ n < 0:  # the same rotation, on the near side
        n = -n
    angle = 2 * np.arctan2(np.linalg.norm(n - m), np.linalg.norm(n + m))
    # sinc is safe at 0, where both weights are the shares themselves.
    first, second = (s * np.sinc(s * angle / np.pi) / np.sinc(angle / np.pi) for s in (1 - share, share))
    return tuple((p + share * (q - p)).tolist()), tuple((first * m + second * n).tolist())


class PoseHistory:
    """Poses by time, of the last `keep_s` seconds; times only increase."""

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._times: list[float] = []
        self._poses: list[tuple[Position, Quaternion]] = []

    @property
    def latest_s(self) -> float | None:
        """Time of the last pose [s]."""
        return self._times[-1] if self._times else None

    def latest(self) -> Float[np.ndarray, "4 4"]:
        """The last pose."""
        T = matrix_of(*self._poses[-1])
        assert T is not None, "`add` takes no other"
        return T

    def add(self, time_s: float, position: Position, quaternion: Quaternion) -> None:
        """Remember a pose, unless it is not later than the last one."""
        if self._times and time_s <= self._times[-1]:
            return
        self._times.append(time_s)
        self._poses.append((position, quaternion))
        while len(self._times) > 2 and self._times[1] < time_s - self._keep_s:
            del self._times[0], self._poses[0]

    def at(self, time_s: float, beyond_s: float) -> Float[np.ndarray, "4 4"] | None:
        """The pose at a time, between those before and after; the first or last one up to `beyond_s` outside."""
        if not self._times or not self._times[0] - beyond_s <= time_s <= self._times[-1] + beyond_s:
            return None
        after = bisect_right(self._times, time_s)
        if after in (0, len(self._times)):
            return matrix_of(*self._poses[min(after, len(self._times) - 1)])
        first, second = self._times[after - 1], self._times[after]
        return matrix_of(*between(self._poses[after - 1], self._poses[after], (time_s - first) / (second - first)))
