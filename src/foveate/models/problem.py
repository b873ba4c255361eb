"""The problem: agent, sensor and motion of the targets, and its schedule over the steps."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.models.agent import Agent
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.types import Count, Information, Scalar


class Schedule(eqx.Module):
    """Values that change from step to step: tau_k [s], the targets' motion and the sensor's V.

    Each has a leading axis, of which step k takes entry k modulo its length.
    """

    tau: Float[Array, " period"]
    motion: LinearGaussian
    V: Float[Array, "period n_z n_z"]


class Problem(eqx.Module):
    """Agent, sensor, motion of the targets, control period tau [s] and first information matrix.

    A `schedule` overrides them from step to step.
    """

    agent: Agent
    sensor: Sensor
    motion: LinearGaussian
    tau: Scalar
    prior_information: Information
    schedule: Schedule | None = None

    def at(self, step: Count) -> "Problem":
        """The problem of step k alone, with tau_k, A, B, W_k and V_k, and without a schedule."""
        if self.schedule is None:
            return self
        entry = jax.tree.map(lambda part: part[step % len(part)], self.schedule)
        sensor = replace(self.sensor, V=entry.V)
        return replace(self, tau=entry.tau, motion=entry.motion, sensor=sensor, schedule=None)

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


def first_information(problem: Problem, targets: int) -> Float[Array, "n n_y n_y"]:
    """Y_0 of every target."""
    size = problem.motion.state_size
    return jnp.broadcast_to(problem.prior_information, (targets, size, size))
