"""Decisions of a node without ROS: messages in as plain records, a twist and beliefs out.

Detections are worked in at the time of their stamps, with the robot's pose at that time; late ones up to `lag_s` where
they belong (`Tracker`). The beliefs stay that far behind the clock, and a decision predicts them to the end of its own
step. Without odometry of the last `odometry_timeout_s` seconds the twist is zero.
"""

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from foveate.deploy import kalman
from foveate.deploy.belief import Belief
from foveate.deploy.motion import Matrices, motion_over
from foveate.deploy.tracker import Tracker
from foveate.deploy.tracks import Seen
from foveate.errors import InputError
from foveate.io.settings import Settings
from foveate.io.validate import at_least, positive, require
from foveate.names import GATE
from foveate.ros.model import RobotModel
from foveate.ros.poses import PoseHistory, heading, matrix_of
from foveate.ros.records import AXES, Decision, Detections, Estimate, Map, Odometry
from foveate.ros.walls import Walls, own_cells, walls_of

STOP = (0.0,) * len(AXES)
Beliefs = tuple[kalman.Means, kalman.Covariances]
Noise = tuple[tuple[float, ...], ...]
WorldPositions = dict[str, Float[np.ndarray, " d"]]


@dataclass(frozen=True, kw_only=True)
class CoreSettings(Settings):
    """Settings of a node; times in s.

    `detections_frame` replaces the frame of the detections' headers. Detections in `sensor_frame` are moved by
    `sensor_pose`, x, y, z, qx, qy, qz, qw of the sensor in the body frame [m]. With `needs_map` the robot stands until
    there is a map; in one it is a disc of `robot_radius_m`, and keeps `keep_off_m` more off walls.
    """

    odometry_timeout_s: float = 0.5
    lag_s: float = 1.0
    forget_after_s: float = 30.0
    gate: float | None = GATE
    detections_frame: str = ""
    sensor_frame: str = ""
    sensor_pose: tuple[float, float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    needs_map: bool = False
    robot_radius_m: float = 0.2
    keep_off_m: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        # No detection is younger than the clock: without a lag all would be too late.
        positive(self, "odometry_timeout_s", "forget_after_s", "lag_s")
        at_least(0, self, "robot_radius_m", "keep_off_m")
        mount = matrix_of(self.sensor_pose[:3], self.sensor_pose[3:])
        require(mount is not None, "sensor_pose", self.sensor_pose, "expected x, y, z, qx, qy, qz, qw, finite")


class Core:
    """State of a node: poses of the last seconds, a tracker, and the policy.

    `on_odometry`, `on_detections` and `on_map` return what is wrong with a message that they leave out, in one line;
    else None.
    """

    def __init__(self, model: RobotModel, settings: CoreSettings) -> None:
        self.model, self.settings = model, settings
        problem = model.scenario.problem()
        self.period_s = float(model.scenario.tau_s)
        self._measured = np.asarray(problem.sensor.H, float) @ np.linalg.pinv(np.asarray(problem.motion.Z, float))
        self._over = motion_over(model.scenario)
        self._step = self._over(self.period_s)
        mount = matrix_of(settings.sensor_pose[:3], settings.sensor_pose[3:])
        assert mount is not None, "checked with the settings"
        self._mount = mount
        self._columns = [AXES.index(axis) for axis in model.axes]
        self._walls: Walls | None = None
        self._own_cells = own_cells(problem)
        self._next_map: Map | None = None
        self._forget()

    def _forget(self) -> None:
        settings = self.settings
        self._poses = PoseHistory(settings.lag_s + settings.odometry_timeout_s)
        self._frame, self._child = "", ""
        self._new_tracker()

    def _new_tracker(self) -> None:
        settings = self.settings
        self._tracker = Tracker(
            self.model.scenario, forget_after_s=settings.forget_after_s, gate=settings.gate, lag_s=settings.lag_s
        )
        self._has_clock = False

    @property
    def frame(self) -> str:
        """World frame: that of the odometry; empty before the first."""
        return self._frame

    @property
    def child(self) -> str:
        """Body frame: that of the odometry."""
        return self._child

    @property
    def map(self) -> Map | None:
        """The walls that it decides by, in the frame of the odometry: of the last map, or of the policy's scenario."""
        cells = self._own_cells if self._walls is None else self._walls.cells
        return Map(self._frame, cells) if self._frame and cells is not None else None

    def on_odometry(self, message: Odometry) -> str | None:
        """Take the robot's pose. A clock that goes back, as that of a bag that begins again, forgets everything."""
        if matrix_of(message.position, message.quaternion) is None:
            return "odometry: its pose is not finite, or its quaternion is zero; it is left out"
        latest_s, problem = self._poses.latest_s, None
        # The frame first: to forget is to forget the frame, too.
        if self._frame and message.frame != self._frame:
            problem = f"odometry: its frame was {self._frame}, and is {message.frame}; all beliefs are forgotten"
            self._walls = None
            self._forget()
        elif latest_s is not None and message.time_s < latest_s - max(1.0, self.settings.lag_s):
            problem = f"odometry: its clock went back by {latest_s - message.time_s:.3g} s; all beliefs are forgotten"
            self._forget()
        self._frame, self._child = message.frame, message.child
        self._poses.add(message.time_s, message.position, message.quaternion)
        return problem or self._take_map()

    def on_map(self, message: Map) -> str | None:
        """Take the robot's map, in the frame of the odometry: now, or with the first of that. It takes seconds."""
        self._next_map = message
        return self._take_map() if self._frame else None

    def _take_map(self) -> str | None:
        message, self._next_map, settings = self._next_map, None, self.settings
        if message is None:
            return None
        if message.frame.strip("/") != self._frame.strip("/"):
            return f"map: its frame is {message.frame!r}, that of the odometry {self._frame!r}: expected the same"
        try:
            self._walls = walls_of(self.model, message.grid, settings.robot_radius_m, settings.keep_off_m)
        except InputError as error:
            return f"map: {error}"
        return None

    def on_detections(self, message: Detections, now_s: float) -> str | None:
        """Correct the beliefs by detections of any age up to `lag_s`; a stamp of 0 stands for now."""
        lag_s = self.settings.lag_s
        at_s = message.time_s or now_s
        if not at_s <= now_s + max(lag_s, self.settings.odometry_timeout_s):
            ahead = f"{at_s - now_s:.3g} s ahead of this node's clock"
            return f"detections: their stamp is {ahead}: synchronise the clocks, or set use_sim_time for both"
        if (pose := self._poses.at(at_s, self.settings.odometry_timeout_s)) is None:
            return f"detections: no odometry of their time, {now_s - at_s:.3g} s ago; they are left out"
        to_world = self._to_world(message.frame, pose)
        if to_world is None:
            known = [name for name in (self._frame, self._child, self.settings.sensor_frame) if name]
            return (
                f"detections: frame {message.frame!r} is none of {', '.join(known)}: set sensor_frame and sensor_pose, "
                "or detections_frame"
            )
        d = self.model.scenario.dimension
        positions = {name: (to_world @ [*xyz, 1.0])[:d] for name, xyz in message.positions.items()}
        finite = {name: p for name, p in positions.items() if np.isfinite(p).all()}
        if self._work_in(pose, finite, at_s) is None:
            return f"detections: {now_s - at_s:.3g} s old, older than lag_s = {lag_s:g} s; they are left out"
        return None

    def _work_in(
        self, pose: Float[np.ndarray, "4 4"], positions: WorldPositions, at_s: float, V: Noise | None = None
    ) -> Seen | None:
        """Correct the beliefs by positions measured from a pose, by another robot with noise V; None where too late."""
        seen: dict[Hashable, np.ndarray] = {name: self._measured @ p for name, p in positions.items()}
        before, here = self._tracker.too_late, pose if self.model.scenario.dimension == 3 else heading(pose)
        if not self._has_clock:  # the first to come need not be the first that was measured
            self._tracker.update(here, {}, time_s=at_s - self.settings.lag_s)
            self._has_clock = True
        found = self._tracker.update(here, seen, time_s=at_s, V=None if V is None else np.array(V))
        return None if self._tracker.too_late > before else found

    def _to_world(self, frame: str, pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"] | None:
        frame = (self.settings.detections_frame or frame).strip("/")
        if frame and frame == self.settings.sensor_frame.strip("/"):
            return pose @ self._mount
        if frame and frame == self._child.strip("/"):
            return pose
        return np.eye(4) if frame and frame == self._frame.strip("/") else None

    def decide(self, now_s: float) -> Decision:
        """The twist for the step that begins now, and the beliefs at its beginning."""
        estimates, twist = (), STOP
        try:
            self._catch_up(now_s)
            now = self._at(now_s)
            estimates = tuple(Estimate(str(name), *each) for name, *each in zip(self._tracker.ids, *now, strict=True))
            if not (stopped := self._reason_to_stop(now_s)):
                twist = self._twist(*now)
        except InputError as error:
            stopped = f"no decision: {error}"
        return Decision(time_s=now_s, frame=self._frame, twist=twist, stopped=stopped, estimates=estimates)

    def _reason_to_stop(self, now_s: float) -> str:
        latest_s, limit_s = self._poses.latest_s, self.settings.odometry_timeout_s
        if latest_s is None:
            return "no odometry yet"
        if self.settings.needs_map and self._walls is None:
            return "no map yet"
        if now_s - latest_s > limit_s:
            return f"the odometry is {now_s - latest_s:.3g} s old, more than odometry_timeout_s = {limit_s:g} s"
        if latest_s - now_s > limit_s:
            return f"the odometry is {latest_s - now_s:.3g} s ahead of this node's clock: synchronise the clocks"
        return ""

    def _catch_up(self, now_s: float) -> None:
        """Let the beliefs follow the clock, as far behind it as detections may come late."""
        behind_s = now_s - self.settings.lag_s - self._tracker.time_s
        if self._has_clock and behind_s > self.settings.forget_after_s:
            self._new_tracker()
        elif self._has_clock and behind_s > 1e-3 * self.period_s:
            self._tracker.predict(behind_s)

    def _at(self, time_s: float) -> Beliefs:
        """Means and covariances at a time; of the tracker where it is not before that."""
        tracker = self._tracker
        if not tracker.ids or (dt_s := time_s - tracker.time_s) <= 0:
            return tracker.mean, tracker.covariance
        return _predicted(tracker.mean, tracker.covariance, self._over(dt_s))

    def _twist(self, mean: kalman.Means, covariance: kalman.Covariances) -> tuple[float, ...]:
        """The policy's command, for beliefs at the beginning of the step."""
        mean, covariance = _predicted(mean, covariance, self._step)
        belief = Belief(mean, covariance=covariance, step_s=self.period_s)
        pose = self._poses.latest()
        here = pose if self.model.scenario.dimension == 3 else heading(pose)
        if self._walls is None:
            command = self.model.decide(belief, here)
        else:
            command = self._walls.shortened(here, self._walls.decide(belief, here))
        twist = np.zeros(len(AXES))
        twist[self._columns] = command
        return tuple(twist.tolist())


def _predicted(mean: kalman.Means, covariance: kalman.Covariances, motion: Matrices) -> Beliefs:
    A, B, W = motion
    return kalman.predict(mean, covariance, np.zeros((len(mean), B.shape[1])), A, B, W)
