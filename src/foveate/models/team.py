"""A team of robots and its radio, as a problem holds them."""

from typing import Literal

import equinox as eqx
from jaxtyping import Array, Float

from foveate.types import Scalar


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


class Team(eqx.Module):
    """The number of robots, at least 2, and their radio.

    `half_side` is that of the box [m] in which scenes place the others than the first; None: as the first.
    """

    agents: int = eqx.field(static=True)
    radio: Radio
    half_side: Float[Array, " d"] | None = None
