"""A foveate policy in a Stone Soup simulation (extra `stonesoup`): a sensor manager that steers a sensor's platform.

    body = BodyMovable(states=State([0, 0], timestamp=start), position_mapping=(0, 1), agent=problem.agent)
    sensor = ViewSensor(ndim_state=2, position_mapping=(0, 1), noise_covar=0.04 * np.eye(2), view=problem.sensor.view,
                        space=problem.agent.space)
    platform = Platform(movement_controller=body, sensors=[sensor])
    manager = PolicySensorManager(platforms={platform}, policy=policy, predictor=KalmanPredictor(motion))

Tracks, predictor and updater are Stone Soup's own. Stone Soup orders a state [x, vx, y, vy], foveate [x, y, vx, vy];
the order follows from the sensor's `position_mapping`, or from what it measures where it has none.
"""

import datetime
import warnings
from collections.abc import Iterable
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

from foveate.errors import InputError
from foveate.geometry import fov, fov_planar
from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.simulation.records import Observation, Policy
from foveate.stonesoup.parts import BodyMovable, Property, TwistAction, pose_of


def state_order(position_mapping: Iterable[int], ndim_state: int) -> tuple[int, ...]:
    """Indices in Stone Soup's state of foveate's: positions first, then velocities and so on.

    Stone Soup's is either interleaved, [x, vx, y, vy], or in blocks, [x, y, vx, vy]. Raises InputError for others.
    """
    first = tuple(int(i) for i in position_mapping)
    parts, rest = divmod(ndim_state, len(first))
    for stride in (1, len(first)):
        order = tuple(i + stride * part for part in range(parts) for i in first)
        if not rest and sorted(order) == list(range(ndim_state)):
            return order
    raise InputError(
        f"position_mapping = {first} of {ndim_state} numbers: expected positions with as many derivatives each, "
        "as [x, vx, y, vy] or [x, y, vx, vy]"
    )


def problem_of(sensor: Any, predictor: Predictor, tau_s: float, prior_covariance: Any) -> Problem:
    """Problem of a Stone Soup simulation, to train for, plan in, or make a heuristic for.

    Args:
        sensor: Gives field of view and noise; the `BodyMovable` that carries it gives the body and its limits. A sensor
            with a linear model, `max_range` and `fov_angle`, named as in Stone Soup's radars, sees a sector.
        predictor: Gives A and W, and B where it has a control model.
        tau_s: Control period [s].
        prior_covariance: Of a first belief (n_y, n_y), in Stone Soup's order.

    Raises:
        InputError: A model is not linear-Gaussian, or the sensor is carried in a way that foveate does not have.
    """
    agent = _body_of(sensor).agent
    motion_model, measurement = _linear(sensor, predictor)
    order = list(state_order(_mapping(sensor), measurement.ndim_state))
    block, d, n_y = np.ix_(order, order), agent.space.dimension, len(order)
    interval = {"time_interval": datetime.timedelta(seconds=tau_s)}
    # Stone Soup's own control model, where none is given, is zeros of another width.
    control: Any = predictor.control_model
    control_matrix = np.asarray(control.matrix(**interval), float)
    B = control_matrix[order] if control_matrix.any() else np.zeros((n_y, d))
    return Problem(
        agent=agent,
        sensor=Sensor(
            H=_array(np.asarray(measurement.matrix())[:, order]),
            V=_array(measurement.covar()),
            view=_view_of(sensor, agent),
        ),
        motion=LinearGaussian(
            A=_array(np.asarray(motion_model.matrix(**interval))[block]),
            B=_array(B),
            W=_array(np.asarray(motion_model.covar(**interval))[block]),
            Z=jnp.eye(d, n_y),
        ),
        tau=_array(tau_s),
        prior_information=_array(np.linalg.inv(np.asarray(prior_covariance, float)[block])),
    )


class PolicySensorManager(SensorManager):
    """Steers the platform of one sensor by a foveate policy.

    Each track is predicted to `timestamp` by Stone Soup's predictor, and the policy decides on the predictions, at the
    pose of the sensor. Its command becomes an action of the platform, or of a sensor given alone, one with `steers`.

    From `end_time`, the end of the run, follow the steps left; a run without an end has `steps_left` at every decision,
    as many as in the middle of a training episode. `trained_for` is the problem that the policy was trained on: a
    warning names once what differs here. No inputs of the targets are known. Raises InputError for a model that is not
    linear-Gaussian, for tracks without a covariance, and unless there is exactly one sensor.
    """

    policy: Policy = Property(doc="Decides.")
    predictor: Predictor = Property(doc="Predicts the tracks: a Kalman predictor.")
    end_time: datetime.datetime = Property(default=None, doc="When the run ends.")
    steps_left: int = Property(default=8, doc="Steps left at each decision of a run without an end.")
    trained_for: Problem = Property(default=None, doc="The problem that the policy was trained on.")
    pad_to: int = Property(default=8, doc="The policy is compiled for multiples of this number of tracks.")
    seed: int = Property(default=0, doc="Random seed of the policy.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        sensors: Any = self.sensors
        if len(sensors) != 1:
            raise InputError(f"{len(sensors)} sensors: expected one, which the policy steers")
        (self._sensor,) = sensors
        self._agent = _body_of(self._sensor).agent
        _, measurement = _linear(self._sensor, self.predictor)
        self._order = list(state_order(_mapping(self._sensor), measurement.ndim_state))
        if not self.platforms and not getattr(self._sensor, "steers", False):
            raise InputError("platforms is empty: expected the sensor's platform, or a ViewSensor with steers=True")
        self._memory, self._size, self._step = None, -1, 0
        if self.trained_for is not None:
            self._warn(self.trained_for)

    def choose_actions(  # pyright: ignore[reportIncompatibleMethodOverride]  # as all of Stone Soup's own
        self, tracks: Iterable[Track], timestamp: datetime.datetime, nchoose: int = 1, **kwargs: Any
    ) -> list[dict[Any, tuple[TwistAction, ...]]]:
        """The policy's command until `timestamp`. Raises InputError for other `nchoose` than 1."""
        if nchoose != 1:
            raise InputError(f"nchoose = {nchoose}: expected 1, a policy has one answer")
        seen = self._seen(tracks, timestamp)
        if len(seen["present"]) != self._size:
            self._size, self._memory = len(seen["present"]), _begin(self.policy, seen)
        control, self._memory = _decide(self.policy, self._agent, seen, self._memory, self.seed)
        self._step += 1
        actionable = next(iter(self.platforms), self._sensor)
        (generator,) = actionable.actions(timestamp)
        return [{actionable: (generator.action_from_value(np.asarray(control)),)}]

    def _seen(self, tracks: Iterable[Track], timestamp: datetime.datetime) -> dict[str, np.ndarray]:
        """Parts of the policy's observation: the predicted tracks in the order of their ids, padded."""
        ordered = sorted(tracks, key=lambda track: track.id)
        for track in ordered:
            if not hasattr(track.state, "covar"):
                raise InputError(f"track {track.id}: {type(track.state).__name__}: expected a Gaussian state")
        n, n_y, d = len(ordered), len(self._order), self._agent.space.dimension
        size = self.pad_to * max(1, -(-n // self.pad_to))
        mean, covariance = np.zeros((size, n_y)), np.broadcast_to(np.eye(n_y), (size, n_y, n_y)).copy()
        for i, track in enumerate(ordered):
            state = self.predictor.predict(track.state, timestamp=timestamp)
            mean[i] = np.asarray(state.mean, float)[self._order, 0]
            covariance[i] = np.asarray(state.covar, float)[np.ix_(self._order, self._order)]
        known = d if self.trained_for is None else self.trained_for.motion.input_size
        return {
            "step": np.array(self._step),
            "left": np.array(self._left(timestamp)),
            "pose": pose_of(self._sensor, self._agent.space),
            "mean": mean,
            "information": np.linalg.inv(covariance),
            "present": np.arange(size) < n,
            "known_input": np.zeros((size, known)),
        }

    def _left(self, timestamp: datetime.datetime) -> int:
        """Steps from now to the end, this one too, all as long as this one."""
        if self.end_time is None:
            return self.steps_left
        now = self._sensor.movement_controller.state.timestamp
        return max(1, round((self.end_time - now) / (timestamp - now)))

    def _warn(self, trained: Problem) -> None:
        tau = float(trained.tau)
        here = problem_of(self._sensor, self.predictor, tau, np.eye(len(self._order)))
        compared = {
            "body and its limits": (trained.agent, here.agent),
            "field of view": (trained.sensor.view, here.sensor.view),
            "noise of the sensor": (trained.sensor.V, here.sensor.V),
            f"motion of the targets over {tau:g} s": tuple((m.A, m.W, m.Z) for m in (trained.motion, here.motion)),
        }
        if other := [name for name, (theirs, ours) in compared.items() if not eqx.tree_equal(theirs, ours, rtol=1e-4)]:
            warnings.warn(f"the policy was trained for another problem: {', '.join(other)}", stacklevel=3)


@eqx.filter_jit
def _begin(policy: Policy, seen: dict[str, Any]) -> Any:
    return policy.start(Observation(**seen))


@eqx.filter_jit
def _decide(policy: Policy, agent: Agent, seen: dict[str, Any], memory: Any, seed: int) -> tuple[Any, Any]:
    """The command [m/s, rad/s], and what the policy remembers."""
    key = jax.random.fold_in(jax.random.key(seed), seen["step"])
    action, memory = policy(Observation(**seen), memory, key)
    return agent.control(action), memory


def _body_of(sensor: Any) -> BodyMovable:
    """Body that carries a sensor. Raises InputError unless the sensor looks where the body heads."""
    body = sensor.movement_controller
    if not isinstance(body, BodyMovable):
        raise InputError(f"the sensor is carried by {type(body).__name__}: expected a BodyMovable, which has a heading")
    if np.any(sensor.mounting_offset) or np.any(sensor.rotation_offset):
        raise InputError("the sensor has an offset from its platform: expected none; put it into the field of view")
    return body


def _linear(sensor: Any, predictor: Predictor) -> tuple[Any, Any]:
    """Transition and measurement model. Raises InputError where one is not linear-Gaussian."""
    models = predictor.transition_model, sensor.measurement_model
    for owner, model in zip((predictor, sensor), models, strict=True):
        if not (isinstance(model, LinearModel) and isinstance(model, GaussianModel)):
            raise InputError(
                f"{type(owner).__name__} has a {type(model).__name__}: expected a linear-Gaussian model; "
                "foveate's beliefs are those of a Kalman filter"
            )
    return models


def _mapping(sensor: Any) -> tuple[int, ...]:
    """Indices of the position in a target's state: the sensor's `position_mapping`, or else what it measures."""
    return tuple(getattr(sensor, "position_mapping", None) or sensor.measurement_model.mapping)


def _view_of(sensor: Any, agent: Agent) -> fov.FieldOfView:
    if isinstance(view := getattr(sensor, "view", None), fov.FieldOfView):
        return view
    radius, angle = getattr(sensor, "max_range", None), getattr(sensor, "fov_angle", None)
    if radius is None or angle is None or agent.space.dimension != 2:
        raise InputError(
            f"{type(sensor).__name__} has no field of view: expected `view`, or `max_range` and `fov_angle`"
        )
    return fov_planar.sector(float(radius), float(angle))


def _array(value: Any) -> Float[jax.Array, "..."]:
    return jnp.asarray(np.asarray(value, float), float)
