"""Beliefs of a tracker: one Kalman filter per target, without a clock."""

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import compress, islice
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from foveate.deploy import kalman, kalman_polar
from foveate.deploy.belief import are_usable, numbers
from foveate.deploy.motion import Matrices
from foveate.errors import InputError
from foveate.models.gate import RESTART_AFTER, gate_limit
from foveate.models.problem import Problem
from foveate.scenario.rows import MAX_LENGTH
from foveate.scenario.scenario import Scenario

MAX_COUNTED = 10_000
"""Most ids whose rejections are counted."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Outcome of an update, by target id.

    `updated` beliefs were corrected by a detection; `appeared` ones begin with it: new ids, and targets that have
    jumped; `rejected` detections failed the gate, are too late, not finite, or beyond 1e9 m, or are bearings or ranges
    of which a wide belief near the sensor can make nothing (docs/sensors.md).
    """

    updated: tuple[Hashable, ...]
    appeared: tuple[Hashable, ...]
    rejected: tuple[Hashable, ...]


class Tracks:
    """Means and covariances of targets by id, their ages, and what the gate has rejected.

    `time_s` is the time of the beliefs [s], `step` the number of predictions.
    """

    def __init__(self, problem: Problem | Scenario, forget_after_s: float, gate: float | None) -> None:
        self._problem = problem = (problem.problem() if isinstance(problem, Scenario) else problem).of_one_kind()
        period, self._sensor, self._forget_after_s = problem.period, problem.sensor, forget_after_s
        matrices = (period.tau, period.V, period.motion.A, period.motion.B, period.motion.W)
        self._tau, self._V, self._A, self._B, self._W = (np.asarray(x, float) for x in matrices)
        self._H, self._Z = np.asarray(problem.sensor.H, float), np.asarray(problem.motion.Z, float)
        self._prior = np.linalg.inv(np.asarray(problem.prior_information, float))
        polar, size = problem.sensor.polar, problem.sensor.size
        self._form = (
            f"{(size,)}" if polar is None else f"{(size,)}: {', '.join(polar.coordinates)} in the robot's frame"
        )
        self._limit = gate_limit(gate, self._sensor.size) or np.inf
        self._rejected_in_a_row: Counter[Hashable] = Counter()
        self._last_pose, self._missed_before = np.zeros(0), frozenset[Hashable]()
        self.step, self.time_s = 0, 0.0
        self.ids: tuple[Hashable, ...] = ()
        self.rejected: Counter[Hashable] = Counter()
        self.mean: Float[np.ndarray, "n n_y"] = np.zeros((0, len(self._prior)))
        self.covariance: Float[np.ndarray, "n n_y n_y"] = np.zeros((0, *self._prior.shape))
        self.unseen_s: Float[np.ndarray, " n"] = np.zeros(0)
        self._known_input = np.zeros((0, self._B.shape[2]))

    def _state(self) -> dict[str, Any]:
        """Copy of all that changes."""
        names = ("ids", "mean", "covariance", "unseen_s", "_known_input", "_rejected_in_a_row", "rejected")
        rest = ("_last_pose", "_missed_before", "step", "time_s")  # replaced, never changed in place
        return {name: copy(getattr(self, name)) for name in names} | {name: getattr(self, name) for name in rest}

    def _restore(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)

    def _advance(self, dt_s: float, xi: Mapping[Hashable, np.ndarray], motion: Matrices) -> tuple[Hashable, ...]:
        """Predict all beliefs over `dt_s`; drop targets that are too old or too vague, and return their ids."""
        zero = np.zeros(self._known_input.shape[1])
        self._known_input = np.reshape([xi.get(name, zero) for name in self.ids], (len(self.ids), len(zero)))
        self.unseen_s = self.unseen_s + dt_s
        # An age is a sum of many tau: rounding must not drop a target early.
        dropped = self._keep(self.unseen_s <= self._forget_after_s * (1 + 1e-9))
        A, B, W = motion
        self.mean, self.covariance = kalman.predict(self.mean, self.covariance, self._known_input, A, B, W)
        return (*dropped, *self._keep(are_usable(self.mean, self.covariance)))

    def _measured(self, detections: Mapping[Hashable, ArrayLike]) -> dict[Hashable, np.ndarray]:
        """Checked detections."""
        if not isinstance(detections, Mapping):
            raise InputError(
                f"detections: a {type(detections).__name__}: expected positions by target id, {{id: [x, y]}}; for "
                "detections without ids use foveate.DetectionTracker, or a data associator first (Stone Soup has some)"
            )
        measured = {target: numbers(f"detection of {target!r}", z) for target, z in detections.items()}
        for target, z in measured.items():
            check_id(target)
            if z.shape != (self._sensor.size,):
                raise InputError(f"detection of {target!r} has shape {z.shape}: expected {self._form}")
        return measured

    def _look(
        self, pose: np.ndarray, measured: Mapping[Hashable, np.ndarray], V: Float[np.ndarray, "n_z n_z"] | None
    ) -> Seen:
        """Correct the beliefs by detections, with noise V or the sensor's own; begin those of new ids."""
        V = self._own_V if V is None else V
        finite = [target for target, z in measured.items() if (np.abs(z) <= MAX_LENGTH).all()]
        row_of = {target: i for i, target in enumerate(self.ids)}
        tracked = [target for target in finite if target in row_of]
        accepted, unusable = self._correct(
            pose, [row_of[target] for target in tracked], [measured[target] for target in tracked], V
        )
        updated = tuple(compress(tracked, accepted))
        # One rejected detection is an outlier; after several in a row the old belief would reject the truth for ever.
        jumped = self._jumped(tracked, accepted | unusable)
        new = tuple(target for target in finite if target not in row_of)
        if jumped or new:
            mean, covariance = self._one_point(pose, [measured[target] for target in (*jumped, *new)], V)
            again = [row_of[target] for target in jumped]
            self.mean[again], self.covariance[again] = mean[: len(again)], covariance[: len(again)]
            self.unseen_s[again] = 0.0
            self._begin(new, mean[len(again) :], covariance[len(again) :])
        used = {*updated, *jumped, *new}
        rejected = tuple(target for target in measured if target not in used)
        self._count(rejected)
        if self._sensor.uses_missed_detections:
            self._look_in_vain(pose, {target: row for target, row in row_of.items() if target not in measured})
        return Seen(updated=updated, appeared=(*jumped, *new), rejected=rejected)

    def _begin(self, targets: Sequence[Hashable], mean: np.ndarray, covariance: np.ndarray) -> None:
        self.ids = (*self.ids, *targets)
        self.mean = np.concatenate([self.mean, mean])
        self.covariance = np.concatenate([self.covariance, covariance])
        self.unseen_s = np.append(self.unseen_s, np.zeros(len(targets)))
        added = np.zeros((len(targets), self._known_input.shape[1]))
        self._known_input = np.concatenate([self._known_input, added])

    def _count(self, rejected: Sequence[Hashable]) -> None:
        """Count rejections by id; forget those of the ids that were rejected longest ago."""
        for target in rejected:
            self.rejected[target] = self.rejected.pop(target, 0) + 1  # moved to the end
        for target in list(islice(self.rejected, max(0, len(self.rejected) - MAX_COUNTED))):
            del self.rejected[target]

    def _jumped(self, tracked: Sequence[Hashable], accepted: np.ndarray) -> tuple[Hashable, ...]:
        """Count rejections in a row; return the targets that reach `RESTART_AFTER`."""
        counts = self._rejected_in_a_row
        counts.update(compress(tracked, ~accepted))
        jumped = tuple(target for target in tracked if counts[target] >= RESTART_AFTER)
        for target in (*compress(tracked, accepted), *jumped):
            counts.pop(target, None)
        return jumped

    def _look_in_vain(self, pose: np.ndarray, missed: Mapping[Hashable, int]) -> None:
        """Condition the beliefs of missed targets, by row, on what this look showed and the previous one did not."""
        for target, i in missed.items():
            before = self._last_pose if target in self._missed_before else None
            belief = self.mean[i], self.covariance[i]
            self.mean[i], self.covariance[i] = kalman.condition_on_missed_detection(
                *belief, self._Z, self._sensor.view, pose, before
            )
        self._last_pose, self._missed_before = pose, frozenset(missed)

    def _keep(self, which: np.ndarray) -> tuple[Hashable, ...]:
        """Keep the targets of these rows (a mask); return the others."""
        dropped = tuple(compress(self.ids, ~which))
        self.ids = tuple(compress(self.ids, which))
        self.mean, self.covariance, self.unseen_s = self.mean[which], self.covariance[which], self.unseen_s[which]
        self._known_input = self._known_input[which]
        for target in dropped:
            self._rejected_in_a_row.pop(target, None)
        return dropped

    @property
    def _own_V(self) -> Float[np.ndarray, "n_z n_z"]:
        """V at a range of 0, of the step that was predicted last."""
        return self._V[max(0, self.step - 1) % len(self._V)]

    def _one_point(
        self, pose: np.ndarray, measured: list[np.ndarray], V: Float[np.ndarray, "n_z n_z"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Means and covariances from one measurement each, with the noise at the measured positions."""
        z = np.reshape(measured, (len(measured), self._sensor.size))
        if self._sensor.polar is not None:
            frame = kalman_polar.frame_of(pose, self._Z)
            return kalman_polar.one_point(self._sensor, self._prior, z, V, frame)
        noise = kalman.measurement_noise(self._sensor, V, pose, z @ np.linalg.pinv(self._H).T @ self._Z.T)
        return kalman.one_point(self._prior, z, self._H, noise)

    def _correct(
        self, pose: np.ndarray, rows: list[int], measured: list[np.ndarray], V: Float[np.ndarray, "n_z n_z"]
    ) -> kalman_polar.Masks:
        """Update the targets of these rows by their measurements; return masks of those accepted, and of no use."""
        z, mean = np.reshape(measured, (len(rows), self._sensor.size)), self.mean[rows]
        covariance, polar = self.covariance[rows], self._sensor.polar
        if polar is None:
            noise = kalman.measurement_noise(self._sensor, V, pose, mean @ self._Z.T)
            mean, covariance, accepted = kalman.update(mean, covariance, z, self._H, noise, self._limit)
            unusable = np.zeros_like(accepted)
        else:
            frame = kalman_polar.frame_of(pose, self._Z)
            corrected = kalman_polar.update(polar, mean, covariance, z, V, frame, self._limit)
            mean, covariance, (accepted, unusable) = corrected
        self.mean[rows], self.covariance[rows] = mean, covariance
        self.unseen_s[np.array(rows, int)[accepted | unusable]] = 0.0
        return accepted, unusable


def checked(name: str, value: ArrayLike, shape: tuple[int, ...], most: float = MAX_LENGTH) -> np.ndarray:
    """An array of finite numbers of this shape. Raises InputError for another."""
    array = numbers(name, value)
    if array.shape != shape or not (np.abs(array) <= most).all():
        raise InputError(f"{name} = {array.tolist()}: expected {shape} finite numbers up to {most:g}")
    return array


def check_id(target: Hashable) -> None:
    """Raise InputError for an id that is not found again."""
    if target != target:
        raise InputError(f"id {target!r}: expected one that equals itself, so that it is found again")
