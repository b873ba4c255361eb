"""The plane and space as poses of one interface, so that all else is written once."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry import lie, lie_planar
from foveate.geometry.numpy_poses import rotation_quaternion


class Space(eqx.Module):
    """A space of poses. An empty pytree, hashable: it may be a static or a traced argument."""

    name: ClassVar[str]
    dimension: ClassVar[int]
    """Length d of a position."""
    twist_size: ClassVar[int]
    axes: ClassVar[tuple[str, ...]]
    """Names of a twist's entries, in order [m/s, rad/s]."""

    @abc.abstractmethod
    def identity(self) -> Float[Array, "..."]:
        """The pose at the world's origin, aligned with it."""

    @abc.abstractmethod
    def upright(self, position_world: Float[Array, " d"], yaw: Float[Array, ""]) -> Float[Array, "..."]:
        """A level pose at a position [m], its heading turned by yaw [rad] from the x axis."""

    @staticmethod
    @abc.abstractmethod
    def move(pose: Float[Array, "..."], displacement: Float[Array, " n_u"], /) -> Float[Array, "..."]:
        """T exp(hat(displacement)), displacement = tau u, in the body frame of T [m, rad]."""

    @staticmethod
    @abc.abstractmethod
    def to_body(pose: Float[Array, "..."], points_world: Float[Array, "*n d"], /) -> Float[Array, "*n d"]:
        """q = Q T^-1 [zeta; 1] of any number of world positions zeta [m]."""

    @staticmethod
    @abc.abstractmethod
    def to_world(pose: Float[Array, "..."], points_body: Float[Array, "*n d"], /) -> Float[Array, "*n d"]:
        """World positions Q T [q; 1] of any number of body-frame points q [m]; the inverse of `to_body`."""

    @staticmethod
    @abc.abstractmethod
    def rotation(pose: Float[Array, "..."], /) -> Float[Array, "d d"]:
        """R, body to world."""

    @abc.abstractmethod
    def position(self, pose: Float[Array, "..."]) -> Float[Array, " d"]:
        """Position of the agent in the world [m]."""

    @abc.abstractmethod
    def placed(self, pose: Float[Array, "..."], position_world: Float[Array, " d"]) -> Float[Array, "..."]:
        """The pose at another position [m], turned as before."""

    @staticmethod
    @abc.abstractmethod
    def log(pose: Float[Array, "..."], /) -> Float[Array, " n_u"]:
        """log(T)^v, the twist that leads from the identity to T in unit time; its turn is at most pi."""

    @abc.abstractmethod
    def numpy_pose(self, numbers: object) -> Float[np.ndarray, "..."]:
        """The pose from its list of numbers in a file. Raises InputError where one is missing or not finite."""

    def from_numbers(self, numbers: object) -> Float[Array, "..."]:
        """`numpy_pose` as a JAX array."""
        return jnp.asarray(self.numpy_pose(numbers))

    @abc.abstractmethod
    def numbers_of(self, pose: Float[Array, "..."]) -> Float[Array, " numbers"]:
        """The numbers of a pose, from which `from_numbers` makes it."""

    def to_numbers(self, pose: Float[Array, "..."]) -> list[float]:
        """`numbers_of` as a list, outside of jit."""
        return np.asarray(self.numbers_of(pose)).tolist()


def _checked(numbers: object, name: str, entries: str) -> np.ndarray:
    """`numbers` as float64. Raises InputError unless they are `entries`, all finite."""
    expected = f"{name} pose: expected {entries.count(',') + 1} finite numbers {entries}"
    try:
        array = np.asarray(numbers)
    except ValueError as error:  # a ragged list
        raise InputError(f"{expected}, got {numbers!r}") from error
    if array.dtype.kind not in "iuf" or array.shape != (entries.count(",") + 1,):
        raise InputError(f"{expected}, got {numbers!r}")
    array = array.astype(np.float64)
    largest = jnp.finfo(jnp.result_type(float)).max  # a number too large for float32 would become inf
    wrong = ~(np.abs(array) <= largest)
    if wrong.any():
        entry = entries.strip("[]").split(", ")[int(np.argmax(wrong))]
        raise InputError(f"{expected}, got {entry} = {array[np.argmax(wrong)]}")
    return array


class Planar(Space):
    """The plane: pose [x, y, yaw], yaw counting up to two turns either way; twist [v_x, v_y, w_z]."""

    name = "planar"
    dimension = 2
    twist_size = 3
    axes = ("vx", "vy", "wz")

    to_body = staticmethod(lie_planar.body_point_se2)
    to_world = staticmethod(lie_planar.act_se2)
    rotation = staticmethod(lie_planar.rotation_se2)
    log = staticmethod(lie_planar.log_se2)

    @staticmethod
    def move(pose: Float[Array, "3"], displacement: Float[Array, "3"], /) -> Float[Array, "3"]:
        """T exp(hat(displacement)), displacement = tau u, in the body frame of T [m, rad]."""
        return lie_planar.wrapped_se2(lie_planar.move_se2(pose, displacement))

    def identity(self) -> Float[Array, "3"]:
        """[0, 0, 0]."""
        return jnp.zeros(3)

    def upright(self, position_world: Float[Array, "2"], yaw: Float[Array, ""]) -> Float[Array, "3"]:
        """[x, y, yaw]."""
        return jnp.append(position_world, yaw)

    def position(self, pose: Float[Array, "3"]) -> Float[Array, "2"]:
        """[x, y] [m]."""
        return pose[:2]

    def placed(self, pose: Float[Array, "3"], position_world: Float[Array, "2"]) -> Float[Array, "3"]:
        """[x, y, yaw] with another x, y [m]."""
        return jnp.concatenate([position_world, pose[2:]])

    def numpy_pose(self, numbers: object) -> Float[np.ndarray, "3"]:
        """The pose of [x, y, yaw] [m, rad]."""
        return _checked(numbers, self.name, "[x, y, yaw]").astype(jnp.result_type(float))

    def numbers_of(self, pose: Float[Array, "3"]) -> Float[Array, "3"]:
        """[x, y, yaw] [m, rad]."""
        return pose


class Spatial(Space):
    """Space: pose T, 4 x 4, body to world; twist [v_x, v_y, v_z, w_x, w_y, w_z]."""

    name = "spatial"
    dimension = 3
    twist_size = 6
    axes = ("vx", "vy", "vz", "wx", "wy", "wz")

    to_body = staticmethod(lie.body_point_se3)
    to_world = staticmethod(lie.act_se3)
    log = staticmethod(lie.log_se3)

    def identity(self) -> Float[Array, "4 4"]:
        """The identity matrix."""
        return jnp.eye(4)

    def upright(self, position_world: Float[Array, "3"], yaw: Float[Array, ""]) -> Float[Array, "4 4"]:
        """A pose turned about the vertical only."""
        rotation = lie.exp_so3(jnp.zeros(3, yaw.dtype).at[2].set(yaw))
        return self.identity().at[:3, :3].set(rotation).at[:3, 3].set(position_world)

    @staticmethod
    def move(pose: Float[Array, "4 4"], displacement: Float[Array, "6"], /) -> Float[Array, "4 4"]:
        """T exp(hat(displacement)), displacement = tau u, in the body frame of T [m, rad]."""
        return lie.orthonormal_se3(lie.compose_se3(pose, lie.exp_se3(displacement)))

    @staticmethod
    def rotation(pose: Float[Array, "4 4"], /) -> Float[Array, "3 3"]:
        """R, body to world."""
        return pose[:3, :3]

    def position(self, pose: Float[Array, "4 4"]) -> Float[Array, "3"]:
        """[x, y, z] [m]."""
        return pose[:3, 3]

    def placed(self, pose: Float[Array, "4 4"], position_world: Float[Array, "3"]) -> Float[Array, "4 4"]:
        """T with another x, y, z [m]."""
        return pose.at[:3, 3].set(position_world)

    def numpy_pose(self, numbers: object) -> Float[np.ndarray, "4 4"]:
        """The pose of [x, y, z, qw, qx, qy, qz] [m, -]; the quaternion may have any length but zero."""
        array = _checked(numbers, self.name, "[x, y, z, qw, qx, qy, qz]")
        largest = np.max(np.abs(array[3:]))
        if largest == 0.0:
            raise InputError(f"{self.name} pose: quaternion [qw, qx, qy, qz] must not be zero, got {numbers!r}")
        array[3:] /= largest  # a tiny one must not underflow
        pose = np.eye(4, dtype=jnp.result_type(float))
        pose[:3, :3] = rotation_quaternion(array[3:].astype(pose.dtype))
        pose[:3, 3] = array[:3]
        return pose

    def numbers_of(self, pose: Float[Array, "4 4"]) -> Float[Array, "7"]:
        """[x, y, z, qw, qx, qy, qz], a unit quaternion with qw >= 0 [m, -]."""
        return jnp.concatenate([pose[:3, 3], lie.quaternion_so3(pose[:3, :3])])


SPACES: dict[str, Space] = {"planar": Planar(), "spatial": Spatial()}
