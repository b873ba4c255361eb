"""Tracker for a robot without one: targets appear, are updated by id, age, and are dropped."""

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

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
    """Outcome of an update, by target id.

    `updated` beliefs were corrected by a detection; `appeared` ones begin with it: new ids, and targets that have
    jumped; `rejected` detections failed the gate, or are not finite.
    """

    updated: tuple[Hashable, ...]
    appeared: tuple[Hashable, ...]
    rejected: tuple[Hashable, ...]


class Tracker:
    """One Kalman filter per target, with the motion and the sensor of a scenario; means and covariances in the world.

    Each step of tau seconds: `predict`, decide on `inputs` or `observation`, move, detect, `update`. A detection with a
    new id begins a belief: N(z, V) in measured directions, the scenario's prior about 0 in the others (one-point
    initiation). A target without an update for more than `forget_after_s` seconds is dropped. With
    `sensor.missed_detections = "used"`, a target without a detection is believed to be outside the view.

    A detection is rejected if its squared Mahalanobis distance to the prediction is above the quantile `gate` of the
    chi-square distribution (Bar-Shalom, Li & Kirubarajan 2001, section 5.4): 0.9999 rejects one correct detection in
    ten thousand. One that is not finite is rejected too. `rejected` counts them by id. A target that has jumped is
    rejected four times in a row, and begins again with the fifth detection. With `gate` None all finite ones pass.
    """

    def __init__(self, problem: Problem | Scenario, *, forget_after_s: float = 10.0, gate: float | None = GATE) -> None:
        if not forget_after_s > 0:
            raise InputError(f"forget_after_s = {forget_after_s}: expected > 0")
        self._problem = problem = problem.problem() if isinstance(problem, Scenario) else problem
        period, self._sensor, self._forget_after_s = problem.period, problem.sensor, forget_after_s
        matrices = (period.tau, period.V, period.motion.A, period.motion.B, period.motion.W)
        self._tau, self._V, self._A, self._B, self._W = (np.asarray(x, float) for x in matrices)
        self._H, self._Z = np.asarray(problem.sensor.H, float), np.asarray(problem.motion.Z, float)
        self._prior = np.linalg.inv(np.asarray(problem.prior_information, float))
        self._limit = gate_limit(gate, len(self._H)) or np.inf
        self._rejected_in_a_row: Counter[Hashable] = Counter()
        self.step = 0
        self.ids: tuple[Hashable, ...] = ()
        self.rejected: Counter[Hashable] = Counter()
        self.mean: Float[np.ndarray, "n n_y"] = np.zeros((0, len(self._prior)))
        self.covariance: Float[np.ndarray, "n n_y n_y"] = np.zeros((0, *self._prior.shape))
        self.unseen_s: Float[np.ndarray, " n"] = np.zeros(0)
        self._known_input = np.zeros((0, self._B.shape[2]))

    def add(self, target: Hashable, position_world: ArrayLike, covariance: ArrayLike | None = None) -> None:
        """Begin a belief about a target before any detection of it.

        Raises InputError if the id is tracked already, a shape is wrong, or the covariance is not positive definite.

        Args:
            target: Its id, not tracked yet.
            position_world: Expected position (d,) [m]; the rest of the state begins at 0.
            covariance: Of its state (n_y, n_y); by default the scenario's prior.
        """
        if target in self.ids:
            raise InputError(f"target {target!r}: is tracked already")
        position = _checked(f"position of target {target!r}", position_world, (len(self._Z),))
        P = self._prior if covariance is None else _checked("covariance", covariance, self._prior.shape)
        if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max() or np.linalg.eigvalsh(P)[0] <= 0:
            raise InputError(f"covariance = {P.tolist()}: expected a symmetric, positive definite matrix")
        self._begin(target, np.linalg.pinv(self._Z) @ position, P)

    def predict(self, known_inputs: Mapping[Hashable, ArrayLike] | None = None) -> tuple[Hashable, ...]:
        """Predict all beliefs one step ahead; drop the targets without an update for too long, and return their ids.

        `known_inputs` are xi (m_y,) by id, 0 by default. Raises InputError for one of another length, or not finite.
        """
        k, inputs, zero = self.step % len(self._tau), known_inputs or {}, np.zeros(self._B.shape[2])
        xi = [_checked(f"known input of target {name!r}", inputs.get(name, zero), zero.shape) for name in self.ids]
        self._known_input = np.reshape(xi, (len(self.ids), len(zero)))
        self.unseen_s = self.unseen_s + self._tau[k]
        # An age is a sum of many tau: rounding must not drop a target early.
        dropped = self._keep(self.unseen_s <= self._forget_after_s * (1 + 1e-9))
        motion = self._A[k], self._B[k], self._W[k]
        self.mean, self.covariance = kalman.predict(self.mean, self.covariance, self._known_input, *motion)
        self.step += 1
        return dropped

    def update(self, pose: ArrayLike, detections: Mapping[Hashable, ArrayLike]) -> Seen:
        """Correct the beliefs by detections; begin those of new ids.

        Raises InputError, without any change, if the pose or a detection has another shape, or the pose is not finite.

        Args:
            pose: The agent's pose when it measured: `[x, y, yaw]` in m and rad, or in space 4 x 4, body to world.
            detections: Measurements z = H y (n_z,) in the world frame, by id.
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
        # One rejected detection is an outlier; after several in a row the old belief would reject the truth for ever.
        jumped = self._jumped(tracked, accepted)
        for target in jumped:
            i = row_of[target]
            self.mean[i], self.covariance[i] = self._one_point(pose, measured[target])
            self.unseen_s[i] = 0.0
        new = tuple(target for target in finite if target not in row_of)
        for target in new:
            self._begin(target, *self._one_point(pose, measured[target]))
        used = {*updated, *jumped, *new}
        rejected = tuple(target for target in measured if target not in used)
        self.rejected.update(rejected)
        if self._sensor.uses_missed_detections:
            for i in (row for target, row in row_of.items() if target not in measured):
                belief = self.mean[i], self.covariance[i]
                belief = kalman.condition_on_missed_detection(*belief, self._Z, self._sensor.view, pose)
                self.mean[i], self.covariance[i] = belief
        return Seen(updated=updated, appeared=(*jumped, *new), rejected=rejected)

    def belief(self) -> Belief:
        """All beliefs at the current step; after `predict`, the input of a policy."""
        return Belief(self.mean, covariance=self.covariance, known_input=self._known_input)

    def inputs(self, pose: ArrayLike, steps_left: int, pad_to: int = 0) -> dict[str, np.ndarray]:
        """Inputs of an exported policy by name, for one decision, padded to at least `pad_to` targets.

        Some policies read only some of them. A robot without an end gives the `steps_left` of the middle of a training
        episode every time: with many more a policy may postpone everything for ever.
        """
        observation, names = self.observation(pose, steps_left, pad_to), ("pose", "mean", "information", "known_input")
        inputs = {name: np.asarray(getattr(observation, name), np.float32)[None] for name in names}
        return {**inputs, "present": np.asarray(observation.present)[None], "steps_left": np.array([steps_left])}

    def observation(self, pose: ArrayLike, steps_left: int, pad_to: int = 0) -> Observation:
        """Observation of a policy in JAX, padded to at least `pad_to` targets: one compilation while these suffice."""
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
        """Count rejections in a row; return the targets that reach `RESTART_AFTER`."""
        counts = self._rejected_in_a_row
        counts.update(compress(tracked, ~accepted))
        jumped = tuple(target for target in tracked if counts[target] >= RESTART_AFTER)
        for target in (*compress(tracked, accepted), *jumped):
            counts.pop(target, None)
        return jumped

    def _keep(self, which: np.ndarray) -> tuple[Hashable, ...]:
        """Keep the targets of these rows (a mask); return the others."""
        dropped = tuple(compress(self.ids, ~which))
        self.ids = tuple(compress(self.ids, which))
        self.mean, self.covariance, self.unseen_s = self.mean[which], self.covariance[which], self.unseen_s[which]
        self._known_input = self._known_input[which]
        for target in dropped:
            self._rejected_in_a_row.pop(target, None)
        return dropped

    def _noise(self, pose: np.ndarray, points_world: np.ndarray) -> Float[np.ndarray, "k n_z n_z"]:
        """V in the world frame for targets at these positions, of the step that was predicted last."""
        V = self._V[max(0, self.step - 1) % len(self._V)]
        return kalman.measurement_noise(self._sensor, V, pose, points_world)

    def _one_point(self, pose: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance from one measurement, with the noise at the measured position."""
        position = self._Z @ (np.linalg.pinv(self._H) @ z)
        (V,) = self._noise(pose, position[None])
        return kalman.one_point(self._prior, z, self._H, V)

    def _correct(self, pose: np.ndarray, rows: list[int], measured: list[np.ndarray]) -> np.ndarray:
        """Update the targets of these rows by their measurements; return a mask of those accepted."""
        z, mean = np.reshape(measured, (len(rows), len(self._H))), self.mean[rows]
        V = self._noise(pose, mean @ self._Z.T)
        mean, covariance, accepted = kalman.update(mean, self.covariance[rows], z, self._H, V, self._limit)
        self.mean[rows], self.covariance[rows] = mean, covariance
        self.unseen_s[np.array(rows, int)[accepted]] = 0.0
        return accepted


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{name} = {array.tolist()}: expected {shape} finite numbers")
    return array
