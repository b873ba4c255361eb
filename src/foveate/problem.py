"""The records that a simulation is made of: the problem, one episode of it, what a policy sees, what happened."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foveate.models.agent import Agent
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.types import Action, Count, Information, Key, Pose, Scalar


class Schedule(eqx.Module):
    """What changes from step to step: tau_k [s], the targets' motion and the sensor's V, each with a leading axis.

    Step k takes entry k modulo the length of that axis.
    """

    tau: Float[Array, " period"]
    motion: LinearGaussian
    V: Float[Array, "period n_z n_z"]


class Problem(eqx.Module):
    """Who looks at what: agent, sensor, motion of the targets, control period tau [s], first information matrix.

    Without a `schedule` these hold for all steps.
    """

    agent: Agent
    sensor: Sensor
    motion: LinearGaussian
    tau: Scalar
    prior_information: Information
    schedule: Schedule | None = None

    def at(self, step: Count) -> "Problem":
        """The problem of step k alone: with tau_k, A, B, W_k and V_k in their places."""
        if self.schedule is None:
            return self
        now = jax.tree.map(lambda part: part[step % len(part)], self.schedule)
        places = (now.tau, now.motion, now.V)
        here = eqx.tree_at(lambda problem: (problem.tau, problem.motion, problem.sensor.V), self, places)
        return eqx.tree_at(lambda problem: problem.schedule, here, None)

    @property
    def period(self) -> Schedule:
        """The schedule, of one entry where nothing changes."""
        if self.schedule is not None:
            return self.schedule
        motion = jax.tree.map(lambda part: part[None], self.motion)
        return Schedule(self.tau[None], motion, self.sensor.V[None])

    def step_lengths_s(self, steps: int) -> Float[np.ndarray, " K"]:
        """tau_0 .. tau_{K-1} [s]."""
        tau = np.asarray(self.period.tau, float)
        return tau[np.arange(steps) % len(tau)]


class Truth(eqx.Module):
    """What really happens to the targets, whatever the agent does.

    `state` holds y_0 .. y_K; `measurement_noise` is standard normal and is scaled by the sensor's covariance.
    """

    state: Float[Array, "instants n n_y"]
    measurement_noise: Float[Array, "K n n_z"]


class Arrivals(eqx.Module):
    """Targets that come and go: who is there at each instant, and the first mean of a belief that begins there."""

    present: Bool[Array, "instants n"]
    mean: Float[Array, "instants n n_y"]


class Episode(eqx.Module):
    """Everything that is fixed before the agent's first decision; the same for every method.

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
    """What a policy decides on at step k: the pose T_k and the predicted belief p_{k+1}, P_{k+1} of every target.

    `left` counts the steps of the episode that are left, this one too. `known_input` is xi_k, the input that led to
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
    """Decides where to go next. `memory` is any pytree that a policy wants to keep from one step to the next."""

    def start(self, observation: Observation) -> Any:
        """The memory before the first decision; `observation` is the first one."""
        del observation
        return ()

    @abc.abstractmethod
    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The normalised action in [-1, 1] for every actuated axis, and the memory for the next step."""


class Trace(eqx.Module):
    """What happened in one episode; entries after `horizon` steps are padding.

    `log_det` is log det of the information matrix after step k, `visible` whether the target was really measured.
    `refusals` counts the measurements that a gate has refused in a row; None without a gate.
    """

    pose: Float[Array, "instants ..."]
    action: Float[Array, "K m"]
    mean: Float[Array, "instants n n_y"]
    information: Float[Array, "instants n n_y n_y"]
    log_det: Float[Array, "K n"]
    visible: Bool[Array, "K n"]
    present: Bool[Array, "instants n"]
    refusals: Int[Array, "K n"] | None = None


def first_information(problem: Problem, targets: int) -> Float[Array, "n n_y n_y"]:
    """Y_0 of every target."""
    size = problem.motion.state_size
    return jnp.broadcast_to(problem.prior_information, (targets, size, size))


def per_target(values: Float[Array, "*b n"], present: Bool[Array, "*b n"]) -> Float[Array, "*b"]:
    """The mean of `values` over the targets that are present; 0 where none is."""
    return jnp.sum(jnp.where(present, values, 0.0), axis=-1) / jnp.maximum(jnp.sum(present, axis=-1), 1)
