"""Tracker for a robot without one: targets appear, are updated by id, age, and are dropped."""

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from foveate.deploy.belief import Belief
from foveate.deploy.history import Event, History
from foveate.deploy.motion import Matrices, motion_over
from foveate.deploy.observing import Observing
from foveate.deploy.pose import QuaternionOrder, checked_pose
from foveate.deploy.tracks import Seen, Tracks, check_id, checked
from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.scenario.rows import MAX_LENGTH
from foveate.scenario.scenario import Scenario

SAME_S = 1e-6
"""Times that differ by less are the same: a sum of many steps, or a clock from 1970, is no more exact."""
MAX_TIME_S = 1e12
"""Latest time of a detection [s]: a clock from 1970 in milliseconds is beyond it."""


class Tracker(Tracks, Observing):
    """One Kalman filter per target, with the motion and the sensor of a scenario; means and covariances in the world.

    Each step: `predict`, decide on `inputs` or `observation`, move, detect, `update`. A step is tau seconds, or `dt_s`.
    With times of detections, `update` first predicts to their time if it is later than that of the beliefs, `time_s`;
    those up to `lag_s` seconds earlier are worked in where they belong, by filtering again from there. What is left is
    the result of the sorted sequence. Older ones are rejected, and counted in `too_late`.

    A detection with a new id begins a belief: N(z, V) in measured directions, the scenario's prior about 0 in the
    others (one-point initiation). A target without an update for more than `forget_after_s` seconds is dropped. With
    `sensor.missed_detections = "used"`, a target without a detection is believed to be outside the view.

    A detection is rejected if its squared Mahalanobis distance to the prediction is above the quantile `gate` of the
    chi-square distribution (Bar-Shalom, Li & Kirubarajan 2001, section 5.4): 0.9999 rejects one correct detection in
    ten thousand. One that is not finite, or beyond 1e9 m, is rejected too. `rejected` counts them by id, of the 10,000
    ids that were rejected last. A target that has jumped is rejected four times in a row, and begins again with the
    fifth detection. With `gate` None all others pass.

    Ids are any hashable values that equal themselves: NaN does not, and raises InputError.
    """

    def __init__(
        self,
        problem: Problem | Scenario,
        *,
        forget_after_s: float = 10.0,
        gate: float | None = GATE,
        lag_s: float = 0.0,
    ) -> None:
        if not forget_after_s > 0:
            raise InputError(f"forget_after_s = {forget_after_s}: expected > 0")
        if not 0 <= lag_s < np.inf:
            raise InputError(f"lag_s = {lag_s}: expected a number of seconds, 0 or more")
        super().__init__(problem, forget_after_s, gate)
        self._over, self._history = motion_over(problem), History(lag_s)
        self.too_late = 0
        self._has_clock, self._step_s = False, None

    def add(self, target: Hashable, position_world: ArrayLike, covariance: ArrayLike | None = None) -> None:
        """Begin a belief about a target before any detection of it.

        Raises InputError if the id is tracked already, a shape is wrong, or the covariance is not positive definite.

        Args:
            target: Its id, not tracked yet.
            position_world: Expected position (d,) [m]; the rest of the state begins at 0.
            covariance: Of its state (n_y, n_y); by default the scenario's prior.
        """
        check_id(target)
        if target in self.ids:
            raise InputError(f"target {target!r}: is tracked already")
        position = checked(f"position of target {target!r}", position_world, (len(self._Z),))
        P = self._prior if covariance is None else _covariance("covariance", covariance, len(self._prior))
        mean = (np.linalg.pinv(self._Z) @ position)[None]

        def act() -> None:
            if target not in self.ids:  # a late detection of it may have come before
                self._begin([target], mean, P[None])

        self._do(Event(self.time_s, act))

    def predict(
        self, dt_s: float | None = None, known_inputs: Mapping[Hashable, ArrayLike] | None = None
    ) -> tuple[Hashable, ...]:
        """Predict all beliefs one step ahead; drop the targets without an update for too long, and return their ids.

        Also dropped are those whose belief has become too vague for numbers. The step is `dt_s` seconds long, by
        default the scenario's tau. `known_inputs` are xi (m_y,) by id, 0 by default, as for a step of tau: a step of
        half the length has half the displacement of a drift. Raises InputError for one of another length, not finite,
        or beyond 1e9, and for a length of a step that is no positive number.
        """
        if isinstance(dt_s, Mapping) or not isinstance(known_inputs or {}, Mapping):
            raise InputError("predict: expected seconds first, and inputs by target id: known_inputs={id: [..]}")
        k, inputs, zero = self.step % len(self._tau), known_inputs or {}, np.zeros(self._B.shape[2])
        tau_s = float(self._tau[k])
        length_s = tau_s if dt_s is None else _seconds("dt_s", dt_s)
        if length_s <= 0:
            raise InputError(f"dt_s = {dt_s}: expected seconds > 0")
        xi = {name: checked(f"known input of target {name!r}", inputs.get(name, zero), zero.shape) for name in self.ids}
        self._step_s, exact = length_s, (self._A[k], self._B[k], self._W[k])
        if dt_s is not None:
            exact = self._over(length_s)  # raises where the targets know no such step
        moving = self._moving(length_s, xi, exact)

        def act() -> tuple[Hashable, ...]:
            self.step += 1
            return moving.act()

        return self._do(moving._replace(act=act))

    def update(
        self,
        pose: ArrayLike,
        detections: Mapping[Hashable, ArrayLike],
        *,
        time_s: float | None = None,
        quaternion: QuaternionOrder = "wxyz",
        V: ArrayLike | None = None,
    ) -> Seen:
        """Correct the beliefs by detections; begin those of new ids.

        Raises InputError, without any change, if the pose, a detection or V has another shape, if the pose is not
        finite or beyond 1e9, and for an id that does not equal itself.

        Args:
            pose: The agent's pose when it measured, in any form that `RobotPolicy` takes.
            detections: Measurements z = H y (n_z,) in the world frame, by id; of a sensor that `measures` in its own
                frame those numbers in the order of the name, as (range [m], bearing [rad, to the left of ahead]).
            time_s: When it measured [s], on any clock: the first one sets it. By default, at the time of the beliefs.
            quaternion: Order of a pose's quaternion; ROS has "xyzw".
            V: Covariance of the noise (n_z, n_z) where another robot's sensor has measured, as the scenario's sensor
                has it: in its frame, and at a range of 0.
        """
        here, measured = checked_pose(pose, len(self._Z), quaternion), self._measured(detections)
        noise = None if V is None else _covariance("V", V, self._sensor.size)
        if time_s is None:
            return self._do(Event(self.time_s, lambda: self._look(here, measured, noise)))
        at_s = _seconds("time_s", time_s)
        if not self._has_clock:
            self._history.clear()
            self.time_s, self._has_clock = at_s, True
        look = Event(at_s, lambda: self._look(here, measured, noise))
        if (ahead_s := at_s - self.time_s) > -SAME_S:
            if ahead_s > SAME_S:
                self._do(self._moving(ahead_s, {}, self._over(ahead_s)))
            return self._do(look._replace(time_s=self.time_s))
        if (past := self._history.since(at_s, self.time_s)) is None:
            self._count(rejected := tuple(measured))
            self.too_late += len(rejected)
            return Seen(updated=(), appeared=(), rejected=rejected)
        state, later = past
        self._restore(state)
        between = later[0].move
        assert between is not None, "only a prediction leads beyond a time"
        self._do(Event(at_s, lambda: between(at_s), between))
        seen = self._do(look)
        for event in later:
            self._do(event)
        return seen

    def belief(self) -> Belief:
        """All beliefs at the current step; after `predict`, the input of a policy."""
        return Belief(self.mean, covariance=self.covariance, known_input=self._known_input, step_s=self._step_s)

    def __repr__(self) -> str:
        named = "".join(f", {target!r}" for target in self.ids[:5]) + ", .." * (len(self.ids) > 5)
        return f"Tracker(step {self.step}, {len(self.ids)} targets{named})"

    def _do(self, event: Event) -> Any:
        """Let an event happen, and remember it for late detections."""
        self._history.keep(event, self.time_s, self._state)
        return event.act()

    def _moving(self, length_s: float, xi: Mapping[Hashable, np.ndarray], exact: Matrices) -> Event:
        """Prediction over a length of time, by the matrices `exact` if nothing comes between."""
        start_s, end_s = self.time_s, self.time_s + length_s

        def move(to_s: float) -> tuple[Hashable, ...]:
            is_whole = self.time_s == start_s and to_s == end_s
            part_s = length_s if is_whole else to_s - self.time_s
            dropped = self._advance(part_s, xi, exact if is_whole else self._over(part_s))
            self.time_s = to_s
            return dropped

        return Event(end_s, lambda: move(end_s), move)


def _covariance(name: str, value: ArrayLike, size: int) -> np.ndarray:
    """A covariance of this size. Raises InputError for another matrix."""
    P = checked(name, value, (size, size), MAX_LENGTH**2)
    if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max() or np.linalg.eigvalsh(P)[0] <= 0:
        raise InputError(f"{name} = {P.tolist()}: expected a symmetric, positive definite matrix")
    return P


def _seconds(name: str, value: Any) -> float:
    try:
        seconds = float(value)
    except (TypeError, ValueError):
        seconds = np.nan
    if not abs(seconds) <= MAX_TIME_S:
        raise InputError(f"{name} = {value!r}: expected a number of seconds, at most {MAX_TIME_S:g}")
    return seconds
