"""The process of the node: rclpy from its begin to its end. Only this module imports ROS."""

import signal
import sys
from collections.abc import Sequence
from importlib import import_module

from foveate.errors import InputError
from foveate.io.jax_settings import keep_compiled
from foveate.ros.node import Driver, find_class

NODE = "foveate"
HELP = """usage: python -m foveate.ros RUN|PRESET|FILE.onnx [--ros-args -p NAME:=VALUE -r TOPIC:=TOPIC ..]

Drive a robot with a trained policy: nav_msgs/Odometry on odom and detections in (geometry_msgs/PoseArray on poses, or
vision_msgs/Detection3DArray on detections), geometry_msgs/Twist on cmd_vel and the beliefs out. docs/ros.md has all
topics and parameters."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is interrupted. Exit status: 0, or 2 for wrong input."""
    given = list(sys.argv if arguments is None else ["foveate.ros", *arguments])
    try:
        return _run(given)
    except InputError as error:
        print(f"foveate.ros: {error}", file=sys.stderr)
        return 2


def _run(given: list[str]) -> int:
    try:
        rclpy, qos = import_module("rclpy"), import_module("rclpy.qos")
        signals, utilities = import_module("rclpy.signals"), import_module("rclpy.utilities")
    except ImportError as error:
        raise InputError(f"rclpy, ROS 2's Python, is not found ({error}): source /opt/ros/DISTRO/setup.bash") from None
    names = utilities.remove_ros_args(given)[1:]
    if {"-h", "--help"} & set(names):
        print(HELP)
        return 0
    if len(names) > 1:
        raise InputError(f"{' '.join(names)}: expected one policy: a run folder, a preset or a file of foveate export")
    keep_compiled()
    # rclpy's own handlers would end the context before the robot is told to stand.
    rclpy.init(args=given, signal_handler_options=signals.SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, _interrupt)
    node = rclpy.create_node(NODE)
    driver = None
    try:
        kept = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        driver = Driver(node, find_class, qos.qos_profile_sensor_data, *names, map_qos=kept)
        rclpy.spin(node)
    except KeyboardInterrupt:
        return 0
    finally:
        if driver is not None:
            driver.stop()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt
