"""Origin of local coordinates on a map: float32 sees metres near zero, wherever on the Earth a recording is from."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from foveate.io.settings import Settings
from foveate.io.validate import require

_AXIS_M, _SQUARE_ECCENTRICITY = 6_378_137.0, 6.694379990141e-3  # WGS 84


@dataclass(frozen=True, kw_only=True)
class OriginSettings(Settings):
    """Place of the scenario's coordinates (0, 0) on the map that its recording was in; `fit` writes it.

    Either `position_m`, in a map in metres (UTM), or `latitude_deg` and `longitude_deg`. Recordings are moved there
    before a replay; a robot that knows its pose on the map subtracts it.
    """

    position_m: tuple[float, ...] = ()
    latitude_deg: float | None = None
    longitude_deg: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        degrees = (self.latitude_deg, self.longitude_deg)
        right = "expected either position_m, or latitude_deg and longitude_deg"
        require((degrees == (None, None)) == bool(self.position_m), "origin", degrees, right)
        require(len(self.position_m) in (0, 2, 3), "position_m", self.position_m, "expected 2 or 3 numbers")
        if not self.position_m:
            require(None not in degrees, "origin", degrees, right)
            require(abs(self.latitude_deg or 0.0) <= 89, "latitude_deg", self.latitude_deg, "expected -89 to 89")
            right = "expected -180 to 360"
            require(-180 <= (self.longitude_deg or 0.0) <= 360, "longitude_deg", self.longitude_deg, right)

    @property
    def in_degrees(self) -> bool:
        """True for an origin by latitude and longitude."""
        return not self.position_m

    def local(self, on_map: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Local positions [m] of positions on the map: [m], or latitude and longitude [deg] and perhaps a height [m].

        In degrees: x = N cos(lat0) dlon to the east and y = M dlat to the north, with the radii of curvature N and M of
        WGS 84 at the origin. Ten kilometres to the north, x is wrong by 0.16 % times tan(lat0).
        """
        if not self.in_degrees:
            return on_map - np.array(self.position_m)
        latitude, longitude = on_map[:, 0] - self._degrees[0], on_map[:, 1] - self._degrees[1]
        longitude = (longitude + 180.0) % 360.0 - 180.0
        return np.column_stack([longitude * self._metres[1], latitude * self._metres[0], on_map[:, 2:]])

    def on_map(self, local_m: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Positions on the map of local ones; the inverse of `local`."""
        if not self.in_degrees:
            return local_m + np.array(self.position_m)
        latitude = self._degrees[0] + local_m[:, 1] / self._metres[0]
        return np.column_stack([latitude, self._degrees[1] + local_m[:, 0] / self._metres[1], local_m[:, 2:]])

    def __str__(self) -> str:
        if self.in_degrees:
            return f"latitude {self.latitude_deg:.10g}, longitude {self.longitude_deg:.10g} deg"
        return f"({', '.join(f'{number:.10g}' for number in self.position_m)}) m"

    @property
    def _degrees(self) -> tuple[float, float]:
        return self.latitude_deg or 0.0, self.longitude_deg or 0.0

    @property
    def _metres(self) -> tuple[float, float]:
        """Metres in a degree of latitude, and in one of longitude."""
        phi = np.radians(self._degrees[0])
        flat = 1.0 - _SQUARE_ECCENTRICITY * np.sin(phi) ** 2
        north = _AXIS_M * (1.0 - _SQUARE_ECCENTRICITY) / flat**1.5
        return float(np.radians(north)), float(np.radians(_AXIS_M / flat**0.5 * np.cos(phi)))
