"""A foveate policy in a Stone Soup simulation (extra `stonesoup`)."""

try:
    import stonesoup as stonesoup
except ImportError as error:  # before the modules below, which import parts of it
    raise ImportError("foveate.stonesoup needs stonesoup: pip install 'foveate[stonesoup]'") from error

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
