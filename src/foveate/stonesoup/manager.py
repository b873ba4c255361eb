"""A foveate policy in a Stone Soup simulation (extra `stonesoup`): a sensor manager that steers a sensor's platform.

    body = BodyMovable(states=State([0, 0], timestamp=start), position_mapping=(0, 1), agent=problem.agent)
    sensor = ViewSensor(ndim_state=2, position_mapping=(0, 1), noise_covar=0.04 * np.eye(2), view=problem.sensor.view,
                        space=problem.agent.space)
    platform = Platform(movement_controller=body, sensors=[sensor])
    manager = PolicySensorManager(platforms={platform}, policy=policy, predictor=KalmanPredictor(motion))

Tracks, predictor and updater are Stone Soup's own. Stone Soup orders a state [x, vx, y, vy], foveate [x, y, vx, vy];
the order follows from the sensor's `position_mapping`, or else from its measurement model.
"""

import datetime
import warnings
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from stonesoup.models.base import GaussianModel, LinearModel
from stonesoup.predictor import Predictor
from stonesoup.sensormanager import SensorManager
from stonesoup.types.track import Track

from foveate.deploy.decider import Decider
from foveate.errors import InputError
from foveate.geometry import fov, fov_planar
from foveate.io.validate import require
from foveate.models.agent import Agent
from foveate.models.polar import Polar, finest_gain
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.simulation.records import Observation, Policy
from foveate.stonesoup.parts import MODELS, BodyMovable, Property, TwistAction, pose_of


def state_order(position_mapping: Iterable[int], ndim_state: int) -> tuple[int, ...]:
    """Indices in Stone Soup's state of foveate's: positions, then velocities and so on.

    Stone Soup's state is either interleaved, [x, vx, y, vy], or in blocks, [x, y, vx, vy]; else an InputError.
    """
    first = tuple(int(i) for i in position_mapping)
    parts, rest = divmod(ndim_state, len(first))
    for stride in (1, len(first)):
        order = tuple(i + stride * part for part in range(parts) for i in first)
        if not rest and sorted(order) == list(range(ndim_state)):
            return order
    raise InputError(
        f"position_mapping = {first} of {ndim_state} numbers: expected positions with equally many derivatives each, "
        "as [x, vx, y, vy] or [x, y, vx, vy]"
    )


def problem_of(sensor: Any, predictor: Predictor, tau_s: float, prior_covariance: Any) -> Problem:
    """Problem of a Stone Soup simulation, for training, planning and heuristics.

    Raises InputError for models that are not linear-Gaussian, and sensors not carried along a `BodyMovable`'s heading.

    Args:
        sensor: gives field of view and noise; its `BodyMovable` gives the body and its limits. A sensor with a linear
            model, `max_range` and `fov_angle`, named as in Stone Soup's radars, sees a sector.
        predictor: gives A and W, and B where it has a control model.
        tau_s: control period [s].
        prior_covariance: of an initial belief (n_y, n_y), in Stone Soup's order.
    """
    agent = _body_of(sensor).agent
    motion_model, measurement, order = _models(sensor, predictor)
    block, d, n_y = np.ix_(order, order), agent.space.dimension, len(order)
    interval = {"time_interval": datetime.timedelta(seconds=tau_s)}
    # Without a control model Stone Soup's default is zeros of another width.
    control: Any = predictor.control_model
    control_matrix = np.asarray(control.matrix(**interval), float)
    B = control_matrix[order] if control_matrix.any() else np.zeros((n_y, d))
    A, W = (np.asarray(matrix(**interval))[block] for matrix in (motion_model.matrix, motion_model.covar))
    coordinates, V = MODELS.get(type(measurement)), measurement.covar()
    H = np.asarray(measurement.matrix())[:, order] if coordinates is None else np.eye(d, n_y)
    polar = None if coordinates is None else Polar(coordinates, (0.0,) * len(coordinates))
    Z = np.eye(d, n_y)
    gain = H.T @ np.linalg.inv(V) @ H if polar is None else finest_gain(polar, V, Z, None)
    return Problem(
        agent=agent,
        sensor=Sensor(H=_array(H), V=_array(V), view=_view_of(sensor, agent), polar=polar),
        motion=LinearGaussian.of(A, B, W, Z, [gain]),
        tau=_array(tau_s),
        prior_information=_array(np.linalg.inv(np.asarray(prior_covariance, float)[block])),
    )


class PolicySensorManager(SensorManager):
    """Steers the platform of one sensor by a foveate policy.

    Stone Soup's predictor predicts each track to `timestamp`; the policy decides on the predictions, at the pose of the
    sensor, and may know the limits of its body, its sensor, and the motion of the targets until then. Its command
    becomes an action of the platform, or of a sensor with `steers` that is given alone.

    The number of steps left follows from `end_time`, the end of the run; a run without an end always has `steps_left`,
    as in the middle of a training episode. `trained_for` is the problem that the policy was trained on: a warning names
    once its differences from this one, and the belief of a new target is that of the training. Inputs of the targets
    are taken as unknown. Raises InputError for a model that is not linear-Gaussian, for a sensor without a field of
    view, for tracks without a covariance, and unless there is exactly one sensor.
    """

    policy: Policy = Property(doc="Policy that decides.")
    predictor: Predictor = Property(doc="Kalman predictor of the tracks.")
    end_time: datetime.datetime = Property(default=None, doc="End of the run.")
    steps_left: int = Property(default=8, doc="Steps left at each decision of a run without an end.")
    trained_for: Problem = Property(default=None, doc="Problem that the policy was trained on.")
    pad_to: int = Property(default=8, doc="The policy is compiled for multiples of this number of tracks.")
    seed: int = Property(default=0, doc="Random seed of the policy.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        sensors: Any = self.sensors
        if len(sensors) != 1:
            raise InputError(f"{len(sensors)} sensors: expected one, which the policy steers")
        (self._sensor,) = sensors
        self._agent = _body_of(self._sensor).agent
        *_, self._order = _models(self._sensor, self.predictor)
        if not self.platforms and not getattr(self._sensor, "steers", False):
            raise InputError("platforms is empty: expected the sensor's platform, or a ViewSensor with steers=True")
        self._decider = Decider(self.policy, self._agent, self.seed)
        self._robots: dict[float, Robot] = {}
        if self.trained_for is not None:
            self._warn(self.trained_for)

    def choose_actions(  # pyright: ignore[reportIncompatibleMethodOverride]  # as all of Stone Soup's own
        self, tracks: Iterable[Track], timestamp: datetime.datetime, nchoose: int = 1, **kwargs: Any
    ) -> list[dict[Any, tuple[TwistAction, ...]]]:
        """The policy's command until `timestamp`; `nchoose` must be 1."""
        require(nchoose == 1, "nchoose", nchoose, "expected 1, a policy has one answer")
        robot = self._robot((timestamp - self._sensor.movement_controller.state.timestamp).total_seconds())
        control = self._decider.command(self._observation(tracks, timestamp, robot))
        actionable = next(iter(self.platforms), self._sensor)
        (generator,) = actionable.actions(timestamp)
        return [{actionable: (generator.action_from_value(control),)}]

    def _robot(self, tau_s: float) -> Robot:
        """What the policy may know of its robot, over the time of this decision [s]."""
        if tau_s not in self._robots:
            own = problem_of(self._sensor, self.predictor, tau_s, np.eye(len(self._order)))
            prior = own.prior_information / own.sensor.view.depth**2
            if self.trained_for is not None:
                prior = self.trained_for.prior_information.astype(prior.dtype)
            # Only the last: a run without a fixed interval has as many as decisions.
            self._robots = {tau_s: Robot.of(replace(own, prior_information=prior))}
        return self._robots[tau_s]

    def _observation(self, tracks: Iterable[Track], timestamp: datetime.datetime, robot: Robot) -> Observation:
        """The policy's observation: the predicted tracks in the order of their ids, padded."""
        ordered = sorted(tracks, key=lambda track: track.id)
        n, n_y = len(ordered), len(self._order)
        size = self.pad_to * max(1, -(-n // self.pad_to))
        mean, covariance = np.zeros((size, n_y)), np.broadcast_to(np.eye(n_y), (size, n_y, n_y)).copy()
        for i, track in enumerate(ordered):
            if not hasattr(track.state, "covar"):
                raise InputError(f"track {track.id}: {type(track.state).__name__}: expected a Gaussian state")
            state = self.predictor.predict(track.state, timestamp=timestamp)
            mean[i] = np.asarray(state.mean, float)[self._order, 0]
            covariance[i] = np.asarray(state.covar, float)[np.ix_(self._order, self._order)]
        return Observation(
            step=jnp.zeros((), int),
            left=jnp.asarray(self._left(timestamp), int),
            pose=_array(pose_of(self._sensor, self._agent.space)),
            mean=_array(mean),
            information=_array(np.linalg.inv(covariance)),
            present=jnp.arange(size) < n,
            known_input=jnp.zeros((size, robot.problem.motion.input_size)),
            robot=robot,
        )

    def _left(self, timestamp: datetime.datetime) -> int:
        """Steps left, including this one, all equally long."""
        if self.end_time is None:
            return self.steps_left
        start = self._sensor.movement_controller.state.timestamp
        return max(1, round((self.end_time - start) / (timestamp - start)))

    def _warn(self, trained: Problem) -> None:
        tau_s = float(trained.tau)
        own = problem_of(self._sensor, self.predictor, tau_s, np.eye(len(self._order)))
        pairs = {
            "body and its limits": (trained.agent, own.agent),
            "field of view": (trained.sensor.view, own.sensor.view),
            "noise of the sensor": (_noise_of(trained.sensor), _noise_of(own.sensor)),
            f"motion of the targets over {tau_s:g} s": tuple((m.A, m.W, m.Z) for m in (trained.motion, own.motion)),
        }
        if other := [name for name, pair in pairs.items() if not eqx.tree_equal(*pair, rtol=1e-4)]:
            warnings.warn(f"the policy was trained for another problem: {', '.join(other)}", stacklevel=3)


def _noise_of(sensor: Sensor) -> dict[str, Any]:
    """Covariances by what is measured, in whatever order."""
    if sensor.polar is None:
        return {"position": sensor.V}
    names = list(enumerate(sensor.polar.coordinates))
    return {f"{a} {b}": sensor.V[i, j] for i, a in names for j, b in names}


def _body_of(sensor: Any) -> BodyMovable:
    """Body that carries a sensor, without an offset."""
    body = sensor.movement_controller
    if not isinstance(body, BodyMovable):
        raise InputError(f"the sensor is carried by {type(body).__name__}: expected a BodyMovable, which has a heading")
    if np.any(sensor.mounting_offset) or np.any(sensor.rotation_offset):
        raise InputError("the sensor has an offset from its platform: expected none; put it into the field of view")
    return body


def _models(sensor: Any, predictor: Predictor) -> tuple[Any, Any, list[int]]:
    """Linear-Gaussian transition, measurement model (linear-Gaussian, or in `MODELS`), and the `state_order`."""
    models = predictor.transition_model, sensor.measurement_model
    for owner, model in zip((predictor, sensor), models, strict=True):
        is_polar = owner is sensor and type(model) in MODELS
        if not (is_polar or (isinstance(model, LinearModel) and isinstance(model, GaussianModel))):
            raise InputError(
                f"{type(owner).__name__} has a {type(model).__name__}: expected a linear-Gaussian model; "
                "foveate's beliefs are those of a Kalman filter"
            )
    position = getattr(sensor, "position_mapping", None) or models[1].mapping
    return *models, list(state_order(position, models[1].ndim_state))


def _view_of(sensor: Any, agent: Agent) -> fov.FieldOfView:
    if isinstance(view := getattr(sensor, "view", None), fov.FieldOfView):
        return view
    radius, angle = getattr(sensor, "max_range", None), getattr(sensor, "fov_angle", None)
    if radius is None or angle is None or agent.space.dimension != 2:
        right = "expected `view`, or `max_range` and `fov_angle`"
        raise InputError(f"{type(sensor).__name__} has no field of view: {right}")
    return fov_planar.sector(float(radius), float(angle))


def _array(value: Any) -> Float[jax.Array, "..."]:
    return jnp.asarray(np.asarray(value, float), float)
