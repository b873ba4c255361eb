"""Jumps and outliers of recorded tracks: switched identities, wrong fixes, and what is left without them.

A fix that is *out and back* is left out. A step that is far too long for its track is a jump, if it is alone: a target
that really moves so fast does it for several steps. What lies between two jumps for two fixes or less is left out, too;
elsewhere the track ends, and another one begins. All of it is said, with its time and the option that keeps it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from foveate.recordings.recording import Recording, Track

_SPIKE_STEPS = 5.0  # times the median step around it
_SPIKE_DETOUR = 3.0  # times the step that skips the fix
_NEIGHBOURS = 5  # steps on each side
MIN_STEP_M = 1e-3  # below what any tracker resolves: a target that stands still has a median step of zero
_JUMP, USUAL = 4.0, 90.0
"""A jump is this many times as fast as this percentile of its track; noise is not, nor a random walk (6.6 sigma)."""
_LONGEST_RUN = 3
"""More long steps in a row are motion."""
LEAST_STEPS = 10
"""Fewer say nothing of a track's speeds: those of all tracks count."""
_SHORT = 2
"""Fixes of a piece between jumps that are wrong fixes, not a target."""
_MOST = 0.02
"""A larger share of jumps among all steps is how the targets move."""
_NAMED = 5
"""Findings of a kind that are named one by one."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something in a recording that does not count as it is: of a track, at a time [s] of the recording's clock.

    `kind` is "outliers", "jump", "gap", "fix" (a single one), "still" or "rounded"; `text` says it, with what keeps it.
    """

    kind: str
    track_id: str
    time_s: float
    text: str


@dataclass(frozen=True, kw_only=True)
class Cleaned:
    """A recording without jumps and outliers, and what was found; `spikes` counts the fixes that were left out."""

    recording: Recording
    findings: tuple[Finding, ...]
    spikes: int


def clean(recording: Recording, max_speed_m_s: float | None = None) -> Cleaned:
    """Leave out wrong fixes, and cut tracks at jumps.

    With `max_speed_m_s` just the steps that are faster are wrong; without, the tracks themselves say what is usual.
    """
    usual, spiky = _usual_speed(recording.tracks), [_spikes(track, max_speed_m_s) for track in recording.tracks]
    rest = [_part(track, ~wrong) for track, wrong in zip(recording.tracks, spiky, strict=True)]
    long = sum(len(_long_steps(track, usual, max_speed_m_s)) for track in rest)
    steps, findings, pieces, jumps = sum(len(track.times_s) - 1 for track in recording.tracks), [], rest, []
    if max_speed_m_s is None and long > max(_MOST * steps, 10):
        text = (
            f"{long} of {steps} steps are more than {_JUMP:g} times as long as usual: taken for motion, as they are "
            "many; --max-speed M/S would cut the tracks there"
        )
        findings = [Finding(kind="jump", track_id="", time_s=recording.start_s, text=text)]
    else:
        pieces = []
        for track, wrong in zip(rest, spiky, strict=True):
            ends, short = _jumps(track, usual, max_speed_m_s)
            wrong[np.flatnonzero(~wrong)[short]] = True
            good = _part(track, ~short)
            pieces += _cut(good, ends)
            jumps += [(good, int(i)) for i in ends]
        findings = _of_jumps(recording, jumps, usual, max_speed_m_s)
    findings = [*_of_outliers(recording, spiky), *findings]
    cleaned = replace(recording, tracks=tuple(pieces))
    return Cleaned(recording=cleaned, findings=tuple(findings), spikes=int(sum(map(np.sum, spiky))))


def _part(track: Track, kept: Bool[np.ndarray, " m"]) -> Track:
    if kept.all():
        return track
    return replace(track, times_s=track.times_s[kept], positions_m=track.positions_m[kept])


def _cut(track: Track, ends: np.ndarray) -> list[Track]:
    """Pieces of a track that end at these fixes; the first keeps its id."""
    if not len(ends):
        return [track]
    bounds = [0, *(ends + 1).tolist(), len(track.times_s)]
    return [
        Track(
            track_id=track.track_id if i == 0 else f"{track.track_id} ({i + 1})",
            times_s=track.times_s[first:end],
            positions_m=track.positions_m[first:end],
        )
        for i, (first, end) in enumerate(pairwise(bounds))
    ]


def _steps(track: Track) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps"]]:
    """Lengths [m] of a track's steps, and their times [s], not below the usual one: noise has no speed."""
    dt = np.diff(track.times_s)
    return np.linalg.norm(np.diff(track.positions_m, axis=0), axis=1), np.maximum(dt, np.median(dt)) if len(dt) else dt


def _usual_speed(tracks: Sequence[Track]) -> float:
    """The median over tracks of their usual speed [m/s]."""
    speeds = [np.percentile(length / dt, USUAL) for length, dt in map(_steps, tracks) if len(dt)]
    return float(np.median(speeds)) if speeds else 0.0


def resolution_m(track: Track) -> float:
    """The step of positions that were rounded: of which all changes of a coordinate are multiples [m]; 0 if of none."""
    changes = np.abs(np.diff(track.positions_m, axis=0)).ravel()
    changes = changes[changes > 1e-6]
    steps = changes / changes.min() if len(changes) else changes
    return float(changes.min()) if len(changes) and (np.abs(steps - np.round(steps)) < 1e-3).all() else 0.0


def _spikes(track: Track, max_speed_m_s: float | None) -> Bool[np.ndarray, " m"]:
    """Fixes that are out and back: both steps far above the median around them, and above the direct step."""
    steps, wrong = np.linalg.norm(np.diff(track.positions_m, axis=0), axis=1), np.zeros(len(track.times_s), bool)
    if len(steps) < 2:
        return wrong
    direct = np.linalg.norm(track.positions_m[2:] - track.positions_m[:-2], axis=1)
    shorter = np.minimum(steps[:-1], steps[1:])
    if max_speed_m_s is not None:
        dt = np.diff(track.times_s)
        wrong[1:-1] = (steps[:-1] > max_speed_m_s * dt[:-1]) & (steps[1:] > max_speed_m_s * dt[1:])
        wrong[1:-1] &= direct <= max_speed_m_s * (dt[:-1] + dt[1:])
        return wrong
    # Reflected at the ends, so that the first and last steps have as many neighbours as the others.
    padded = np.pad(steps, _NEIGHBOURS, mode="reflect")
    typical = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1), axis=1)
    usual_step, resolution = np.maximum(typical[:-1], typical[1:]), resolution_m(track)
    # Where a track seems to stand still it flickers by a unit of rounded positions.
    usual_step = np.maximum(np.where(usual_step < resolution, 2 * resolution, usual_step), MIN_STEP_M)
    wrong[1:-1] = (shorter > _SPIKE_STEPS * usual_step) & (shorter > _SPIKE_DETOUR * direct)
    return wrong


def _jumps(track: Track, usual: float, max_speed_m_s: float | None) -> tuple[np.ndarray, Bool[np.ndarray, " m"]]:
    """Fixes, among those kept, after which the track jumps; and a mask of the fixes in short pieces between jumps."""
    short, ends = np.zeros(len(track.times_s), bool), np.zeros(0, int)
    for _ in range(3):  # what remains after a short piece may be whole, or show another one
        rest = _part(track, ~short)
        ends = _long_steps(rest, usual, max_speed_m_s)
        pieces = np.split(np.flatnonzero(~short), ends + 1)
        dropped = [piece for piece in pieces if len(piece) <= _SHORT]
        if len(dropped) == len(pieces) or not dropped:
            break
        short[np.concatenate(dropped)] = True
    return ends, short


def _long_steps(track: Track, usual: float, max_speed_m_s: float | None) -> np.ndarray:
    """Steps that no target of the track's speed makes, unless there are many in a row."""
    length, dt = _steps(track)
    if not len(dt):
        return np.zeros(0, int)
    if max_speed_m_s is not None:
        return np.flatnonzero(length > max_speed_m_s * np.diff(track.times_s))
    speed = np.percentile(length / dt, USUAL) if len(dt) >= LEAST_STEPS else usual
    resolution = resolution_m(track)
    flicker = 3 * resolution if np.percentile(length, USUAL) < resolution else 0.0
    allowed = _JUMP * max(speed, 0.5 * usual) * dt + max(MIN_STEP_M, flicker)
    long = np.flatnonzero(length > allowed)
    runs = np.split(long, np.flatnonzero(np.diff(long) > 1) + 1)
    alone = [run for run in runs if 0 < len(run) <= _LONGEST_RUN]
    return np.concatenate(alone) if alone else np.zeros(0, int)


def _of_outliers(recording: Recording, left_out: Sequence[np.ndarray]) -> list[Finding]:
    found = []
    for track, wrong in zip(recording.tracks, left_out, strict=True):
        if not wrong.any():
            continue
        time_s = float(track.times_s[np.argmax(wrong)]) + recording.clock_origin_s
        which = "1 fix is" if wrong.sum() == 1 else f"{int(wrong.sum())} fixes are"
        text = f"{track.track_id}: {which} out and back (the first at {time_s:.10g} s): left out; --max-speed inf keeps"
        found.append(Finding(kind="outliers", track_id=track.track_id, time_s=time_s, text=f"{text} them"))
    return found


def _of_jumps(
    recording: Recording, jumps: list[tuple[Track, int]], usual: float, max_speed_m_s: float | None
) -> list[Finding]:
    found = []
    for track, i in jumps:
        length, dt = np.linalg.norm(track.positions_m[i + 1] - track.positions_m[i]), np.diff(track.times_s)[i]
        time_s, speed = float(track.times_s[i + 1]) + recording.clock_origin_s, length / dt
        limit = f"{usual:.2g} m/s is usual" if max_speed_m_s is None else f"--max-speed is {max_speed_m_s:g}"
        text = (
            f"{track.track_id}: jumps by {length:.2g} m at {time_s:.10g} s ({speed:.3g} m/s; {limit}), as where ids "
            f"are switched: counts as a target that leaves and one that comes; --max-speed {1.01 * speed:.3g} keeps it"
        )
        found.append(Finding(kind="jump", track_id=track.track_id, time_s=time_s, text=text))
    return found


def lines_of(findings: Sequence[Finding]) -> list[str]:
    """Findings as text, a line each; of a kind of which there are many, the first few and their number."""
    lines = []
    for kind in dict.fromkeys(finding.kind for finding in findings):
        texts = [finding.text for finding in findings if finding.kind == kind]
        lines += texts[:_NAMED]
        if len(texts) > _NAMED:
            lines.append(f"and {len(texts) - _NAMED} more of this kind (--report lists all)")
    return lines


def prepared(recording: Recording, max_speed_m_s: float | None) -> Recording:
    """The recording without jumps and wrong fixes, which its notes name."""
    cleaned = clean(recording, max_speed_m_s)
    return replace(cleaned.recording, notes=(*recording.notes, *lines_of(cleaned.findings)))
