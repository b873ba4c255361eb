"""Statistics of the targets of a recording: number, speed, lifetime, and the parameters of motion models.

Motion is estimated from pairs of real fixes (see `velocities`), not from interpolated positions: interpolation would
smooth a random walk, and make its displacement over one tau too small by up to the factor tau / fix interval.

Outliers are treated in three ways. (1) A fix that is *out and back* is left out (see `without_spikes`). (2) Pairs
faster than 4 times the 98th percentile of all are left out of the moments: a Gaussian walk never comes near that
limit, and up to 2 % of wrong pairs are removed wherever they lie. The limit is not a multiple of the median (MAD):
targets that stand still most of the time have a median of zero, and their motion must not be cut off. (3) Percentiles
are reported beside the extremes.
"""

from dataclasses import dataclass
from math import log2

import numpy as np
from jaxtyping import Bool, Float

from foveate.errors import InputError
from foveate.recordings.recording import Recording, resample
from foveate.recordings.velocities import Velocities, velocities, without_spikes

_TRIM_FACTOR, _TRIM_PERCENTILE = 4.0, 98.0
_MIN_STD = 1e-3  # m per step, or m/s^1.5: below what any tracker resolves
_MIN_RATIO = 1e-4  # of the largest eigenvalue: keeps the inverse exact to 1e-3 in float32


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionStatistics:
    """Motion statistics of a recording at the control step `tau_s`; positions in metres, times in seconds.

    at_once_*: targets present at one instant, over the instants with any (a share `occupied_fraction` of the span).
    extent_*, robust_*: box around all fixes, and from the 1st to the 99th percentile of each coordinate.
    speed_*: |dy| / dt over pairs of fixes [m/s]; the noise of the fixes adds to it for slow targets.
    walk_covariance_m2: process noise W per step of the random walk y' = y + w [m^2]: the second moment of the
        displacement over tau about zero, mean motion included, symmetric positive definite. Fixes with noise of
        variance r per axis add 2 r to its diagonal.
    acceleration_intensity: white-noise acceleration intensity q of a constant-velocity model [m^2/s^3]; None where no
        track has three fixes in a row. Fixes with noise of variance r per axis add 9 r / h^3, h the time between fixes
        of a pair, which dominates at short h: an upper bound, to be trusted where a longer tau gives the same.
    persistence: correlation of consecutive velocities, about zero: 1 straight on, 0 random walk or standing still, -1
        back and forth; None as above.
    lifetime_s, lifetime_steps: median time from first to last fix of a track, and in steps of tau.
    fix_interval_s: median time between consecutive fixes of a track.
    spikes, trimmed_fraction: fixes left out as outliers, and the share of pairs left out of the moments.
    """

    tau_s: float
    max_gap_s: float
    tracks: int
    span_s: float
    occupied_fraction: float
    at_once_min: int
    at_once_median: float
    at_once_p95: float
    at_once_max: int
    extent_lower_m: Float[np.ndarray, " d"]
    extent_upper_m: Float[np.ndarray, " d"]
    robust_lower_m: Float[np.ndarray, " d"]
    robust_upper_m: Float[np.ndarray, " d"]
    speed_median_m_s: float
    speed_p95_m_s: float
    walk_covariance_m2: Float[np.ndarray, "d d"]
    acceleration_intensity: Float[np.ndarray, "d d"] | None
    persistence: float | None
    lifetime_s: float
    lifetime_steps: int
    fix_interval_s: float
    spikes: int
    trimmed_fraction: float

    def lines(self) -> list[str]:
        """Readable summary, line by line."""
        sides = zip(self.robust_lower_m, self.robust_upper_m, strict=True)
        extent = " x ".join(f"{lower:.1f}..{upper:.1f}" for lower, upper in sides)
        walk = " x ".join(f"{std:.2f}" for std in np.sqrt(np.diag(self.walk_covariance_m2)))
        at_once = f"{self.at_once_min} to {self.at_once_max}, median {self.at_once_median:g}"
        summary = [
            f"{self.tracks} tracks in {self.span_s:.0f} s; at once {at_once}",
            f"extent {extent} m (98 % of fixes)",
            f"speed median {self.speed_median_m_s:.2f}, 95th percentile {self.speed_p95_m_s:.2f} m/s",
            f"random walk: {walk} m (std) per step of {self.tau_s:g} s",
        ]
        if self.acceleration_intensity is not None:
            q = " x ".join(f"{x:.3g}" for x in np.diag(self.acceleration_intensity))
            direction = f"persistence of direction {self.persistence:.2f}"
            summary.append(f"constant velocity (estimate): q = {q} m^2/s^3, {direction}")
        return summary


def fit_statistics(recording: Recording, tau_s: float, max_gap_s: float | None = None) -> MotionStatistics:
    """Estimate the motion of a recording's targets for a control step of `tau_s`.

    `max_gap_s` is the longest gap between two fixes over which a target counts as present, and no pair of fixes spans a
    longer one; None takes `default_max_gap_s`. Pairs are about max(tau, median fix interval) apart.
    """
    interval_s = median_fix_interval_s(recording)
    gap_s = default_max_gap_s(recording) if max_gap_s is None else max_gap_s
    count = resample(recording, tau_s, gap_s).present.sum(axis=1)
    # A short recording may hold its only target between two instants.
    occupied = count[count > 0] if count.any() else np.ones(1, dtype=int)
    kept, spacing_s = [without_spikes(track) for track in recording.tracks], max(tau_s, interval_s)
    pairs = velocities(kept, spacing_s, gap_s)
    if not len(pairs.dt):
        raise InputError(
            f"{recording.name}: no track has two fixes about {spacing_s:g} s apart without a gap over {gap_s:g} s; "
            f"the median fix interval is {interval_s:g} s: choose max_gap_s above it"
        )
    positions = np.concatenate([track.positions_m for track in kept])
    lower, upper = recording.extent
    life_s = float(np.median([track.times_s[-1] - track.times_s[0] for track in recording.tracks]))
    speed = np.linalg.norm(pairs.velocity, axis=1)
    usual = _usual(speed)
    persistence, acceleration = _turning(pairs, usual)
    robust_lower, robust_upper = np.percentile(positions, [1.0, 99.0], axis=0)
    return MotionStatistics(
        tau_s=tau_s,
        max_gap_s=gap_s,
        tracks=len(recording.tracks),
        span_s=recording.end_s - recording.start_s,
        occupied_fraction=float(np.mean(count > 0)),
        at_once_min=int(occupied.min()),
        at_once_median=float(np.median(occupied)),
        at_once_p95=float(np.percentile(occupied, 95.0)),
        at_once_max=int(occupied.max()),
        extent_lower_m=lower,
        extent_upper_m=upper,
        robust_lower_m=robust_lower,
        robust_upper_m=robust_upper,
        speed_median_m_s=float(np.median(speed[usual])),
        speed_p95_m_s=float(np.percentile(speed[usual], 95.0)),
        walk_covariance_m2=_walk_covariance(pairs, usual, persistence or 0.0, tau_s),
        acceleration_intensity=acceleration,
        persistence=persistence,
        lifetime_s=life_s,
        lifetime_steps=round(life_s / tau_s),
        fix_interval_s=interval_s,
        spikes=sum(len(track.times_s) for track in recording.tracks) - len(positions),
        trimmed_fraction=1.0 - float(usual.mean()),
    )


def median_fix_interval_s(recording: Recording) -> float:
    """Median time between consecutive fixes of a track [s]; InputError where no track has two."""
    intervals = np.concatenate([np.diff(track.times_s) for track in recording.tracks])
    if not len(intervals):
        raise InputError(f"{recording.name}: no track has two fixes; nothing can be said about motion")
    return float(np.median(intervals))


def default_max_gap_s(recording: Recording) -> float:
    """Default of the longest gap without absence [s]: 2 s, or three median fix intervals (ships, animals)."""
    return max(2.0, 3.0 * median_fix_interval_s(recording))


def _usual(size: Float[np.ndarray, " pairs"]) -> Bool[np.ndarray, " pairs"]:
    """Mask of the pairs that are not outliers by their size (see the top of the module)."""
    return size <= _TRIM_FACTOR * np.percentile(size, _TRIM_PERCENTILE)


def _walk_covariance(
    pairs: Velocities, usual: Bool[np.ndarray, " pairs"], persistence: float, tau_s: float
) -> Float[np.ndarray, "d d"]:
    """W: mean of dy dy^T over pairs of fixes, each dy scaled from their span dt to one tau by (tau / dt)^(a/2).

    The second moment grows with time to the power a = 1 + log2(1 + max(persistence, 0)): 1 for a random walk, 2 for
    straight motion. It matters only where the fixes are further apart than tau.
    """
    exponent = 1.0 + log2(1.0 + max(persistence, 0.0))
    steps = pairs.velocity * (pairs.dt * (tau_s / pairs.dt) ** (exponent / 2.0))[:, None]
    return _second_moment(steps[usual])


def _turning(
    pairs: Velocities, usual: Bool[np.ndarray, " pairs"]
) -> tuple[float | None, Float[np.ndarray, "d d"] | None]:
    """Persistence and white-noise acceleration intensity q, from consecutive pairs; None without any.

    For a velocity driven by white noise, two consecutive mean velocities over h1 and h2 differ by noise of covariance
    q (h1 + h2) / 3, so q is the mean of 3 dv dv^T / (h1 + h2).
    """
    first, second = pairs.turns[usual[pairs.turns].all(axis=1)].T
    if not len(first):
        return None, None
    # About zero, not about their means: a common drift is persistent, too.
    v, w = pairs.velocity[first], pairs.velocity[second]
    power = np.sqrt(np.sum(v**2) * np.sum(w**2))
    persistence = float(np.sum(v * w) / power) if power > 0 else 0.0
    change = (w - v) * np.sqrt(3.0 / (pairs.dt[first] + pairs.dt[second]))[:, None]
    return persistence, _second_moment(change[_usual(np.linalg.norm(change, axis=1))])


def _second_moment(samples: Float[np.ndarray, "samples d"]) -> Float[np.ndarray, "d d"]:
    """Mean of s s^T, with its eigenvalues bounded from below: symmetric and safe to invert."""
    values, axes = np.linalg.eigh(samples.T @ samples / len(samples))
    values = np.maximum(values, max(_MIN_STD**2, _MIN_RATIO * values[-1]))
    moment = (axes * values) @ axes.T
    return (moment + moment.T) / 2.0
