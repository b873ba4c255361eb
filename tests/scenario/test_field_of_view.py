"""Settings of fields of view: wrong ones are rejected in one line that names field and value."""

import pytest
from helpers.rejections import assert_rejected

from foveate.scenario.field_of_view import (
    BallView,
    ConeView,
    FrustumView,
    PolygonView,
    SectorView,
    TriangleView,
)

BAD = {
    "depth": (lambda: TriangleView(depth_m=0.0), "depth_m = 0.0"),
    "angle": (lambda: TriangleView(angle_deg=180.0), "angle_deg = 180.0"),
    "sector depth": (lambda: SectorView(depth_m=-1.0), "depth_m = -1.0"),
    "sector angle": (lambda: SectorView(angle_deg=361.0), "angle_deg = 361.0"),
    "polygon": (lambda: PolygonView(shape="polygon", vertices_m=((0.0, 0.0), (1.0, 1.0))), "vertices"),
    "hollow": (
        lambda: PolygonView(shape="polygon", vertices_m=((0.0, 0.0), (2.0, 0.0), (0.5, 0.5), (0.0, 2.0))),
        "convex",
    ),
    "near beyond far": (lambda: FrustumView(shape="frustum", near_m=7.0), "near_m = 7.0"),
    "wide camera": (lambda: FrustumView(shape="frustum", width_deg=180.0), "width_deg = 180.0"),
    "cone": (lambda: ConeView(shape="cone", angle_deg=0.0), "angle_deg = 0.0"),
    "ball on a line": (lambda: BallView(shape="ball", radius_m=1.0, center_m=(0.0,)), "center_m = (0.0,)"),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    assert_rejected(*BAD[name])
