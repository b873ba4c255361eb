"""Small worlds whose detections have no ids."""

from foveate.scenario.detections import BirthSettings, DetectionSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import VelocityTarget

SCENES = SceneSettings(
    targets_min=1,
    targets_max=3,
    half_side_m=(8.0, 8.0),
    half_side_per_target_m=0.0,
    drift_m_s=(0.3, 0.3),
    steps=12,
    initial_error="consistent",
)
BIRTHS = (
    BirthSettings(rate=0.2, low_m=(-9.0, -9.0), high_m=(-5.0, -5.0)),
    BirthSettings(rate=0.1, first=1, low_m=(5.0, 5.0), high_m=(9.0, 9.0)),
)
HALL = Scenario(
    view=SectorView(depth_m=8.0, angle_deg=120.0),
    target=VelocityTarget(acceleration_m2_s3=0.01, initial_velocity_variance_m2_s2=0.03),
    scenes=SCENES,
    detections=DetectionSettings(
        low_m=(-10.0, -10.0),
        high_m=(10.0, 10.0),
        cells=(8, 8),
        probability=0.8,
        clutter=0.5,
        survival=0.95,
        undetected=1.0,
        births=BIRTHS,
        tracks=10,
        detections=8,
        known=False,
    ),
)
