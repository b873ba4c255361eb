"""Records of a simulation: episode, observation, policy, trace, protocol, and the state between steps."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.models.detections.records import Population
from foveate.models.robot import Robot, Surroundings
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.simulation.team.records import TeamDraws, TeamTrace, TeamView
from foveate.types import Action, Count, Key, Pose


class Truth(eqx.Module):
    """The true states y_0 .. y_K of the targets, which the agent does not influence.

    `measurement_noise` is standard normal, to be scaled by the sensor's covariance. An `Instant` has those of its step.
    """

    state: Float[Array, "*instants n n_y"]
    measurement_noise: Float[Array, "*K n n_z"]


class Arrivals(eqx.Module):
    """Births and deaths: the targets present at each instant, and the initial mean of a belief that begins then."""

    present: Bool[Array, "*instants n"]
    mean: Float[Array, "*instants n n_y"]


class ScanNoise(eqx.Module):
    """Detections without ids: the targets `alive` at each instant, and the random numbers of each scan.

    A target in view is detected where its uniform number in `detection` is below the probability of detection. False
    alarms are at `clutter_body` [m] where `is_false`. Detections come in the order of the uniform numbers of targets
    and false alarms in `order`.
    """

    alive: Bool[Array, "*instants targets"]
    detection: Float[Array, "*K targets"]
    clutter_body: Float[Array, "*K alarms d"]
    is_false: Bool[Array, "*K alarms"]
    order: Float[Array, "*K candidates"]


class Episode(eqx.Module):
    """Everything that is fixed before the agent's first decision, the same for every method.

    Arrays may be padded: `present` marks the real targets and only the first `horizon` steps count. Without `truth` the
    simulation is the noise-free one of training, which never corrects a mean. Positions are in [m], time derivatives in
    [m/s] and [m/s^2]; `mean` is that of the initial beliefs, in the world frame, `inputs` are the known xi_k.
    `map_number` is that of the episode's map among those of the problem, if it has obstacles. With `scans`, detections
    have no ids: means, `present` and inputs are those of the filter's tracks, the truth those of the targets.
    Of a team, `pose` is that of the first robot, whose noise is that of the truth; `team` has those of the others.
    """

    pose: Pose
    mean: Float[Array, "n n_y"]
    present: Bool[Array, " n"]
    inputs: Float[Array, "K n m_y"]
    horizon: Count
    truth: Truth | None = None
    arrivals: Arrivals | None = None
    map_number: Count | None = None
    scans: ScanNoise | None = None
    team: TeamDraws | None = None


class Observation(eqx.Module):
    """Input of a policy at step k: the pose T_k and the predicted belief p_{k+1}, P_{k+1} of every target.

    `left` is the number of remaining steps, this one included; `known_input` is xi_k, the input that led to the
    prediction. Entries where `present` is false are padding. A robot that keeps a distance keeps off the `blocking`
    entries, None: those present. Pose and means are in the world frame, positions in [m]; `information` is the inverse
    covariance, for positions in [1/m^2]. `team` is what a robot knows of its team, None of a single robot.
    """

    step: Count
    left: Count
    pose: Pose
    mean: Float[Array, "n n_y"]
    information: Float[Array, "n n_y n_y"]
    present: Bool[Array, " n"]
    known_input: Float[Array, "n m_y"]
    robot: Robot | None = None  # what a policy may know about its robot; None for policies that ask for nothing
    surroundings: Surroundings | None = None  # None: those of the robot's map
    existence: Float[Array, " n"] | None = None
    """Probability that a target exists, of each entry; None where that is certain."""
    undetected: Float[Array, "*cells"] | None = None
    """Expected number of targets never detected in each cell of the grid of detections without ids; None with ids."""
    team: TeamView | None = None
    blocking: Bool[Array, " n"] | None = None

    @property
    def map_number(self) -> Count | None:
        """Number of the robot's map; None without obstacles."""
        return None if self.robot is None else self.robot.map_number


class Policy(eqx.Module):
    """A map from observations to actions. `memory` is any pytree that it keeps from one step to the next."""

    def start(self, observation: Observation) -> Any:
        """The memory before the first decision; `observation` is the first one."""
        del observation
        return ()

    def claims(self, observation: Observation, memory: Any) -> Float[Array, " n"]:
        """A number for every target that a robot tells its team after a decision; by default 0, which says nothing."""
        del memory
        return jnp.zeros_like(observation.mean[:, 0])

    @abc.abstractmethod
    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The normalised action in [-1, 1] for every actuated axis, and the memory for the next step."""


class Trace(eqx.Module):
    """Record of one episode; entries after `horizon` steps are padding.

    `log_det` is that of the information matrix after step k [nat]; `visible` marks the targets actually measured.
    `rejections` counts the measurements in a row that the gate has rejected; None without a gate. `contacts` counts the
    steps up to k that an obstacle has ended; None without obstacles. Pose and means are in the world frame, positions
    in [m], `information` in [1/m^2] for positions; `action` is normalised to [-1, 1] on every axis.

    Without ids beliefs are those of tracks, with their `existence`; the `confirmed` are reported. `visible` is of true
    targets, `undetected` the expected number of others, `expected_gospa` in [m], `dropped` what had no room.
    Of a team, pose and action are the first robot's, the beliefs are those of one filter that hears every measurement,
    `visible` marks what any robot has measured, and `contacts` are all robots'; `team` has every robot's own.
    """

    pose: Float[Array, "instants ..."]
    action: Float[Array, "K m"]
    mean: Float[Array, "instants n n_y"]
    information: Float[Array, "instants n n_y n_y"]
    log_det: Float[Array, "K n"]
    visible: Bool[Array, "K targets"]
    present: Bool[Array, "instants n"]
    rejections: Int[Array, "K n"] | None = None
    contacts: Int[Array, " K"] | None = None
    existence: Float[Array, "instants n"] | None = None
    confirmed: Bool[Array, "instants n"] | None = None
    undetected: Float[Array, " instants"] | None = None
    expected_gospa: Float[Array, " instants"] | None = None
    dropped: Int[Array, " K"] | None = None
    team: TeamTrace | None = None


def per_target(values: Float[Array, "*b n"], present: Bool[Array, "*b n"]) -> Float[Array, "*b"]:
    """The mean of `values` over the present targets; 0 without any."""
    count = jnp.maximum(jnp.sum(present, axis=-1), 1).astype(values.dtype)
    return jnp.sum(jnp.where(present, values, 0.0), axis=-1) / count


class Protocol(NamedTuple):
    """Source of information: the soft view of training, or real measurements.

    With `levels`, information grows by the soft weight of each level: one information matrix per level, the last of
    which the policy observes. The weight is that of the predicted mean (the paper) or, `at_truth`, of the true
    position, for training on episodes with truth. Without levels only real measurements count: the Kalman filter, with
    negative information if the sensor `uses_missed_detections`. `gate` is the largest squared distance of a measurement
    to its prediction that is not rejected (see `models.gate`).
    """

    levels: tuple[Softness, ...]
    at_truth: bool = False
    gate: float | None = None


SURROGATE = Protocol(levels=(PAPER_SOFTNESS,))
TRUE = Protocol(levels=())
PROTOCOLS = {"surrogate": SURROGATE, "true": TRUE}
"""The protocols of an evaluation by name."""


class Backpropagation(NamedTuple):
    """Backpropagation through time.

    With `segment` (rematerialisation), only the state at the beginning of every `segment` steps is stored; the backward
    pass computes the others again: a third more work, far less memory, the same gradient. With `window` (truncation),
    the gradient ends at the last step whose number is a multiple of it.
    """

    segment: int | None = None
    window: int | None = None


class LastLook(eqx.Module):
    """The pose of the previous look, and the targets that it did not show."""

    pose: Pose
    missed: Bool[Array, " n"]


class State(eqx.Module):
    """Pose and beliefs after step k; `information` has one matrix per level of the protocol (at least one).

    `rejections` is as in `Trace`; `last_look` is None unless missed detections are used; `contacts` counts the steps
    that an obstacle has ended, None without obstacles. With detections without ids `population` is the state of their
    filter, beliefs and `present` are those of its tracks, and `dropped` counts detections for which there was no room.
    """

    step: Count
    pose: Pose
    mean: Float[Array, "n n_y"]
    information: Float[Array, "levels n n_y n_y"]
    present: Bool[Array, " n"]
    rejections: Int[Array, " n"] | None = None
    last_look: LastLook | None = None
    contacts: Count | None = None
    population: Population | None = None
    dropped: Count | None = None


def observe(
    predicted: State,
    known_input: Float[Array, "n m_y"],
    horizon: Count,
    robot: Robot,
    team: TeamView | None = None,
) -> Observation:
    """The observation of a predicted state in an episode of `horizon` steps."""
    population = predicted.population
    return Observation(
        step=predicted.step,
        left=horizon - predicted.step,
        pose=predicted.pose,
        mean=predicted.mean,
        information=predicted.information[-1],
        present=predicted.present,
        known_input=known_input,
        robot=robot.at(predicted.step),
        existence=None if population is None else population.tracks.existence,
        undetected=None if population is None else population.undetected,
        team=team,
    )


class Instant(eqx.Module):
    """The part of an episode that belongs to one step; None where the episode has no such part."""

    known_input: Float[Array, "*K n m_y"]
    truth: Truth | None = None
    arrivals: Arrivals | None = None
    scans: ScanNoise | None = None
    mates_world: Float[Array, "mates d"] | None = None
    """Where the other robots of a team are before the step [m]."""
