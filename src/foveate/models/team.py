"""A team of robots and its radio, as a problem holds them."""

from typing import Literal

import equinox as eqx
import jax
from jaxtyping import Array, Float

from foveate.models.agent import Agent
from foveate.models.sensor import Sensor
from foveate.types import Count, Scalar


class Radio(eqx.Module):
    """What robots hear of each other.

    A message is sent by every robot to every other in each step. It arrives where the two are within `range_m` [m] of
    each other when it is sent, unless it is lost, with probability `loss`; `delay` steps later. `kind` is "perfect" if
    every message arrives at once, "silent" if none does. Messages hold the measurements of the last `memory` steps.
    """

    range_m: Scalar
    loss: Scalar
    kind: Literal["perfect", "silent", "lossy"] = eqx.field(static=True)
    delay: int = eqx.field(static=True)
    memory: int = eqx.field(static=True)


class Kinds(eqx.Module):
    """The kinds of robots of a team, arrays with a leading axis of kinds: robot i is of kind i modulo their number.

    `depth_m` are the depths of their views [m]. `V` has the sensors' covariances over the period of a schedule; None
    without a schedule.
    """

    agent: Agent
    sensor: Sensor
    depth_m: tuple[float, ...] = eqx.field(static=True)
    V: Float[Array, "kinds period n_z n_z"] | None = None

    def of_robot(self, number: Count | int) -> tuple[Agent, Sensor, Float[Array, "period n_z n_z"] | None]:
        """Agent, sensor and scheduled V of a robot."""
        kind = number % len(self.depth_m)
        return jax.tree.map(lambda part: part[kind], (self.agent, self.sensor, self.V))


class Team(eqx.Module):
    """The number of robots, at least 2, and their radio.

    `half_side` is that of the box [m] in which scenes place the others than the first; None: as the first. `kinds` is
    None where all robots are alike.
    """

    agents: int = eqx.field(static=True)
    radio: Radio
    half_side: Float[Array, " d"] | None = None
    kinds: Kinds | None = None
