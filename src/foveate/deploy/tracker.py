"""Beliefs for a robot that has no tracker of its own: targets appear, are updated by id, age, and are dropped."""

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from foveate.deploy import kalman
from foveate.deploy.belief import Belief, observation
from foveate.errors import InputError
from foveate.models.gate import RESTART_AFTER, gate_limit
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Observation


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Outcome of an update, by id of the target.

    `updated` targets took their detection; `appeared` ones begin with it: new ids, and targets that have jumped;
    `rejected` detections were kept out by the gate, or are not finite.
    """

    updated: tuple[Hashable, ...]
    appeared: tuple[Hashable, ...]
    rejected: tuple[Hashable, ...]


class Tracker:
    """One Kalman filter per target, with the motion and the sensor of a scenario; means and covariances in the world.

    Each step of tau seconds: `predict`, decide on `inputs` or `observation`, move, detect, `update`. A detection with a
    new id begins a belief: N(z, V) in what is measured, the scenario's first belief, about 0, in the rest (one-point
    initiation). A target that no detection has updated for more than `forget_after_s` seconds is dropped.

    A detection is rejected where its squared Mahalanobis distance to the prediction is above the quantile `gate` of the
    chi-square distribution (Bar-Shalom, Li & Kirubarajan 2001, section 5.4): 0.9999 rejects one correct detection in
    ten thousand. One that is not finite is rejected too. `rejected` counts them by id. A target that has really jumped
    is rejected four times in a row, and begins again with the fifth detection. With `gate` None all finite ones pass.

    Where the scenario says `sensor.missed_detections = "used"`, a target without a detection is believed to be outside
    of the view.
    """

    def __init__(self, problem: Problem | Scenario, *, forget_after_s: float = 10.0, gate: float | None = GATE) -> None:
        if not forget_after_s > 0:
            raise InputError(f"forget_after_s = {forget_after_s}: expected > 0")
        problem = problem.problem() if isinstance(problem, Scenario) else problem
        self._problem, period, sensor = problem, problem.period, problem.sensor
        self._tau, self._V = _array(period.tau), _array(period.V)
        self._A, self._B, self._W = (_array(x) for x in (period.motion.A, period.motion.B, period.motion.W))
        self._H, self._Z, self._sensor = _array(sensor.H), _array(problem.motion.Z), sensor
        self._first = np.linalg.inv(_array(problem.prior_information))
        self._limit = gate_limit(gate, len(self._H)) or np.inf
        self._in_a_row: Counter[Hashable] = Counter()
        self._forget_after_s = forget_after_s
        self.step = 0
        self.ids: tuple[Hashable, ...] = ()
        self.rejected: Counter[Hashable] = Counter()
        n_y, m_y = self._B.shape[1:]
        self.mean: Float[np.ndarray, "n n_y"] = np.zeros((0, n_y))
        self.covariance: Float[np.ndarray, "n n_y n_y"] = np.zeros((0, n_y, n_y))
        self.unseen_s: Float[np.ndarray, " n"] = np.zeros(0)
        self._known_input = np.zeros((0, m_y))

    def add(self, target: Hashable, position_world: ArrayLike, covariance: ArrayLike | None = None) -> None:
        """Begin a belief about a target before any detection of it.

        Args:
            target: Its id, not tracked yet.
            position_world: Where it is expected (d,) [m]; the rest of its state begins at 0.
            covariance: Of its state (n_y, n_y); by default that of the scenario's first belief.

        Raises:
            InputError: The id is tracked already, a shape is wrong, or the covariance is not positive definite.
        """
        if target in self.ids:
            raise InputError(f"target {target!r}: is tracked already")
        position = _checked(f"position of target {target!r}", position_world, (len(self._Z),))
        P = self._first if covariance is None else _checked("covariance", covariance, self._first.shape)
        if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max() or np.linalg.eigvalsh(P)[0] <= 0:
            raise InputError(f"covariance = {P.tolist()}: expected a symmetric, positive definite matrix")
        self._begin(target, np.linalg.pinv(self._Z) @ position, P)

    def predict(self, known_inputs: Mapping[Hashable, ArrayLike] | None = None) -> tuple[Hashable, ...]:
        """Predict all beliefs one step ahead, and drop the targets that were not detected for too long.

        Args:
            known_inputs: Known input xi (m_y,) by id; 0 for a target that is not named.

        Returns:
            The ids that were dropped.

        Raises:
            InputError: An input has another length, or is not finite.
        """
        k = self.step % len(self._tau)
        A, B, W = self._A[k], self._B[k], self._W[k]
        given, zero = known_inputs or {}, np.zeros(B.shape[1])
        by_id = {t: _checked(f"known input of target {t!r}", given.get(t, zero), zero.shape) for t in self.ids}
        self.unseen_s = self.unseen_s + self._tau[k]
        # An age is a sum of many tau: rounding must not make it older than it is.
        dropped = self._keep(self.unseen_s <= self._forget_after_s * (1 + 1e-9))
        self._known_input = np.array([by_id[t] for t in self.ids]).reshape(len(self.ids), len(zero))
        self.mean, self.covariance = kalman.predict(self.mean, self.covariance, self._known_input, A, B, W)
        self.step += 1
        return dropped

    def update(self, pose: ArrayLike, detections: Mapping[Hashable, ArrayLike]) -> Seen:
        """Correct the beliefs by detections; ids that are not tracked yet begin.

        Args:
            pose: Where the agent was when it measured: [x, y, yaw] [m, rad], or in space 4 x 4, body to world.
            detections: Measurements z = H y (n_z,) in the world frame, by id.

        Raises:
            InputError: The pose or a detection has another shape, or the pose is not finite. Nothing has changed then.
        """
        pose = _checked("pose", pose, (3,) if len(self._Z) == 2 else (4, 4))
        measured = {target: np.asarray(z, float) for target, z in detections.items()}
        for target, z in measured.items():
            if z.shape != (len(self._H),):
                raise InputError(f"detection of {target!r} has shape {z.shape}: expected {(len(self._H),)}")
        finite = [target for target, z in measured.items() if np.isfinite(z).all()]
        row_of = {target: i for i, target in enumerate(self.ids)}
        tracked = [target for target in finite if target in row_of]
        accepted = self._correct(pose, [row_of[target] for target in tracked], [measured[target] for target in tracked])
        updated = tuple(compress(tracked, accepted))
        # One rejected detection is an outlier; several in a row mean that the target has moved: its old belief would
        # reject the truth for ever.
        jumped = self._jumped(tracked, accepted)
        for target in jumped:
            i = row_of[target]
            self.mean[i], self.covariance[i] = self._one_point(pose, measured[target])
            self.unseen_s[i] = 0.0
        new = tuple(target for target in finite if target not in row_of)
        for target in new:
            self._begin(target, *self._one_point(pose, measured[target]))
        appeared = (*jumped, *new)
        used = {*updated, *appeared}
        rejected = tuple(target for target in measured if target not in used)
        self.rejected.update(rejected)
        if self._sensor.uses_missed_detections:
            for i in (row for target, row in row_of.items() if target not in measured):
                outside = kalman.given_missed_detection(
                    self.mean[i], self.covariance[i], self._Z, self._sensor.view, pose
                )
                self.mean[i], self.covariance[i] = outside
        return Seen(updated=updated, appeared=appeared, rejected=rejected)

    def belief(self) -> Belief:
        """All beliefs at the present step: after `predict`, those that a policy decides on."""
        return Belief(self.mean, covariance=self.covariance, known_input=self._known_input)

    def inputs(self, pose: ArrayLike, steps_left: int, pad_to: int = 0) -> dict[str, np.ndarray]:
        """Inputs of an exported policy by name, for one decision, padded to at least `pad_to` targets.

        Some policies read only a part of them. A robot without an end gives the `steps_left` of the middle of a
        training episode every time: with many more a policy may put off everything for ever.
        """
        observed = self.observation(pose, steps_left, pad_to)
        arrays = {name: getattr(observed, name) for name in ("pose", "mean", "information", "known_input")}
        return {name: np.asarray(array, np.float32)[None] for name, array in arrays.items()} | {
            "present": np.asarray(observed.present)[None],
            "steps_left": np.array([steps_left]),
        }

    def observation(self, pose: ArrayLike, steps_left: int, pad_to: int = 0) -> Observation:
        """Observation of a policy in JAX, padded to at least `pad_to` targets: one compilation while that is enough."""
        step = max(0, self.step - 1)
        return observation(self.belief(), self._problem, np.asarray(pose, float), steps_left, pad_to, step)

    def __repr__(self) -> str:
        named = "".join(f", {target!r}" for target in self.ids[:5]) + ", .." * (len(self.ids) > 5)
        return f"Tracker(step {self.step}, {len(self.ids)} targets{named})"

    def _begin(self, target: Hashable, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.ids = (*self.ids, target)
        self.mean = np.concatenate([self.mean, mean[None]])
        self.covariance = np.concatenate([self.covariance, covariance[None]])
        self.unseen_s = np.append(self.unseen_s, 0.0)
        self._known_input = np.concatenate([self._known_input, np.zeros((1, self._known_input.shape[1]))])

    def _jumped(self, tracked: Sequence[Hashable], accepted: np.ndarray) -> tuple[Hashable, ...]:
        """Count rejections in a row; returns the targets that reach `RESTART_AFTER`."""
        for target, good in zip(tracked, accepted, strict=True):
            if good:
                self._in_a_row.pop(target, None)
            else:
                self._in_a_row[target] += 1
        jumped = tuple(target for target in tracked if self._in_a_row[target] >= RESTART_AFTER)
        for target in jumped:
            del self._in_a_row[target]
        return jumped

    def _keep(self, which: np.ndarray) -> tuple[Hashable, ...]:
        """Keep the targets of these rows (a mask); returns the others."""
        dropped = tuple(compress(self.ids, ~which))
        self.ids = tuple(compress(self.ids, which))
        self.mean, self.covariance, self.unseen_s = self.mean[which], self.covariance[which], self.unseen_s[which]
        for target in dropped:
            self._in_a_row.pop(target, None)
        return dropped

    def _noise(self, pose: np.ndarray, points_world: np.ndarray) -> Float[np.ndarray, "k n_z n_z"]:
        """V in the world for targets at these positions, of the step that was predicted last."""
        V = self._V[max(0, self.step - 1) % len(self._V)]
        return kalman.measurement_noise(self._sensor, V, pose, points_world)

    def _one_point(self, pose: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance from one measurement, with the noise at the place that it measured."""
        position = self._Z @ (np.linalg.pinv(self._H) @ z)
        (V,) = self._noise(pose, position[None])
        return kalman.one_point(self._first, z, self._H, V)

    def _correct(self, pose: np.ndarray, rows: list[int], measured: list[np.ndarray]) -> np.ndarray:
        """Update the targets of these rows by what was measured of them; returns which measurements were accepted."""
        z, mean = np.reshape(measured, (len(rows), len(self._H))), self.mean[rows]
        V = self._noise(pose, mean @ self._Z.T)
        mean, covariance, accepted = kalman.update(mean, self.covariance[rows], z, self._H, V, self._limit)
        self.mean[rows], self.covariance[rows] = mean, covariance
        self.unseen_s[np.array(rows, int)[accepted]] = 0.0
        return accepted


def _array(x: Any) -> np.ndarray:
    return np.asarray(x, float)


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{name} = {array.tolist()}: expected {shape} finite numbers")
    return array
