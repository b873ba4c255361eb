"""Settings of fields of view, in the body frame: x ahead, y to the left, z up. Lengths [m], angles [deg]."""

import math
from dataclasses import dataclass
from typing import Literal

from foveate.geometry import fov, fov_planar, fov_spatial
from foveate.io.settings import Settings, tag
from foveate.io.validate import positive, require


def _angle(settings: object, name: str, limit: float, up_to: bool = False) -> None:
    value = getattr(settings, name)
    require(0 < value < limit or (up_to and value == limit), name, value, f"expected between 0 and {limit:g}")


def _range(near: float, far: float, far_name: str) -> None:
    require(far > 0, far_name, far, "expected > 0")
    require(0 <= near < far, "near_m", near, f"expected from 0 to below {far_name} {far}")


@dataclass(frozen=True, kw_only=True)
class TriangleView(Settings):
    """A triangle with its apex at the agent, opening ahead."""

    shape: Literal["triangle"] = "triangle"
    depth_m: float = 2.0
    """Distance from the agent to the far side, along the axis."""
    angle_deg: float = 120.0
    """Full angle at the agent, below 180."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "depth_m")
        _angle(self, "angle_deg", 180.0)

    def view(self) -> fov.FieldOfView:
        """Signed-distance shape [m]."""
        return fov_planar.triangle(self.depth_m, math.radians(self.angle_deg))


@dataclass(frozen=True, kw_only=True)
class SectorView(Settings):
    """A circular sector with its apex at the agent, opening ahead."""

    shape: Literal["sector"] = "sector"
    depth_m: float = 10.0
    """Radius."""
    angle_deg: float = 90.0
    """Full angle, up to 360."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "depth_m")
        _angle(self, "angle_deg", 360.0, up_to=True)

    def view(self) -> fov.FieldOfView:
        """Signed-distance shape [m]."""
        return fov_planar.sector(self.depth_m, math.radians(self.angle_deg))


@dataclass(frozen=True, kw_only=True)
class PolygonView(Settings):
    """A convex polygon."""

    shape: Literal["polygon"] = tag("polygon")
    vertices_m: tuple[tuple[float, float], ...]
    """Corners [x, y], in order."""

    def __post_init__(self) -> None:
        super().__post_init__()
        fov_planar.polygon(self.vertices_m)

    @property
    def depth_m(self) -> float:
        """Largest distance from the agent to a point of the view [m]."""
        return max(math.hypot(*vertex) for vertex in self.vertices_m)

    def view(self) -> fov.FieldOfView:
        """Signed-distance shape [m]."""
        return fov_planar.polygon(self.vertices_m)


@dataclass(frozen=True, kw_only=True)
class BallView(Settings):
    """A disc or ball, of a sensor with limited range in all directions."""

    shape: Literal["ball"] = tag("ball")
    radius_m: float
    """Range of the sensor."""
    center_m: tuple[float, ...]
    """Centre in the body frame; two coordinates for a disc, three for a ball."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "radius_m")
        require(len(self.center_m) in (2, 3), "center_m", self.center_m, "expected 2 or 3 numbers")

    @property
    def depth_m(self) -> float:
        """Largest distance from the agent to a point of the view [m]."""
        return math.hypot(*self.center_m) + self.radius_m

    def view(self) -> fov.FieldOfView:
        """Signed-distance shape [m]."""
        return fov.ball(self.center_m, self.radius_m)


@dataclass(frozen=True, kw_only=True)
class FrustumView(Settings):
    """The view of a camera that looks ahead, between planes at `near_m` and `depth_m`."""

    shape: Literal["frustum"] = tag("frustum")
    near_m: float = 0.3
    depth_m: float = 6.0
    width_deg: float = 90.0
    """Full angle across."""
    height_deg: float = 60.0
    """Full angle up and down."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _range(self.near_m, self.depth_m, "depth_m")
        _angle(self, "width_deg", 180.0)
        _angle(self, "height_deg", 180.0)

    def view(self) -> fov.FieldOfView:
        """Signed-distance shape [m]."""
        width, height = math.radians(self.width_deg), math.radians(self.height_deg)
        return fov_spatial.frustum(self.near_m, self.depth_m, width, height)


@dataclass(frozen=True, kw_only=True)
class ConeView(Settings):
    """A cone ahead between slant ranges `near_m` and `depth_m`: a radar, a lidar, a searchlight."""

    shape: Literal["cone"] = tag("cone")
    near_m: float = 0.0
    depth_m: float = 6.0
    angle_deg: float = 60.0
    """Full angle, up to 360."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _range(self.near_m, self.depth_m, "depth_m")
        _angle(self, "angle_deg", 360.0, up_to=True)

    def view(self) -> fov.FieldOfView:
        """Signed-distance shape [m]."""
        return fov_spatial.cone(self.near_m, self.depth_m, math.radians(self.angle_deg))


@dataclass(frozen=True, kw_only=True)
class PrismView(Settings):
    """A planar shape, unbounded upwards and downwards: a planar sensor in space."""

    shape: Literal["prism"] = tag("prism")
    base: TriangleView | SectorView | PolygonView

    @property
    def depth_m(self) -> float:
        """Depth of the base [m]."""
        return self.base.depth_m

    def view(self) -> fov.FieldOfView:
        """Signed-distance shape [m]."""
        return fov_spatial.prism(self.base.view())


ViewSettings = TriangleView | SectorView | PolygonView | BallView | FrustumView | ConeView | PrismView
