"""Settings of a team of robots and of its radio."""

from dataclasses import dataclass, field

import jax.numpy as jnp

from foveate.io.settings import Settings
from foveate.io.validate import at_least, require
from foveate.models.team import Kinds, Radio, Team
from foveate.scenario.field_of_view import ViewSettings
from foveate.scenario.kinds import RobotSettings

MOST_AGENTS = 1024
"""Most robots of a team: every pair has a link in every step."""


@dataclass(frozen=True, kw_only=True)
class RadioSettings(Settings):
    """The radio of a team: without keys every message arrives at once; with `loss = 1` none ever does.

    In each step every robot sends to every other what it knows: measurements, beliefs, places, and what each robot
    claims. It passes on what it has heard.
    """

    range_m: float | None = None
    """Largest distance between sender and receiver. Left out: any."""
    loss: float = 0.0
    """Probability that a message is lost, each for itself: 1 for robots without a radio."""
    delay_steps: int = 0
    """Steps from sending to arrival."""
    memory_steps: int = 8
    """A message holds the measurements of this many last steps, which are fused exactly; what is older by covariance
    intersection. More than `delay_steps`. Not used where every message arrives at once, or none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        right = "expected >= 0, or none for a radio without limit"
        require(self.range_m is None or self.range_m >= 0, "range_m", self.range_m, right)
        require(0 <= self.loss <= 1, "loss", self.loss, "expected 0 to 1")
        at_least(0, self, "delay_steps")
        right = f"expected more than delay_steps = {self.delay_steps}, at most 64"
        require(self.delay_steps < self.memory_steps <= 64, "memory_steps", self.memory_steps, right)

    def radio(self) -> Radio:
        """The radio as arrays."""
        is_perfect = self.range_m is None and self.loss == 0 and self.delay_steps == 0
        return Radio(
            range_m=jnp.asarray(jnp.inf if self.range_m is None else self.range_m, float),
            loss=jnp.asarray(self.loss, float),
            kind="silent" if self.loss == 1 else "perfect" if is_perfect else "lossy",
            delay=self.delay_steps,
            memory=self.memory_steps,
        )


@dataclass(frozen=True, kw_only=True)
class TeamSettings(Settings):
    """A team of robots, each with a pose and a belief of its own of all targets.

    All robots are like the scenario's unless `robots` are listed. All begin with the same first beliefs, and know where
    the others start. With `keep_off_m` they keep that distance from each other, too. Scenes draw the first robot's
    start as a single robot's; a ring of targets is about a random robot for each target.
    """

    agents: int
    """Number of robots; 1 is a scenario without a team."""
    half_side_m: tuple[float, ...] | None = None
    """Half side of the box, about the middle of the targets', in which the other robots start. Left out: they start as
    the first one does."""
    radio: RadioSettings = field(default_factory=RadioSettings)
    robots: tuple[RobotSettings, ...] | None = None
    """Kinds of robots, in order: where there are more agents than kinds, they repeat. Left out: all are alike."""

    def __post_init__(self) -> None:
        super().__post_init__()
        right = f"expected 1 to {MOST_AGENTS}"
        require(1 <= self.agents <= MOST_AGENTS, "agents", self.agents, right)
        side = self.half_side_m
        require(side is None or min(side, default=-1) >= 0, "half_side_m", side, "expected >= 0 per axis")

        right = f"expected 1 to agents = {self.agents} tables: fewer are repeated in order"
        right = right if self.agents > 1 else "expected none for a single robot, which is the scenario's"
        count = None if self.robots is None else len(self.robots)
        require(count is None or 0 < count <= self.agents > 1, "robots", self.robots, right)

    def require_tracks(self, view: ViewSettings) -> None:
        """Raise InputError unless the robots can share tracks of detections without ids, by the scenario's view."""
        for i, robot in enumerate(self.robots or ()):
            right = "expected the scenario's, with detections without ids: false alarms are uniform in one view"
            require(robot.view in (None, view), f"team.robots[{i}].view", "[..]", right)

    def team(self, kinds: Kinds | None = None) -> Team | None:
        """The team as arrays, of these `kinds` of robots; None of a single robot."""
        side = None if self.half_side_m is None else jnp.asarray(self.half_side_m, float)
        radio = self.radio.radio()
        return None if self.agents == 1 else Team(agents=self.agents, radio=radio, half_side=side, kinds=kinds)
