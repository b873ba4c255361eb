"""A robot of a team without ROS: it tells the others what it has measured, and works in what it hears.

A message holds all measurements of the last `lag_s` seconds that a robot knows, its own and those that it has heard,
each with its robot, time and target: by these none counts twice, however often it is told and by whom. So a message
that is lost is made up for by the next, and robots pass on what others cannot hear. Each measurement is worked in at
its own time, with the pose of the robot that took it.
"""

import json
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from foveate.deploy.tracks import Seen
from foveate.errors import InputError
from foveate.io.strict_json import parse_json
from foveate.io.validate import require
from foveate.ros.core import Core, CoreSettings, Noise, WorldPositions
from foveate.ros.markers import quaternion_of
from foveate.ros.messages import position_of
from foveate.ros.model import RobotModel
from foveate.ros.poses import matrix_of
from foveate.scenario.rows import MAX_LENGTH

FORMAT, VERSION = "foveate-team", 1
MOST_MEASUREMENTS = 10_000
"""Most measurements in a message that is taken."""


class Measured(NamedTuple):
    """What a robot has measured of targets at a time [s], from a pose x, y, z, qx, qy, qz, qw in the world frame.

    V is the covariance of its sensor's noise, in the frame that the scenario's sensor has, and at a range of 0.
    """

    robot: str
    time_s: float
    pose: tuple[float, ...]
    positions: dict[str, tuple[float, ...]]
    V: Noise | None = None

    @property
    def keys(self) -> set[tuple[str, float, str]]:
        """Robot, time and target of each measurement."""
        return {(self.robot, self.time_s, target) for target in self.positions}


class TeamCore(Core):
    """A node's state in a team: `message` is for the others, `on_message` takes theirs.

    `robot` is its name, of which there is one in the team. Raises InputError for a policy that learns from targets not
    detected: a message does not say where its robot has looked.
    """

    def __init__(self, model: RobotModel, settings: CoreSettings, robot: str) -> None:
        require(bool(robot), "robot", robot, "expected a name")
        right = "expected none for a team, whose messages hold measurements only"
        missed = model.scenario.sensor.missed_detections
        require(missed != "used", "sensor.missed_detections", missed, right)
        self.robot = robot
        V = np.asarray(model.scenario.problem().sensor.V, float)
        self._own_noise: Noise = tuple(tuple(row) for row in V.tolist())
        super().__init__(model, settings)

    def _new_tracker(self) -> None:
        super()._new_tracker()
        self._told: list[Measured] = []
        self._known: set[tuple[str, float, str]] = set()

    def _work_in(
        self, pose: Float[np.ndarray, "4 4"], positions: WorldPositions, at_s: float, V: Noise | None = None
    ) -> Seen | None:
        """As a single robot does; keep for the others what the gate has accepted."""
        seen = super()._work_in(pose, positions, at_s, V)
        if seen is not None:
            numbers = (*pose[:3, 3].tolist(), *quaternion_of(pose[:3, :3]))
            accepted = {str(name): p for name, p in positions.items() if name not in seen.rejected}
            d = self.model.scenario.dimension
            told = {name: position_of(p, d) for name, p in accepted.items()}
            self._keep(Measured(self.robot, at_s, numbers, told, self._own_noise))
        return seen

    def _keep(self, measured: Measured) -> None:
        if measured.positions:
            self._told.append(measured)
            self._known |= measured.keys

    def message(self, now_s: float) -> str:
        """What this robot tells the others now, as JSON."""
        oldest_s = now_s - self.settings.lag_s
        self._told = [each for each in self._told if each.time_s >= oldest_s]
        # A stamp may be ahead of this clock, and a message on its way: what is known is kept for longer than told.
        self._known = {key for key in self._known if key[1] >= oldest_s - self.settings.lag_s}
        content = {"format": FORMAT, "version": VERSION, "robot": self.robot, "frame": self.frame}
        return json.dumps({**content, "measurements": [each._asdict() for each in self._told]})

    def on_message(self, text: str, now_s: float) -> str | None:
        """Work in what is new in another robot's message; return what is wrong with what it leaves out."""
        try:
            robot, frame, measurements = _parsed(text)
        except InputError as error:
            return f"team: {error}"
        if robot == self.robot:
            return None
        if not self.frame:
            return "team: no odometry yet; what others tell is left out"
        if frame.strip("/") != self.frame.strip("/"):
            return f"team: the frame of {robot} is {frame!r}, that of the odometry {self.frame!r}: expected one for all"
        oldest_s, wrong = now_s - self.settings.lag_s, None
        for each in sorted(measurements, key=lambda each: each.time_s):
            if each.robot == self.robot or not oldest_s <= each.time_s <= now_s + self.settings.lag_s:
                continue
            try:
                self._take(each)
            except InputError as error:  # of a pose or a position beyond all bounds
                wrong = wrong or f"team: {robot}: {error}"
        return wrong

    def _take(self, told: Measured) -> None:
        """Work in what is new of another's measurements. Raises InputError for those beyond all bounds, at the end."""
        new = {t: p for t, p in told.positions.items() if (told.robot, told.time_s, t) not in self._known}
        usable = {t: p for t, p in new.items() if max(map(abs, p)) <= MAX_LENGTH}
        pose = matrix_of(told.pose[:3], told.pose[3:])  # type: ignore[arg-type]
        if usable and pose is not None:
            d, measured = self.model.scenario.dimension, told._replace(positions=usable)
            world = {t: np.array(p[:d]) for t, p in usable.items()}
            if super()._work_in(pose, world, told.time_s, told.V) is None:
                self._known |= measured.keys  # too late, and so it stays: it is not to be tried again
            else:
                self._keep(measured)
        if far := [t for t in new if t not in usable]:
            raise InputError(f"position of {far[0]!r:.40} = {list(new[far[0]])}: expected up to {MAX_LENGTH:g}")


def _parsed(text: str) -> tuple[str, str, list[Measured]]:
    """Robot, frame and measurements of a message. Raises InputError for another content."""
    try:
        content = parse_json(text)
    except json.JSONDecodeError as error:
        raise InputError(f"a message is no JSON ({error})") from None
    right = f"expected a message of {FORMAT}, version {VERSION}, as docs/ros.md describes it"
    try:
        if (content["format"], content["version"]) != (FORMAT, VERSION):
            raise InputError(f"format {content['format']!r:.40}, version {content['version']!r:.40}: {right}")
        rows = content["measurements"][: MOST_MEASUREMENTS + 1]
        found = [_measured(row) for row in rows]
        robot, frame = str(content["robot"]), str(content["frame"])
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"a message lacks a field, or has another ({error!r:.60}): {right}") from None
    if len(found) > MOST_MEASUREMENTS:
        raise InputError(f"a message has more than {MOST_MEASUREMENTS} measurements")
    return robot, frame, found


def _measured(row: Any) -> Measured:
    pose = tuple(float(x) for x in row["pose"])
    positions = {str(target): tuple(float(x) for x in p) for target, p in row["positions"].items()}
    if len(pose) != 7 or any(len(p) != 3 for p in positions.values()):
        raise ValueError("a pose has 7 numbers, and a position 3")
    V = row.get("V")
    noise = None if V is None else tuple(map(tuple, np.array(V, float).tolist()))
    return Measured(str(row["robot"]), float(row["time_s"]), pose, positions, noise)
