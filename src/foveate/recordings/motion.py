"""Statistics of the targets of a recording: number, speed, lifetime, and the parameters of motion models.

Motion is estimated from pairs of real fixes (see `velocities`), not from interpolated positions: interpolation would
smooth a random walk, and make its displacement over one tau too small by up to the factor tau / fix interval.

Outliers are treated in three ways. (1) Wrong fixes are left out, and tracks are cut at jumps (see `outliers`). (2)
Pairs faster than 4 times the 98th percentile of all are left out of the moments: a Gaussian walk never comes near that
limit, and up to 2 % of wrong pairs are removed wherever they lie. The limit is not a multiple of the median (MAD):
targets that stand still most of the time have a median of zero, and their motion must not be cut off. (3) Percentiles
are reported beside the extremes.

Tracks of different clocks are paired at spacings of their own, and count by their time: not the fastest clock most.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from foveate.errors import InputError
from foveate.recordings.moments import Moments, fit_moments
from foveate.recordings.outliers import Finding, clean, lines_of
from foveate.recordings.recording import Recording, resample
from foveate.recordings.unused import unused


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionStatistics(Moments):
    """Motion statistics of a recording at the control step `tau_s`, beside the moments; positions [m], times [s].

    at_once_*: targets present at one instant, over the instants with any (a share `occupied_fraction` of the span).
    extent_*, robust_*: box around all fixes, and from the 1st to the 99th percentile of each coordinate.
    lifetime_s, lifetime_steps: median time from first to last fix of a track, and in steps of tau.
    fix_interval_s: median time between consecutive fixes of a track.
    spikes: fixes left out as outliers.
    findings: what does not count as it is in the recording: outliers, jumps, gaps, tracks that say nothing.
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
    lifetime_s: float
    lifetime_steps: int
    fix_interval_s: float
    spikes: int
    findings: tuple[Finding, ...]

    @property
    def mean_square_speed_m2_s2(self) -> float:
        """Mean square of the displacement over tau, by tau^2: that of the speed in the simulated motion [m^2/s^2]."""
        return float(np.trace(self.walk_covariance_m2)) / self.tau_s**2

    @property
    def crossing_s(self) -> float:
        """Time that a target takes from end to end of the box of 98 % of the fixes, at the rms speed [s]."""
        return float(np.max(self.robust_upper_m - self.robust_lower_m)) / self.mean_square_speed_m2_s2**0.5

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
        if self.fix_noise_std_m is not None:
            summary.append(f"noise of the fixes (estimate): {self.fix_noise_std_m:.2g} m (std) on each axis")
        return [*summary, *lines_of(self.findings)]


def fit_statistics(
    recording: Recording, tau_s: float, max_gap_s: float | None = None, max_speed_m_s: float | None = None
) -> MotionStatistics:
    """Estimate the motion of a recording's targets for a control step of `tau_s`.

    `max_gap_s` is the longest gap between two fixes over which a target counts as present, and no pair of fixes spans a
    longer one; None takes `default_max_gap_s`. Pairs are about max(tau, median fix interval of the track) apart.
    `max_speed_m_s` as for `clean`.
    """
    interval_s = median_fix_interval_s(recording)
    gap_s = default_max_gap_s(recording) if max_gap_s is None else max_gap_s
    cleaned = clean(recording, max_speed_m_s)
    kept = list(cleaned.recording.tracks)
    count = resample(cleaned.recording, tau_s, gap_s).present.sum(axis=1)
    occupied = count[count > 0] if count.any() else np.ones(1, dtype=int)  # the only target may be between two instants
    found = fit_moments(kept, tau_s, gap_s)
    if found is None:
        raise InputError(
            f"{recording.name}: no track has two fixes about {max(tau_s, interval_s):g} s apart without a gap over "
            f"{gap_s:g} s; the median fix interval is {interval_s:g} s: choose max_gap_s above it"
        )
    positions = np.concatenate([track.positions_m for track in kept])
    lower, upper = recording.extent
    life_s = float(np.median([track.times_s[-1] - track.times_s[0] for track in recording.tracks]))
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
        lifetime_s=life_s,
        lifetime_steps=round(life_s / tau_s),
        fix_interval_s=interval_s,
        spikes=cleaned.spikes,
        findings=(*cleaned.findings, *unused(recording, gap_s, found.fix_noise_std_m or 0.0)),
        **vars(found),
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
