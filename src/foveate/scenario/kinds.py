"""Robots of different kinds in one team: their settings, and what may differ between them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.io.records import to_table
from foveate.io.settings import Settings
from foveate.io.validate import require
from foveate.models.agent import Agent
from foveate.models.polar import finest_gain
from foveate.models.sensor import Sensor
from foveate.models.team import Kinds
from foveate.scenario.agent import AgentSettings, DifferentialDrive
from foveate.scenario.field_of_view import TriangleView, ViewSettings
from foveate.scenario.sensor import SensorSettings

PARTS = {"agent": DifferentialDrive, "view": TriangleView, "sensor": SensorSettings}
"""Tables that a robot of a team may have of its own, and what each is where the scenario has none."""

SHARED = {
    "agent": ("kind", "space", "axes"),
    "view": ("shape",),
    "sensor": ("H", "frame", "range_growth_per_m", "missed_detections", "measures", "angle_growth_per_m"),
}
"""Keys that all robots of a team share, of each table."""


@dataclass(frozen=True, kw_only=True)
class RobotSettings(Settings):
    """A robot of a team, with tables of its own in place of the scenario's.

    Robots may differ in limits and commands, in the size of the view and in the standard deviations (or `V`) of the
    sensor. In a file, keys that a table leaves out are as in the scenario's.
    """

    agent: AgentSettings | None = None
    view: ViewSettings | None = None
    sensor: SensorSettings | None = None


class Models(NamedTuple):
    """A robot as arrays."""

    agent: Agent
    sensor: Sensor


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of robot: all tables, its own or the scenario's."""

    agent: AgentSettings
    view: ViewSettings
    sensor: SensorSettings

    def models(self, H: np.ndarray) -> "Models":
        """Agent and sensor as arrays; the sensor measures by H (rows, n_y)."""
        settings = self.sensor
        sensor = Sensor(
            H=jnp.asarray(H, float),
            V=jnp.asarray(settings.noise(len(H)), float),
            view=self.view.view(),
            range_growth=0.0 if settings.measures else settings.range_growth_per_m,
            frame=settings.frame,
            uses_missed_detections=settings.missed_detections == "used",
            polar=settings.polar,
        )
        return Models(self.agent.agent(), sensor)

    def finest_gain(self, H: np.ndarray, V: np.ndarray, keep_off_m: float | None) -> np.ndarray:
        """H^T V^-1 H (n_y, n_y) of the finest measurement of targets that the robot keeps off, or does not."""
        if self.sensor.polar is None:
            return H.T @ np.linalg.inv(V) @ H
        return finest_gain(self.sensor.polar, V, H, keep_off_m)

    def own(self, robot: RobotSettings) -> "Kind":
        """The kind of a robot that has tables of its own."""
        return Kind(agent=robot.agent or self.agent, view=robot.view or self.view, sensor=robot.sensor or self.sensor)


def stacked(kinds: Sequence[Kind], H: np.ndarray, period: int) -> Kinds:
    """Kinds of robots as arrays, whose sensors measure by H.

    `period` is the number of steps of the scenario's schedule; 0 without one, and where it has V.
    """
    agent, sensor = jax.tree.map(lambda *parts: jnp.stack(parts), *(kind.models(H) for kind in kinds))
    V = jnp.repeat(sensor.V[:, None], period, axis=1) if period else None
    return Kinds(agent=agent, sensor=sensor, depth_m=tuple(float(kind.view.depth_m) for kind in kinds), V=V)


def with_inherited(table: dict[str, Any]) -> dict[str, Any]:
    """The table of a scenario, with what the tables of a team's robots leave out.

    A table of another kind or shape than the scenario's takes nothing from it.
    """
    team = table.get("team")
    robots = team.get("robots") if isinstance(team, dict) else None
    if not isinstance(team, dict) or not isinstance(robots, list):
        return table
    base = {name: _tagged(table.get(name, {}), to_table(cls())) for name, cls in PARTS.items()}
    return {**table, "team": {**team, "robots": [_inherited(robot, base) for robot in robots]}}


def _tagged(own: Any, default: dict[str, Any]) -> Any:
    """The scenario's own table, with the kind that it has where it leaves that out; the default one if it is empty."""
    if not isinstance(own, dict):
        return own
    return {**{tag: default[tag] for tag in ("kind",) if tag in default}, **own} if own else default


def _inherited(robot: Any, base: dict[str, Any]) -> Any:
    if not isinstance(robot, dict):
        return robot
    return {name: _filled(value, base.get(name)) for name, value in robot.items()}


def _filled(own: Any, base: Any) -> Any:
    if not isinstance(own, dict) or not isinstance(base, dict):
        return own
    alike = all(own.get(tag, base.get(tag)) == base.get(tag) for tag in ("kind", "shape"))
    return {**base, **own} if alike else own


def check_kinds(base: Kind, robots: Sequence[RobotSettings], has_schedule: bool) -> None:
    """Raise InputError unless a team of these robots may be in one scenario.

    `has_schedule`: the scenario has a schedule of the sensor's covariance.
    """
    for i, robot in enumerate(robots):
        for name, shared in SHARED.items():
            part, own, given = f"team.robots[{i}].{name}", getattr(base.own(robot), name), getattr(base, name)
            for key in shared:
                mine, theirs = getattr(own, key, None), getattr(given, key, None)
                right = f"expected {_said(theirs)}, as in [scenario.{name}]: all robots of a team share it"
                require(mine == theirs, f"{part}.{key}", mine, right)
        _check_noise(f"team.robots[{i}].sensor", base.sensor, base.own(robot).sensor, has_schedule)
        _check_shapes(f"team.robots[{i}]", base, base.own(robot))


def _said(value: object) -> str:
    return "none" if value is None else repr(value)


def _check_noise(name: str, base: SensorSettings, own: SensorSettings, has_schedule: bool) -> None:
    right = "expected none" if base.V is None else "expected one"
    require((own.V is None) == (base.V is None), f"{name}.V", own.V, f"{right}, as in [scenario.sensor]")
    right = "expected V in its place, as in [scenario.sensor]"
    require(base.V is None or own.std_m == base.std_m, f"{name}.std_m", own.std_m, right)
    right = "expected the scenario's sensor, whose covariance schedule.V has for all robots"
    require(not has_schedule or own == base, name, "[..]", right)


def _check_shapes(name: str, base: Kind, own: Kind) -> None:
    """Raise InputError unless the arrays of two kinds have the same shapes."""
    try:
        agents: list[Agent] = [own.agent.agent(), base.agent.agent()]
        views = [own.view.view(), base.view.view()]
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    right = "expected as many rows of commands as in [scenario.agent]"
    require(_shapes(agents[0]) == _shapes(agents[1]), f"{name}.agent.commands", own.agent.commands, right)
    right = "expected as many corners or coordinates as in [scenario.view]"
    require(_shapes(views[0]) == _shapes(views[1]), f"{name}.view", own.view, right)


def _shapes(part: Any) -> object:
    leaves, structure = jax.tree.flatten(part)
    return structure, [leaf.shape for leaf in leaves]
