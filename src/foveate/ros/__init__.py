"""A ROS 2 node that drives a robot with a policy, and bags of replays. `python -m foveate.ros` runs the node.

Only `main` needs ROS: all decisions are made in `core`, which takes and gives plain records.
"""

from foveate.ros.core import Core, CoreSettings
from foveate.ros.model import RobotModel, load_model
from foveate.ros.records import Decision, Detections, Estimate, Odometry
from foveate.ros.team import TeamCore

__all__ = [
    "Core",
    "CoreSettings",
    "Decision",
    "Detections",
    "Estimate",
    "Odometry",
    "RobotModel",
    "TeamCore",
    "load_model",
]
