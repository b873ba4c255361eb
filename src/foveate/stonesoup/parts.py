"""Components that Stone Soup lacks: a movable with a heading, its commands, a sensor with a field of view."""

import datetime
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from stonesoup import base
from stonesoup.functions import build_rotation_matrix
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import (
    Cartesian2DToBearing,
    CartesianToBearingRange,
    CartesianToElevationBearing,
    CartesianToElevationBearingRange,
)
from stonesoup.movable import FixedMovable
from stonesoup.sensor.sensor import SimpleSensor
from stonesoup.sensormanager.action import Action, ActionGenerator
from stonesoup.types.array import CovarianceMatrix, StateVector
from stonesoup.types.state import State

from foveate.errors import InputError
from foveate.geometry.fov import FieldOfView
from foveate.geometry.space import Space
from foveate.models.agent import Agent
from foveate.models.polar import Coordinate

Property: Any = base.Property  # for type checkers, as a property is declared with the type of its value

# Compiled, as Stone Soup's managers move and sense a thousand times per decision.
_moved = jax.jit(lambda agent, pose, control, seconds: agent.move(pose, agent.action(control), seconds))
_contains = jax.jit(lambda view, space, pose, point_world: view.contains(space.to_body(pose, point_world)))


def pose_of(carrier: Any, space: Space) -> Float[np.ndarray, "..."]:
    """The pose of a movable or a sensor: [x, y, yaw], or the transform from body to world."""
    position, orientation = np.asarray(carrier.position, float)[:, 0], carrier.orientation
    if space.dimension == 2:
        return np.append(position, float(orientation[2, 0]))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = build_rotation_matrix(np.asarray(orientation, float)).T, position
    return pose


class TwistAction(Action):
    """Keep one command until `end_time`: `target_value` has a number for each actuated axis [m/s, rad/s]."""

    def act(
        self, current_time: datetime.datetime, timestamp: datetime.datetime, init_value: Any, **kwargs: Any
    ) -> Float[np.ndarray, "..."]:
        """The pose after the command from the pose `init_value`."""
        seconds = (timestamp - current_time).total_seconds()
        return np.asarray(_moved(self.generator.owner.agent, init_value, self.target_value, seconds), float)


class TwistActionGenerator(ActionGenerator):
    """All commands of a body; iterates over its set of them, or over a grid of `resolution` values on each axis."""

    def __contains__(self, item: Any) -> bool:
        control = np.asarray(item.target_value if isinstance(item, Action) else item, float)
        lower, upper = self._limits
        return control.shape == lower.shape and bool(np.all((lower <= control) & (control <= upper)))

    def __iter__(self) -> Iterator[TwistAction]:
        body: Any = self.owner
        if body.agent.commands is not None:
            return (self.action_from_value(control) for control in np.asarray(body.agent.commands, float))
        counts: Any = self.resolution
        axes = (np.linspace(low, high, count) for low, high, count in zip(*self._limits, counts, strict=True))
        return (self.action_from_value(np.array(control)) for control in product(*axes))

    def action_from_value(self, value: Float[np.ndarray, " m"]) -> TwistAction:
        """The action of a command; the body clips it to its limits."""
        return TwistAction(generator=self, end_time=self.end_time, target_value=np.asarray(value, float))

    @property
    def default_action(self) -> TwistAction:
        """Stand as still as the limits allow."""
        return self.action_from_value(np.clip(0.0, *self._limits))

    @property
    def _limits(self) -> tuple[np.ndarray, np.ndarray]:
        body: Any = self.owner
        return np.asarray(body.agent.lower, float), np.asarray(body.agent.upper, float)


class BodyMovable(FixedMovable):
    """Movement controller for commands of a foveate `Agent`: T' = T exp(tau hat(u)), heading included.

    `orientation` is Stone Soup's [roll, pitch, yaw], in rad. Without a command, and after its end, the body is as still
    as its limits allow. Its reported velocity is 0, as any FixedMovable's. `position_mapping` needs one entry for each
    dimension of the agent's space.
    """

    agent: Agent = Property(doc="Actuated axes and their limits.")
    levels: Sequence[int] = Property(default=None, doc="Values on each axis that Stone Soup's managers try; 5 each.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        axes, d = len(self.agent.axes), self.agent.space.dimension
        if self.ndim != d:
            raise InputError(f"position_mapping = {self.position_mapping}: expected {d} entries, as the agent's space")
        if self.levels is None:
            self.levels = (5,) * axes
        if len(self.levels) != axes:
            raise InputError(f"levels = {self.levels}: expected {axes} numbers, one for each actuated axis")
        self.orientation = StateVector(np.asarray(self.orientation, float).ravel())
        self._command: Action | None = None

    @property
    def pose(self) -> Float[np.ndarray, "..."]:
        """[x, y, yaw], or the transform from body to world."""
        return pose_of(self, self.agent.space)

    def actions(
        self, timestamp: datetime.datetime, start_timestamp: datetime.datetime | None = None
    ) -> set[ActionGenerator]:
        """The generator of all commands until `timestamp`."""
        times = {"start_time": start_timestamp or self.state.timestamp, "end_time": timestamp}
        return {TwistActionGenerator(owner=self, attribute="pose", resolution=self.levels, **times)}

    def add_actions(self, actions: Sequence[Action]) -> bool:
        """Set the command: the first of the actions."""
        self._command = actions[0]
        return True

    def act(self, timestamp: datetime.datetime, **kwargs: Any) -> None:
        """Same as `move`."""
        self.move(timestamp, **kwargs)

    def move(self, timestamp: datetime.datetime, **kwargs: Any) -> None:
        """Execute the command until `timestamp`, if that is later than the body's own time."""
        time = self.state.timestamp
        if time is None:
            self.state.timestamp = time = timestamp
        if timestamp <= time:
            return
        pose, command = self.pose, self._command
        if command is not None and command.end_time > time:
            until = min(command.end_time, timestamp)
            pose, time = command.act(time, until, pose), until
        if time < timestamp:
            (generator,) = self.actions(timestamp, time)
            pose, self._command = generator.default_action.act(time, timestamp, pose), None
        state = State.from_state(self.state, timestamp=timestamp)
        state.state_vector = state.state_vector.copy()
        self.states.append(state)
        if self.agent.space.dimension == 2:
            self.position, self.orientation = StateVector(pose[:2]), StateVector([0.0, 0.0, pose[2]])
        else:
            yaw, dive, roll = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")
            self.position, self.orientation = StateVector(pose[:3, 3]), StateVector([roll, -dive, yaw])


MODELS: dict[type, tuple[Coordinate, ...]] = {
    CartesianToBearingRange: ("bearing", "range"),
    Cartesian2DToBearing: ("bearing",),
    CartesianToElevationBearingRange: ("elevation", "bearing", "range"),
    CartesianToElevationBearing: ("elevation", "bearing"),
}
"""Stone Soup's models of sensors that measure in their own frame, and what they measure, in their order."""


class ViewSensor(SimpleSensor):
    """Measures positions with Gaussian noise inside a field of view that its platform carries.

    With `model`, one of Stone Soup's in `MODELS`, it measures bearings and ranges in its own frame instead.

    `view` is a shape of `foveate.geometry`, in the sensor's frame: x ahead, y to the left, z up. With `steers` its
    actions are those of the movable that carries it, for managers that evaluate each sensor alone, as Stone Soup's
    greedy one; give such a sensor to a manager without its platform, or every command is tried twice.
    """

    ndim_state: int = Property(doc="Length of a target's state.")
    position_mapping: Sequence[int] = Property(doc="Indices of the position in a target's state.")
    noise_covar: CovarianceMatrix = Property(
        doc="Covariance of a measured position, in the world frame [m^2], or of `model`."
    )
    view: FieldOfView = Property(doc="The field of view.")
    space: Space = Property(doc="The plane, or space.")
    steers: bool = Property(default=False, doc="True if it offers the commands of the movable that carries it.")
    model: type = Property(default=None, doc="Class of a model in `MODELS`; None: positions.")

    @property
    def measurement_model(self) -> Any:
        """The position plus noise, or what `model` measures from here."""
        common = {"ndim_state": self.ndim_state, "mapping": self.position_mapping, "noise_covar": self.noise_covar}
        if self.model is None:
            return LinearGaussian(**common)
        if self.model not in MODELS:
            names = ", ".join(each.__name__ for each in MODELS)
            raise InputError(f"model = {self.model!r}: expected one of {names}, or None for positions")
        return self.model(**common, translation_offset=self.position, rotation_offset=self.orientation)

    def is_detectable(self, state: State, measurement_model: Any = None) -> bool:
        """True where the state's position is in view."""
        return self._sees(state.state_vector[list(self.position_mapping), :])

    def is_clutter_detectable(self, state: State) -> bool:
        """True where a false detection is in view; one without a range always is."""
        if self.model is None:
            return self._sees(state.state_vector)
        if "range" not in MODELS[self.model]:
            return True
        return self._sees(self.measurement_model.inverse_function(state)[list(self.position_mapping), :])

    def _sees(self, position_world: Any) -> bool:
        pose = pose_of(self, self.space)
        return bool(_contains(self.view, self.space, pose, np.asarray(position_world, float)[:, 0]))

    def actions(
        self, timestamp: datetime.datetime, start_timestamp: datetime.datetime | None = None
    ) -> set[ActionGenerator]:
        """The actions of the movable that carries it if it `steers`, else none."""
        return self.movement_controller.actions(timestamp, start_timestamp) if self.steers else set()

    def add_actions(self, actions: Sequence[Action]) -> bool:
        """Pass a command to the movable if it `steers`."""
        return self.movement_controller.add_actions(actions) if self.steers else super().add_actions(actions)

    def act(self, timestamp: datetime.datetime, **kwargs: Any) -> None:
        """Move if it `steers`."""
        if self.steers:
            self.movement_controller.act(timestamp, **kwargs)
        super().act(timestamp)
