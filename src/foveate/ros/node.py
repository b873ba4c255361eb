"""The node: parameters and topics of ROS around `Core`.

`Driver` uses what rclpy's `Node` offers, and imports nothing of ROS itself.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from foveate.errors import InputError
from foveate.names import GATE
from foveate.ros import messages
from foveate.ros.core import STOP, Core, CoreSettings
from foveate.ros.markers import belief_shapes, view_shapes
from foveate.ros.messages import MOST_TOPICS, Messages
from foveate.ros.model import load_model
from foveate.ros.records import Decision, Detections
from foveate.ros.team import TeamCore

TEAM = "/team"
SILENT_S = 5.0
"""Least time between two lines of the log about the same thing."""


class Driver:
    """Subscriptions, publishers and the timer of a node.

    `find` returns message classes by name, or raises ImportError where a package is missing; `sensor_qos` is the
    quality of service of the subscriptions, `map_qos` that of the map, which is sent once.
    """

    def __init__(
        self, node: Any, find: Callable[[str], Any], sensor_qos: Any, policy: str = "", map_qos: Any = 1
    ) -> None:
        self._node, self._find, self._messages = node, find, Messages(find=find)
        self._said: dict[str, float] = {}
        policy = policy or self._parameter("policy", "")
        if not policy:
            raise InputError("policy: expected a run folder, a preset or a file of foveate export")
        defaults = CoreSettings()
        names = ("odometry_timeout_s", "lag_s", "forget_after_s", "detections_frame", "sensor_frame")
        names = (*names, "robot_radius_m", "keep_off_m")
        map_topic = str(self._parameter("map_topic", ""))
        values = {name: self._parameter(name, getattr(defaults, name)) for name in names}
        mount = tuple(self._parameter("sensor_pose", list(defaults.sensor_pose)))
        gate = self._parameter("gate", GATE)
        self._is_stamped = bool(self._parameter("stamped", False))
        if len(mount) != len(defaults.sensor_pose):
            raise InputError(f"sensor_pose = {list(mount)}: expected x, y, z, qx, qy, qz, qw")
        gate = gate if gate < 1.0 else None
        settings = CoreSettings(**values, sensor_pose=mount, gate=gate, needs_map=map_topic != "")
        number = int(self._parameter("number", -1))
        robot, model = str(self._parameter("robot", "")), load_model(policy, None if number < 0 else number)
        self.core = TeamCore(model, settings, robot) if robot else Core(model, settings)
        obstacles = self.core.model.scenario.obstacles
        if obstacles is not None and obstacles.map_counts != (1, 0) and not map_topic:
            right = "expected the topic of the robot's map: the policy was trained among random ones"
            raise InputError(f"map_topic = '': {right}")
        self._dimension = self.core.model.scenario.dimension
        self._connect(sensor_qos)
        grid, self._shown = find("nav_msgs/msg/OccupancyGrid"), None
        self._walls = self._node.create_publisher(grid, "walls", map_qos)
        if map_topic:
            self._node.create_subscription(grid, map_topic, self._on_map, map_qos)
        self._start()

    def _parameter(self, name: str, default: Any) -> Any:
        return self._node.declare_parameter(name, default).value

    def _connect(self, sensor_qos: Any) -> None:
        node, find = self._node, self._find
        twist = "geometry_msgs/msg/TwistStamped" if self._is_stamped else "geometry_msgs/msg/Twist"
        self._commands = node.create_publisher(find(twist), "cmd_vel", 1)
        self._markers = node.create_publisher(find("visualization_msgs/msg/MarkerArray"), "beliefs/markers", 1)
        self._beliefs: dict[str, Any] = {}
        self._team: Any = None
        if isinstance(self.core, TeamCore):
            kind = find("std_msgs/msg/String")
            self._team = node.create_publisher(kind, TEAM, 10)
            node.create_subscription(kind, TEAM, self._on_team, 10)
        node.create_subscription(find("nav_msgs/msg/Odometry"), "odom", self._on_odometry, sensor_qos)
        node.create_subscription(find("geometry_msgs/msg/PoseArray"), "poses", self._on_poses, sensor_qos)
        try:
            kind = find("vision_msgs/msg/Detection3DArray")
        except ImportError:
            self._log("info", "vision_msgs is not installed: detections are expected as PoseArray on poses")
        else:
            node.create_subscription(kind, "detections", self._on_vision, sensor_qos)

    def _start(self) -> None:
        model = self.core.model
        trained_s = self.core.period_s
        period_s = float(self._parameter("period_s", 0.0)) or trained_s
        if not period_s > 0:
            raise InputError(f"period_s = {period_s:g}: expected seconds > 0")
        if abs(period_s - trained_s) > 0.01 * trained_s:
            self._log("warning", f"{model.name} was trained for a period of {trained_s:g} s; it runs at {period_s:g} s")
        view = model.scenario.problem().sensor.view.outline()
        self._view = view_shapes([view] if isinstance(view, np.ndarray) else view)
        limits = ", ".join(model.axes)
        self._log("info", f"{model.name}: a command ({limits}) every {period_s:g} s, when there is odometry")
        self._node.create_timer(period_s, self.step)

    def _now_s(self) -> float:
        return 1e-9 * self._node.get_clock().now().nanoseconds

    def _on_odometry(self, message: Any) -> None:
        self._complain(self.core.on_odometry(messages.odometry_of(message)))
        self._show_walls()

    def _on_map(self, message: Any) -> None:
        self.stop()  # it may take seconds, in which no command is sent
        try:
            self._complain(self.core.on_map(messages.map_of(message)))
        except InputError as error:
            self._complain(str(error))
        self._show_walls()

    def _show_walls(self) -> None:
        """Publish the walls where they are others than before."""
        known, shown = self.core.map, self._shown
        if known is None or (shown is not None and known.frame == shown.frame and known.grid is shown.grid):
            return
        self._shown = known
        header = self._messages.header(self._now_s(), known.frame)
        self._walls.publish(self._messages.occupancy(header, known.grid))

    def _on_team(self, message: Any) -> None:
        assert isinstance(self.core, TeamCore), "no other listens"
        self._complain(self.core.on_message(message.data, self._now_s()))

    def _on_poses(self, message: Any) -> None:
        self._take(messages.detections_of_array(message))

    def _on_vision(self, message: Any) -> None:
        record, unnamed = messages.detections_of_vision(message)
        if unnamed:
            self._complain(f"detections: {unnamed} have no id: run a tracker first, which tells the targets apart")
        self._take(record)

    def _take(self, record: Detections) -> None:
        try:
            self._complain(self.core.on_detections(record, self._now_s()))
        except InputError as error:
            self._complain(f"detections: {error}")

    def _complain(self, problem: str | None) -> None:
        if problem:
            self._log("warning", problem)

    def _log(self, level: str, text: str) -> None:
        """Log a line, but not the same again and again: lines are told apart by what stands before their colon."""
        now_s, about = self._now_s(), text.partition(":")[0]
        last_s = self._said.get(about, -np.inf)
        if not last_s <= now_s < last_s + SILENT_S:  # also where the clock went back
            self._said[about] = now_s
            if level == "info":  # a line of the source has one level: rclpy raises ValueError for another
                self._node.get_logger().info(text)
            else:
                self._node.get_logger().warning(text)

    def step(self) -> None:
        """Decide; the command goes out first, the beliefs after it."""
        decision = self.core.decide(self._now_s())
        self._command(decision.time_s, decision.twist)
        if isinstance(self.core, TeamCore) and self.core.frame:  # without odometry there is nothing to tell
            self._team.publish(self._messages.text(self.core.message(decision.time_s)))
        if decision.stopped:
            self._log("warning", f"stopped: {decision.stopped}")
        if decision.frame:
            self._publish(decision)

    def stop(self) -> None:
        """Let the robot stand: a last twist of zero."""
        self._command(self._now_s(), STOP)

    def _command(self, time_s: float, twist: Sequence[float]) -> None:
        make = self._messages
        if self._is_stamped:
            header = make.header(time_s, self.core.child)
            self._commands.publish(make.twist_stamped(header, twist))
        else:
            self._commands.publish(make.twist(twist))

    def _publish(self, decision: Decision) -> None:
        make, core = self._messages, self.core
        header = make.header(decision.time_s, decision.frame)
        shapes = belief_shapes(decision.estimates, self._dimension)
        message = make.markers(header, shapes)
        body = make.header(decision.time_s, core.child)
        message.markers.extend(make.added(body, self._view))
        self._markers.publish(message)
        for estimate in decision.estimates:
            if (topic := self._topic(estimate.target)) is not None:
                topic.publish(make.belief(header, estimate, self._dimension))

    def _topic(self, target: str) -> Any:
        """Publisher of a target's belief; None where there are too many."""
        if target not in self._beliefs and len(self._beliefs) < MOST_TOPICS:
            kind = self._find("geometry_msgs/msg/PoseWithCovarianceStamped")
            self._beliefs[target] = self._node.create_publisher(kind, f"beliefs/{messages.topic_name(target)}", 1)
        return self._beliefs.get(target)


def find_class(name: str) -> Any:
    """Class of a message of the ROS installation, as "geometry_msgs/msg/Twist"."""
    package, kind, message = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), message)
