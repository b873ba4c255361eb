"""A core of a node with a policy that a test can watch, and messages for it."""

import numpy as np
from scipy.spatial.transform import Rotation

from foveate.ros.core import Core, CoreSettings
from foveate.ros.model import RobotModel
from foveate.ros.records import Detections, Odometry
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import DriftTarget

PLANE = Scenario(
    tau_s=0.5,
    view=SectorView(depth_m=6.0, angle_deg=90.0),
    sensor=SensorSettings(std_m=0.1),
    target=DriftTarget(process_std_m=0.2),
)


class Watched:
    """A policy that remembers what it was asked."""

    def __init__(self, scenario=PLANE, axes=("vx", "wz"), command=(1.0, -0.5), **settings):
        self.asked, self.command = [], np.array(command)
        model = RobotModel(name="watched", scenario=scenario, axes=axes, decide=self.decide)
        self.core = Core(model, CoreSettings(**settings))

    def decide(self, belief, pose):
        self.asked.append((belief, pose))
        return self.command

    @property
    def belief(self):
        return self.asked[-1][0]


def odometry(time_s, position=(0.0, 0.0, 0.0), angles=(0.0, 0.0, 0.0), frame="odom", child="base_link") -> Odometry:
    """Angles are yaw, pitch and roll [rad]."""
    return Odometry(
        time_s, frame, child, tuple(map(float, position)), tuple(Rotation.from_euler("ZYX", angles).as_quat())
    )


def detections(time_s, frame="odom", **positions) -> Detections:
    return Detections(time_s, frame, {name: tuple(map(float, xyz)) for name, xyz in positions.items()})
