"""Settings of the region whose borders agent and targets keep."""

from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp

from foveate.io.settings import Settings
from foveate.io.validate import require
from foveate.models.region import Region


@dataclass(frozen=True, kw_only=True)
class RegionSettings(Settings):
    """A box with borders, from `low_m` to `high_m` on each axis; without the table nothing is bounded.

    A pointer network is told where the region is. The filter knows no borders: a target that bounces leaves its
    predicted path. Random scenes have no target, and no agent unless it is `free`, outside of the region. With agent
    and targets `free` it only tells the network where targets are.
    """

    low_m: tuple[float, ...]
    high_m: tuple[float, ...]
    agent: Literal["stop", "stay", "free"] = "stop"
    """The agent moves as far as the border and stops there for the rest of the step ("stop"), or does not leave its
    position in a step that would cross the border ("stay"), or is not bounded ("free"); it turns as commanded."""
    targets: Literal["bounce", "stop", "free"] = "bounce"
    """Targets bounce off the border, velocity and drift reversed; or stop at it, without velocity or drift outwards; or
    are not bounded."""
    restitution: float = 1.0
    """Share of its velocity that a bouncing target keeps, 0 to 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.low_m, self.high_m
        require(len(low) == len(high), "high_m", high, f"expected {len(low)} numbers, as low_m has")
        below = all(a < b for a, b in zip(low, high, strict=True))
        require(below, "high_m", high, f"expected > low_m {low} on every axis")
        require(0 <= self.restitution <= 1, "restitution", self.restitution, "expected 0 to 1")

    def region(self) -> Region:
        """The region as arrays."""
        low, high, restitution = (jnp.asarray(x, float) for x in (self.low_m, self.high_m, self.restitution))
        return Region(low, high, restitution, self.agent, self.targets)

    def check(self, dimension: int, begins_with_position: bool, has_births: bool) -> None:
        """Raise InputError unless targets can keep the borders: their states begin with positions, and none appear."""
        require(len(self.low_m) == dimension, "region.low_m", self.low_m, f"expected {dimension} numbers, one per axis")
        if self.targets == "free":
            return
        right = "expected 'free': these targets have no position at a border (Z = [I 0])"
        require(begins_with_position, "region.targets", self.targets, right)
        right = "expected 'free' with scenes.birth_and_death: there targets leave and enter"
        require(not has_births, "region.targets", self.targets, right)
