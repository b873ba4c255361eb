"""Collect the fixes of a recording in blocks of many rows, and group them into tracks."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from foveate.errors import InputError
from foveate.recordings.recording import Recording, Track
from foveate.scenario.origin import OriginSettings

FAR_M = 1e4
"""Larger coordinates, of positions far from zero for the extent of the recording, get an origin of their own."""


@dataclass(frozen=True, kw_only=True)
class Fixes:
    """A block of fixes: times [s], indices of their tracks, positions in the file's units."""

    times_s: Float[np.ndarray, " m"]
    owners: Int[np.ndarray, " m"]
    positions: Float[np.ndarray, "m d"]


@dataclass(kw_only=True)
class Collection:
    """Fixes of one or more files, as their readers add them, and the names of the tracks by first appearance.

    `notes` says what the readers took for granted. `strict`: the fixes are sorted by time, without repeated ones.
    """

    index_of: dict[str, int] = field(default_factory=dict)
    blocks: list[Fixes] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    strict: bool = True

    def owner(self, name: str) -> int:
        """Index of a track by its name."""
        return self.index_of.setdefault(name, len(self.index_of))

    def recording(
        self, name: str, in_degrees: bool, origin_s: int, origin: OriginSettings | None, sha256: str
    ) -> Recording:
        """Group all fixes into tracks, in local coordinates about `origin`, by default one near them if need be."""
        times = np.concatenate([block.times_s for block in self.blocks])
        owners = np.concatenate([block.owners for block in self.blocks])
        positions = np.concatenate([block.positions for block in self.blocks])
        if origin_s and times.min() < 0:  # rows out of order: the first is not the earliest
            earlier_s = int(np.floor(times.min()))
            times, origin_s = times - earlier_s, origin_s + earlier_s
        order = np.argsort(owners, kind="stable") if self.strict else np.lexsort((times, owners))
        times, owners, positions = times[order], owners[order], positions[order]
        if not self.strict:
            times, owners, positions = self._without_repeats(name, times, owners, positions)
        origin = origin or (_middle_deg(positions) if in_degrees else _far_origin(positions))
        if origin is not None and origin.in_degrees != in_degrees:
            raise InputError(f"{name}: origin {origin}: expected one {'in degrees' if in_degrees else 'in metres'}")
        if origin is not None:
            positions = origin.local(positions)
            self.notes.append(f"positions are metres from {origin}")
        times.setflags(write=False)
        positions.setflags(write=False)
        bounds = np.searchsorted(owners, np.arange(len(self.index_of) + 1))
        return Recording(
            name=name,
            dimension=positions.shape[1],
            tracks=tuple(
                Track(track_id=track_id, times_s=times[first:end], positions_m=positions[first:end])
                for track_id, first, end in zip(self.index_of, bounds[:-1], bounds[1:], strict=True)
                if end > first
            ),
            sha256=sha256,
            clock_origin_s=origin_s,
            origin=origin,
            notes=tuple(dict.fromkeys(self.notes)),
        )

    def _without_repeats(
        self, name: str, times: np.ndarray, owners: np.ndarray, positions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Keep the first of several fixes of a track at one time."""
        repeats = np.concatenate([[False], (np.diff(times) == 0) & (np.diff(owners) == 0)])
        differ = repeats & np.concatenate([[False], (np.diff(positions, axis=0) != 0).any(axis=1)])
        if differ.any():
            track_id, time_s = list(self.index_of)[owners[np.argmax(differ)]], times[np.argmax(differ)]
            self.notes.append(
                f"{int(differ.sum())} rows repeat the time of another row of their track, elsewhere (the first: "
                f"{track_id} at {time_s:.10g} s): the first of each is taken"
            )
        if count := int((repeats & ~differ).sum()):
            self.notes.append(f"{count} rows are exact repeats of others and count once")
        return times[~repeats], owners[~repeats], positions[~repeats]


def _middle_deg(positions: Float[np.ndarray, "m d"]) -> OriginSettings:
    """Origin in the middle of positions in degrees, rounded to some kilometres."""
    # The median longitude of what is nearest to the first: ships on both sides of 180 degrees.
    longitude = positions[0, 1] + (positions[:, 1] - positions[0, 1] + 180.0) % 360.0 - 180.0
    middle = round(float(np.median(longitude)), 2)
    return OriginSettings(
        latitude_deg=round(float(np.median(positions[:, 0])), 2), longitude_deg=(middle + 180.0) % 360.0 - 180.0
    )


def _far_origin(positions: Float[np.ndarray, "m d"]) -> OriginSettings | None:
    """Origin for positions that lie far from zero, rounded to 100 m; None where they do not."""
    lower, upper = positions.min(axis=0), positions.max(axis=0)
    far = np.maximum(np.abs(lower), np.abs(upper))
    # A box around zero gains nothing from another zero: float32 resolves its ends as well as its middle.
    if not (far > np.maximum(FAR_M, 2.0 * (upper - lower))).any():
        return None
    return OriginSettings(position_m=tuple((100.0 * np.round(np.median(positions, axis=0) / 100.0)).tolist()))
