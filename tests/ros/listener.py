"""Sends a node odometry and detections, and waits for what it must send: a turn to the target, then a stop."""

import sys
import time

import rclpy
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from visualization_msgs.msg import MarkerArray

from foveate.ros.messages import Messages
from foveate.ros.node import find_class
from foveate.ros.records import Odometry as Record

PATIENCE_S = 180.0


def main() -> int:
    rclpy.init()
    node, make = rclpy.create_node("listener"), Messages(find=find_class)
    turns, beliefs, markers = [], [], []
    node.create_subscription(Twist, "turn", turns.append, 10)
    node.create_subscription(PoseWithCovarianceStamped, "beliefs/target_0", beliefs.append, 10)
    node.create_subscription(MarkerArray, "beliefs/markers", markers.append, 10)
    odometry, poses = node.create_publisher(Odometry, "odom", 10), node.create_publisher(PoseArray, "poses", 10)

    def wait(until, send: bool) -> bool:
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end and not until():
            now_s = 1e-9 * node.get_clock().now().nanoseconds
            if send:
                record = Record(now_s, "odom", "base_link", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
                odometry.publish(make.odometry(record, (0.0,) * 6))
                # The target is on the left, in the frame of the body.
                poses.publish(make.pose_array(make.header(now_s, "base_link"), [(0.0, 5.0, 0.0)]))
            rclpy.spin_once(node, timeout_sec=0.05)
        return until()

    drives = wait(lambda: any(each.angular.z != 0 for each in turns) and beliefs and markers, send=True)
    turns.clear()
    stands = wait(lambda: len(turns) > 1 and all(each.angular.z == 0 for each in turns[-2:]), send=False)
    at = beliefs[-1].pose.pose.position if beliefs else None
    print(f"drives {drives}, stands {stands}, belief at {at}, {len(markers)} markers")
    node.destroy_node()
    rclpy.shutdown()
    return 0 if drives and stands and abs(at.y - 5.0) < 0.5 and len(markers[-1].markers) == 4 else 1


sys.exit(main())
