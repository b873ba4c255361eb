"""Records of a simulation: an episode, what a policy sees and decides, the state between steps, what happened."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.types import Action, Count, Key, Pose


class Truth(eqx.Module):
    """The true states of the targets, whatever the agent does.

    `state` holds y_0 .. y_K; `measurement_noise` is standard normal and is scaled by the sensor's covariance.
    """

    state: Float[Array, "instants n n_y"]
    measurement_noise: Float[Array, "K n n_z"]


class Arrivals(eqx.Module):
    """Births and deaths: the targets present at each instant, and the first mean of a belief that begins there."""

    present: Bool[Array, "instants n"]
    mean: Float[Array, "instants n n_y"]


class Episode(eqx.Module):
    """Everything that is fixed before the agent's first decision, the same for every method.

    Arrays may be padded: `present` marks the real targets and only the first `horizon` steps count. Without `truth`
    the simulation is the noise-free one of training, in which the mean is never corrected.
    """

    pose: Pose
    mean: Float[Array, "n n_y"]
    present: Bool[Array, " n"]
    inputs: Float[Array, "K n m_y"]
    horizon: Count
    truth: Truth | None = None
    arrivals: Arrivals | None = None


class Observation(eqx.Module):
    """Input of a policy at step k: the pose T_k and the predicted belief p_{k+1}, P_{k+1} of every target.

    `left` counts the remaining steps of the episode, this one included. `known_input` is xi_k, the input that led to
    the prediction. Where `present` is false the entry is padding.
    """

    step: Count
    left: Count
    pose: Pose
    mean: Float[Array, "n n_y"]
    information: Float[Array, "n n_y n_y"]
    present: Bool[Array, " n"]
    known_input: Float[Array, "n m_y"]


class Policy(eqx.Module):
    """A policy: maps an observation to an action. `memory` is any pytree that it keeps from one step to the next."""

    def start(self, observation: Observation) -> Any:
        """The memory before the first decision; `observation` is the first one."""
        del observation
        return ()

    @abc.abstractmethod
    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The normalised action in [-1, 1] for every actuated axis, and the memory for the next step."""


class Trace(eqx.Module):
    """Record of one episode; entries after `horizon` steps are padding.

    `log_det` is log det of the information matrix after step k, `visible` whether the target was really measured.
    `rejections` counts the measurements in a row that the gate has rejected; None without a gate.
    """

    pose: Float[Array, "instants ..."]
    action: Float[Array, "K m"]
    mean: Float[Array, "instants n n_y"]
    information: Float[Array, "instants n n_y n_y"]
    log_det: Float[Array, "K n"]
    visible: Bool[Array, "K n"]
    present: Bool[Array, "instants n"]
    rejections: Int[Array, "K n"] | None = None


def per_target(values: Float[Array, "*b n"], present: Bool[Array, "*b n"]) -> Float[Array, "*b"]:
    """The mean of `values` over the targets that are present; 0 where none is."""
    count = jnp.maximum(jnp.sum(present, axis=-1), 1).astype(values.dtype)
    return jnp.sum(jnp.where(present, values, 0.0), axis=-1) / count


class Protocol(NamedTuple):
    """Source of information: the soft view of training, or real measurements.

    With `levels`, it grows by the soft weight of each level: one information matrix a level, of which the policy sees
    the last. The weight is taken at the predicted mean (the paper), or, `at_truth`, where the target really is, for
    training on episodes with truth. Without levels it grows only with real measurements: the Kalman filter; if the
    sensor says `uses_missed_detections`, also with what was not seen. With a `gate` it rejects measurements whose
    squared distance to their prediction is above that (see `models.gate`).
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

    With `segment` (rematerialisation), only the state at the beginning of every `segment` steps is stored, and the
    steps between are computed again on the way back: a third more work, far less memory, the same gradient. With
    `window` (truncation), the gradient goes no further back than to the last step whose number is a multiple of it.
    """

    segment: int | None = None
    window: int | None = None


FULL_BACKPROPAGATION = Backpropagation()


class State(eqx.Module):
    """Pose and beliefs after step k; `information` has one matrix for each of the protocol's levels (at least one).

    `rejections` counts the measurements in a row of each target that were rejected; None without a gate.
    """

    step: Count
    pose: Pose
    mean: Float[Array, "n n_y"]
    information: Float[Array, "levels n n_y n_y"]
    present: Bool[Array, " n"]
    rejections: Int[Array, " n"] | None = None


class Reality(eqx.Module):
    """True states after a step, and the standard normals of its measurements."""

    state: Float[Array, "n n_y"]
    noise: Float[Array, "n n_z"]


class Arrival(eqx.Module):
    """Which targets are present after a step, and the first mean of a belief that begins there."""

    present: Bool[Array, " n"]
    mean: Float[Array, "n n_y"]


class Instant(eqx.Module):
    """The part of an episode that belongs to one step; None where the episode has no such part."""

    known_input: Float[Array, "n m_y"]
    reality: Reality | None
    arrival: Arrival | None
