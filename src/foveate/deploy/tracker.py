"""Beliefs for a robot that has no tracker of its own: targets appear, are updated by id, age, and are dropped.

In numpy and float64: what changes from step to step is how many targets there are, for which JAX would compile anew.
"""

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from foveate.deploy.belief import Belief, observation
from foveate.errors import InputError
from foveate.geometry.fov import FieldOfView
from foveate.geometry.numpy_poses import positions, rotation
from foveate.models import belief
from foveate.models.gate import RESTART_AFTER, gate_limit
from foveate.models.missed_detection import given_missed_detection
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Observation


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What an update made of the detections, by id: `rejected` are those that the gate kept out.

    `appeared` are new ones, and those that have jumped and begin anew.
    """

    updated: tuple[Hashable, ...]
    appeared: tuple[Hashable, ...]
    rejected: tuple[Hashable, ...]


class Tracker:
    """One Kalman filter a target, with the motion and the sensor of a scenario; means and covariances in the world.

    Each step of tau seconds: `predict`, decide on `inputs` or `observation`, move, detect, `update`. A detection with a
    new id begins a belief: N(z, V) in what is measured, the scenario's first belief, about 0, in the rest (one-point
    initiation). A target that no detection has updated for more than `forget_after_s` seconds is dropped.

    A detection is rejected where its squared Mahalanobis distance to the prediction is above the quantile `gate` of the
    chi-square distribution (Bar-Shalom, Li & Kirubarajan 2001, section 5.4): 0.9999 rejects one honest detection in
    ten thousand. One that is not finite is rejected too. `rejected` counts them by id. A target that has really jumped is
    rejected four times in a row, and begins anew with the fifth detection. `gate` None takes whatever comes.

    Where the scenario says `sensor.missed_detections = "used"`, a target without a detection is believed to be outside of the
    view from there on.
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
        limit = gate_limit(gate, len(self._H))
        self._limit = np.inf if limit is None else limit
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
        """Begin a belief about a target that was not seen yet: at a position [m], as unsure as the scenario's first.

        Raises ValueError for an id that is there and a position or covariance (n_y, n_y) of another shape.
        """
        if target in self.ids:
            raise InputError(f"target {target!r}: is tracked already")
        position = _checked(f"position of target {target!r}", position_world, (len(self._Z),))
        P = self._first if covariance is None else _checked("covariance", covariance, self._first.shape)
        if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max() or np.linalg.eigvalsh(P)[0] <= 0:
            raise InputError(f"covariance = {P.tolist()}: expected a symmetric, positive definite matrix")
        self._begin(target, np.linalg.pinv(self._Z) @ position, P)

    def predict(self, known_inputs: Mapping[Hashable, ArrayLike] | None = None) -> tuple[Hashable, ...]:
        """All beliefs one step ahead: A mu + B xi, A P A^T + W; gives the ids that are too old and were dropped.

        `known_inputs` are xi by id, 0 for a target that is not named. Raises ValueError where one has another length.
        """
        k = self.step % len(self._tau)
        A, B, W = self._A[k], self._B[k], self._W[k]
        given, none = known_inputs or {}, np.zeros(B.shape[1])
        pushes = {t: _checked(f"known input of target {t!r}", given.get(t, none), none.shape) for t in self.ids}
        self.unseen_s = self.unseen_s + self._tau[k]
        # An age is a sum of many tau: rounding must not make it older than it is.
        dropped = self._keep(self.unseen_s <= self._forget_after_s * (1 + 1e-9))
        self._known_input = np.array([pushes[t] for t in self.ids]).reshape(len(self.ids), len(none))
        self.mean = self.mean @ A.T + self._known_input @ B.T
        self.covariance = A @ self.covariance @ A.T + W
        self.step += 1
        return dropped

    def update(self, pose: ArrayLike, detections: Mapping[Hashable, ArrayLike]) -> Seen:
        """Correct by measurements z = H y in the world frame, by id, taken at this pose; unknown ids begin.

        The pose is [x, y, yaw], or in space 4 x 4, body to world. Raises ValueError for a pose that is another or not
        finite, and for a measurement of another length.
        """
        pose = _checked("pose", pose, (3,) if len(self._Z) == 2 else (4, 4))
        z_of = {target: np.asarray(z, float) for target, z in detections.items()}
        for target, z in z_of.items():
            if z.shape != (len(self._H),):
                raise InputError(f"detection of {target!r} has shape {z.shape}: expected {(len(self._H),)}")
        finite = [target for target, z in z_of.items() if np.isfinite(z).all()]
        place = {target: i for i, target in enumerate(self.ids)}
        known = [target for target in finite if target in place]
        taken = self._correct(
            pose,
            [place[target] for target in known],
            np.array([z_of[target] for target in known]).reshape(-1, len(self._H)),
        )
        updated = tuple(target for target, good in zip(known, taken, strict=True) if good)
        jumped = self._jumped(known, taken)
        for target in jumped:
            i = place[target]
            self.mean[i], self.covariance[i] = self._one_point(pose, z_of[target])
            self.unseen_s[i] = 0.0
        new = tuple(target for target in finite if target not in place)
        for target in new:
            self._begin(target, *self._one_point(pose, z_of[target]))
        appeared = (*jumped, *new)
        taken_in = {*updated, *appeared}
        rejected = tuple(target for target in z_of if target not in taken_in)
        self.rejected.update(rejected)
        if self._sensor.uses_missed_detections:
            self._look_in_vain(pose, [place[target] for target in place if target not in z_of])
        return Seen(updated=updated, appeared=appeared, rejected=rejected)

    def belief(self) -> Belief:
        """All beliefs as they are now: after `predict`, what a policy decides on."""
        return Belief(self.mean, covariance=self.covariance, known_input=self._known_input)

    def inputs(self, pose: ArrayLike, steps_left: int, pad_to: int = 0) -> dict[str, np.ndarray]:
        """What an exported policy asks for, and more, by name: one decision, padded to `pad_to` targets at least.

        A robot that goes on and on has as many `steps_left` at each step as there were in the middle of a training
        episode: with many more than that a policy may put off everything for ever.
        """
        now = self.observation(pose, steps_left, pad_to)
        arrays = {name: getattr(now, name) for name in ("pose", "mean", "information", "known_input")}
        return {name: np.asarray(array, np.float32)[None] for name, array in arrays.items()} | {
            "present": np.asarray(now.present)[None],
            "steps_left": np.array([steps_left]),
        }

    def observation(self, pose: ArrayLike, steps_left: int, pad_to: int = 0) -> Observation:
        """The same for a policy in JAX; with one `pad_to` it is compiled once for that many targets."""
        step = max(0, self.step - 1)
        return observation(self.belief(), self._problem, np.asarray(pose, float), steps_left, pad_to, step)

    def __repr__(self) -> str:
        named = "".join(f", {target!r}" for target in self.ids[:5]) + ", .." * (len(self.ids) > 5)
        return f"Tracker(step {self.step}, {len(self.ids)} targets{named})"

    def _look_in_vain(self, pose: np.ndarray, places: list[int]) -> None:
        """The targets at these places were not in view from this pose."""
        here = rotation(pose), positions(pose)
        for i in places:
            left = _unseen(
                self._sensor.view, *map(_traced, (self._Z, *here, self.mean[i], np.linalg.inv(self.covariance[i])))
            )
            self.mean[i], self.covariance[i] = left.mean, np.linalg.inv(left.information)

    def _begin(self, target: Hashable, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.ids = (*self.ids, target)
        self.mean = np.concatenate([self.mean, mean[None]])
        self.covariance = np.concatenate([self.covariance, covariance[None]])
        self.unseen_s = np.append(self.unseen_s, 0.0)
        self._known_input = np.concatenate([self._known_input, np.zeros((1, self._known_input.shape[1]))])

    def _jumped(self, known: Sequence[Hashable], taken: np.ndarray) -> tuple[Hashable, ...]:
        """Count rejections in a row; gives whom there have been enough of."""
        for target, good in zip(known, taken, strict=True):
            if good:
                self._in_a_row.pop(target, None)
            else:
                self._in_a_row[target] += 1
        jumped = tuple(target for target in known if self._in_a_row[target] >= RESTART_AFTER)
        for target in jumped:
            del self._in_a_row[target]
        return jumped

    def _keep(self, which: np.ndarray) -> tuple[Hashable, ...]:
        dropped = tuple(target for target, kept in zip(self.ids, which, strict=True) if not kept)
        self.ids = tuple(target for target, kept in zip(self.ids, which, strict=True) if kept)
        self.mean, self.covariance, self.unseen_s = self.mean[which], self.covariance[which], self.unseen_s[which]
        for target in dropped:
            self._in_a_row.pop(target, None)
        return dropped

    def _noise(self, pose: np.ndarray, points_world: np.ndarray) -> Float[np.ndarray, "k n_z n_z"]:
        """V in the world for targets at these positions, as `Sensor.covariance`."""
        V = self._V[max(0, self.step - 1) % len(self._V)]
        if self._sensor.frame == "body":
            V = rotation(pose) @ V @ rotation(pose).T
        away = np.linalg.norm(points_world - positions(pose), axis=-1)
        return V * (1.0 + self._sensor.range_growth * away[:, None, None]) ** 2

    def _one_point(self, pose: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance from one measurement: H^+ z, H^+ V H^+T + N P_0 N^T with N = I - H^+ H."""
        back = np.linalg.pinv(self._H)
        mean, rest = back @ z, np.eye(len(back)) - back @ self._H
        (V,) = self._noise(pose, (self._Z @ mean)[None])
        return mean, back @ V @ back.T + rest @ self._first @ rest.T

    def _correct(self, pose: np.ndarray, places: list[int], z: np.ndarray) -> np.ndarray:
        """Kalman's update, Joseph's form, of the targets at these places whose z passes the gate; says which did."""
        rows, H = np.array(places, int), self._H
        p, P = self.mean[rows], self.covariance[rows]
        V = self._noise(pose, p @ self._Z.T)
        S, innovation = H @ P @ H.T + V, z - p @ H.T
        taken = np.einsum("ki,ki->k", innovation, np.linalg.solve(S, innovation[..., None])[..., 0]) <= self._limit
        K = np.linalg.solve(S, H @ P).swapaxes(-1, -2)
        rest = np.eye(p.shape[1]) - K @ H
        mean = p + np.einsum("kij,kj->ki", K, innovation)
        covariance = rest @ P @ rest.swapaxes(-1, -2) + K @ V @ K.swapaxes(-1, -2)
        here = rows[taken]
        self.mean[here], self.covariance[here], self.unseen_s[here] = mean[taken], covariance[taken], 0.0
        return taken


@eqx.filter_jit
def _unseen(view: FieldOfView, Z: Array, R: Array, t: Array, mean: Array, information: Array) -> belief.Belief:
    """One belief, one program for any number of targets."""
    return given_missed_detection(belief.Belief(mean, information), Z, lambda points: view.contains((points - t) @ R))


def _traced(x: np.ndarray) -> Array:
    return jnp.asarray(x, float)


def _array(x: Any) -> np.ndarray:
    return np.asarray(x, float)


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{name} = {array.tolist()}: expected {shape} finite numbers")
    return array
