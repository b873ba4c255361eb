"""A foveate policy in a Stone Soup simulation (extra `stonesoup`)."""

from foveate.stonesoup.manager import PolicySensorManager, problem_of
from foveate.stonesoup.parts import BodyMovable, TwistAction, TwistActionGenerator, ViewSensor, pose_of

__all__ = [
    "BodyMovable",
    "PolicySensorManager",
    "TwistAction",
    "TwistActionGenerator",
    "ViewSensor",
    "pose_of",
    "problem_of",
]
