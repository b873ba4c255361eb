"""Message definitions that rosbags does not bring: 3-D detections of vision_msgs 4, of ROS 2 since Humble."""

from typing import Any

VISION = {
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id",
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}


def typestore(name: str) -> Any:
    """Types of a ROS distribution, by the name that rosbags has for it, with VISION."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores(name))
    for kind, text in VISION.items():
        store.register(get_types_from_msg(text, f"vision_msgs/msg/{kind}"))
    return store
