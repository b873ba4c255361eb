"""Tracker of targets unknown in number, from detections that do not say of which target they are."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from foveate.deploy.belief import Belief, are_usable, numbers
from foveate.deploy.motion import motion_over
from foveate.deploy.observing import Observing
from foveate.deploy.pose import QuaternionOrder, checked_pose
from foveate.deploy.tracker import MAX_TIME_S
from foveate.deploy.tracks import checked
from foveate.errors import InputError
from foveate.models.detections import filter as pmb
from foveate.models.detections.expectation import confirmed
from foveate.models.detections.records import DetectionModel, Population, Scan
from foveate.models.problem import Problem
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.rows import MAX_LENGTH
from foveate.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Scanned:
    """Outcome of a scan, by the ids of tracks.

    `confirmed` are reported from now on, as they exist and are located well enough; `lost` are no longer. A lost track
    that is confirmed again keeps its id, unless it was forgotten in between. `rejected` counts detections that
    are not finite or beyond 1e9 m.
    """

    confirmed: tuple[int, ...]
    lost: tuple[int, ...]
    rejected: int


class DetectionTracker(Observing):
    """Poisson multi-Bernoulli filter for a robot, with the motion and the sensor of a scenario.

    Each step: `predict`, decide on `belief`, `inputs` or `observation`, move, detect, `update`. Detections are a plain
    list in any order: which is of which target, which is a false alarm, and how many targets there are, the tracker
    finds out. Ids of tracks are its own. It reports the tracks that are likely to exist and well located, by the
    settings' `confirm` and `cutoff_m`. A track that is not detected where it should be becomes less likely, and ends;
    one that nobody looks at becomes uncertain, and is not reported until it is detected again.

    Where false alarms are expected, a detection beyond the scenario's view counts as one: set the view at least as wide
    as the detector's.

    `undetected` (cells) is the expected number of targets never detected in each cell of the settings' box. Numbers are
    float32, so that the world's origin should be near the robot's working area. The first `predict` and the first
    `update` compile, for a few seconds; no later one does.

    Args:
        scenario: Motion of the targets, sensor and view.
        detections: Probability of detection, false alarms, births, the box of the grid, capacities.

    Raises:
        InputError: The settings do not fit the scenario.
    """

    def __init__(self, scenario: Problem | Scenario, detections: DetectionSettings) -> None:
        problem = scenario.problem() if isinstance(scenario, Scenario) else scenario
        self._problem, self._model = problem, detections.model(problem)
        self._over, self._step_s = motion_over(scenario), None
        nowhere = problem.agent.space.identity()
        self._population = pmb.start(problem, self._model, nowhere)
        self._reported: tuple[int, ...] = ()
        self.step, self.rejected = 0, 0

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids of the tracks that are reported."""
        return tuple(self._of_reported(self._population.tracks.identity).tolist())

    @property
    def mean(self) -> Float[np.ndarray, "n n_y"]:
        """Means of their states in the world, a row per id."""
        return self._of_reported(self._population.tracks.mean).astype(float)

    @property
    def covariance(self) -> Float[np.ndarray, "n n_y n_y"]:
        """Covariances of their states."""
        return self._of_reported(self._population.tracks.covariance).astype(float)

    @property
    def existence(self) -> Float[np.ndarray, " n"]:
        """Their probabilities of existence."""
        return self._of_reported(self._population.tracks.existence).astype(float)

    @property
    def undetected(self) -> Float[np.ndarray, "*cells"]:
        """Expected number of targets never detected, per cell."""
        return np.asarray(self._population.undetected, float)

    @property
    def expected_number(self) -> float:
        """Expected number of targets, in tracks and never detected."""
        return float(self._population.expected_number)

    @property
    def overflow(self) -> int:
        """Number of tracks dropped so far for want of room (`tracks` of the settings)."""
        return int(self._population.overflow)

    def add(self, position_world: ArrayLike, covariance: ArrayLike | None = None, existence: float = 1.0) -> int:
        """Begin a track before any detection of its target; return its id.

        It is in `belief()` at once, and is reported as soon as it is located to about `cutoff_m`.

        Args:
            position_world: Expected position (d,) [m]; the rest of the state begins at 0.
            covariance: Of its state (n_y, n_y); by default the scenario's prior.
            existence: Probability that the target is there.

        Raises:
            InputError: A shape or a number is wrong, or all slots are taken.
        """
        motion, tracks = self._problem.motion, self._population.tracks
        position = checked("position", position_world, (motion.dimension,))
        if not 0 < existence <= 1:
            raise InputError(f"existence = {existence}: expected a probability above 0, up to 1")
        prior = np.linalg.inv(np.asarray(self._problem.prior_information, float))
        P = prior if covariance is None else checked("covariance", covariance, prior.shape, MAX_LENGTH**2)
        mean = np.linalg.pinv(np.asarray(motion.Z, float)) @ position
        if not are_usable(mean[None], P[None])[0]:
            raise InputError(f"covariance = {P.tolist()}: expected a symmetric, positive definite matrix")
        free = np.flatnonzero(np.asarray(tracks.existence) == 0)
        if not len(free):
            raise InputError(f"tracks = {self._model.tracks}: all are taken: expected more in the settings")
        slot, name = int(free[0]), int(self._population.born)
        dtype = tracks.mean.dtype
        tracks = replace(
            tracks,
            existence=tracks.existence.at[slot].set(existence),
            mean=tracks.mean.at[slot].set(jnp.asarray(mean, dtype)),
            covariance=tracks.covariance.at[slot].set(jnp.asarray(P, dtype)),
            identity=tracks.identity.at[slot].set(name),
        )
        self._population = replace(self._population, tracks=tracks, born=self._population.born + 1)
        self._reported += (name,) * (name in self.ids)
        return name

    def predict(self, dt_s: float | None = None) -> None:
        """Predict one step ahead, of `dt_s` seconds, by default the scenario's tau.

        Survival and births are those of a step of tau, and scale with its length. Raises InputError for a length that
        is no positive number, or that the targets' motion does not know.
        """
        problem = self._problem.at(jnp.asarray(self.step))
        tau_s = float(problem.tau)
        length_s = tau_s if dt_s is None else dt_s
        if not isinstance(length_s, float | int) or not 0 < length_s <= MAX_TIME_S:
            raise InputError(f"dt_s = {dt_s!r}: expected seconds > 0, at most {MAX_TIME_S:g}")
        motion, share = problem.motion, length_s / tau_s
        if dt_s is not None:
            A, B, W = (jnp.asarray(part, float) for part in self._over(length_s))
            motion = replace(motion, A=A, B=B, W=W)
        self._population = _predict(replace(problem, motion=motion), self._model, self._population, jnp.asarray(share))
        self.step, self._step_s = self.step + 1, length_s

    def update(self, pose: ArrayLike, detections: ArrayLike, *, quaternion: QuaternionOrder = "wxyz") -> Scanned:
        """Correct the tracks by the detections of one scan, which may be none; begin and end tracks.

        Raises InputError, without any change, if the pose or the detections have another shape, for more detections
        than the settings' `detections`, and for detections by id, which `foveate.Tracker` takes.

        Args:
            pose: The agent's pose when it measured, in any form that `RobotPolicy` takes.
            detections: Measurements z = H y (k, n_z) in the world frame, in any order.
            quaternion: Order of a pose's quaternion; ROS has "xyzw".
        """
        problem, n_z = self._problem.at(jnp.asarray(max(0, self.step - 1))), len(self._problem.sensor.H)
        here = checked_pose(pose, problem.motion.dimension, quaternion)
        if isinstance(detections, Mapping):
            raise InputError("detections: a dict: expected a list without ids; foveate.Tracker takes detections by id")
        z = numbers("detections", detections)
        z = z.reshape(0, n_z) if z.size == 0 else z
        if z.ndim != 2 or z.shape[1] != n_z:
            raise InputError(f"detections have shape {z.shape}: expected (k, {n_z}), a row per detection")
        usable = z[(np.abs(z) <= MAX_LENGTH).all(axis=1)]
        if len(usable) > (most := self._model.detections):
            raise InputError(
                f"detections: {len(usable)} in one scan: expected at most {most}, `detections` of the settings"
            )
        padded = np.zeros((most, n_z))
        padded[: len(usable)] = usable
        scan = Scan(jnp.asarray(padded, float), jnp.arange(most) < len(usable))
        self._population = _update(problem, self._model, self._population, jnp.asarray(here, float), scan)
        before, now = self._reported, self.ids
        self._reported, rejected = now, len(z) - len(usable)
        self.rejected += rejected
        confirmed, lost = (tuple(x for x in one if x not in other) for one, other in ((now, before), (before, now)))
        return Scanned(confirmed=confirmed, lost=lost, rejected=rejected)

    def belief(self) -> Belief:
        """Belief about the tracks whose existence is above `confirm`; after `predict`, the input of a policy.

        These include tracks too uncertain to be reported: it is for the policy to decide whether to look for them.
        """
        tracks = self._population.tracks
        exist = np.asarray(tracks.existence) > self._model.confirm
        mean, covariance = (np.asarray(part, float)[exist] for part in (tracks.mean, tracks.covariance))
        covariance = 0.5 * (covariance + covariance.swapaxes(1, 2))
        usable = are_usable(mean, covariance)
        return Belief(mean[usable], covariance=covariance[usable], step_s=self._step_s)

    def _of_reported(self, values: jax.Array) -> np.ndarray:
        return np.asarray(values)[np.asarray(confirmed(self._problem, self._model, self._population.tracks))]

    def __repr__(self) -> str:
        return f"DetectionTracker(step {self.step}, {len(self.ids)} targets of {self.expected_number:.1f} expected)"


@eqx.filter_jit
def _predict(problem: Problem, model: DetectionModel, population: Population, share: jax.Array) -> Population:
    """Predict over a share of the step of tau."""
    scaled = replace(model, survival=model.survival**share, births=model.births * share)
    nothing = jnp.zeros((model.tracks, problem.motion.input_size))
    return pmb.predict(problem, scaled, population, nothing)


@eqx.filter_jit
def _update(problem: Problem, model: DetectionModel, population: Population, pose: jax.Array, scan: Scan) -> Population:
    return pmb.update(problem, model, population, pose, scan)
