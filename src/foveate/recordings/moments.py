"""Second moments of recorded motion, without the noise of the fixes: W of a walk, q of a velocity.

Fixes with noise of variance r on each axis add 2 r to the second moment D(h) of a displacement over h, and 9 r / h^3 to
q(h), the intensity that the change of velocity from one pair of fixes to the next shows. Two spacings h and 2 h tell
noise from motion. Of a velocity that persists, q(h) = q + 9 r / h^3: so q = (8 q(2 h) - q(h)) / 7 and
r = 8 h^3 (q(h) - q(2 h)) / 63. Of a random walk, D(h) = w h + 2 r: so r = D(h) - D(2 h) / 2, with the true times
between the fixes of pairs where their clock is irregular.
"""

from collections import defaultdict
from dataclasses import dataclass
from math import log2

import numpy as np
from jaxtyping import Bool, Float

from foveate.recordings.recording import Track
from foveate.recordings.velocities import Velocities, joined, velocities

_TRIM_FACTOR, _TRIM_PERCENTILE = 4.0, 98.0
_MIN_STD = 1e-3  # m per step, or m/s^1.5: below what any tracker resolves
_LEAST_SPACING_S = 0.5  # of pairs for q: at shorter ones the fixes' noise hides all motion
_MIN_RATIO = 1e-4  # of the largest eigenvalue: keeps the inverse exact to 1e-3 in float32
_WALK_PERSISTENCE = 0.3
"""Less correlated displacements are a random walk: a velocity with a memory of three spacings has 0.7."""
_SIGNIFICANT = 3.0
"""Standard errors beyond which a walk's noise is believed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Moments of the motion of a recording's targets, for a step of tau.

    speed_*: |dy| / dt over pairs of fixes [m/s]; the noise of the fixes adds to it for slow targets.
    walk_covariance_m2: process noise W per step of the random walk y' = y + w [m^2]: the second moment of the
        displacement over tau about zero, mean motion included, without the noise of the fixes, symmetric positive
        definite.
    acceleration_intensity: white-noise acceleration intensity q of a constant-velocity model [m^2/s^3], without the
        noise of the fixes; None where no track has three fixes in a row.
    fix_noise_std_m: standard deviation sqrt(r) of the fixes' noise on each axis [m], which two spacings tell from
        motion; None where tracks are too short for two spacings. Of a speed with a memory of few spacings it holds a
        part of the motion, too.
    is_walk: displacements over twice the spacing have no direction to speak of: a random walk, not a velocity.
    persistence: correlation of consecutive velocities, about zero: 1 straight on, 0 random walk or standing still, -1
        back and forth; None as above.
    trimmed_fraction: share of the pairs left out of the moments.
    """

    speed_median_m_s: float
    speed_p95_m_s: float
    walk_covariance_m2: Float[np.ndarray, "d d"]
    acceleration_intensity: Float[np.ndarray, "d d"] | None
    fix_noise_std_m: float | None
    persistence: float | None
    is_walk: bool
    trimmed_fraction: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Group:
    """What tracks of one clock say: q [m^2/s^3], r [m^2], whether they walk, and their time [s]."""

    pairs: Velocities
    q: Float[np.ndarray, "d d"] | None
    r: float | None
    is_walk: bool
    time_s: float


def fit_moments(tracks: list[Track], tau_s: float, gap_s: float) -> Moments | None:
    """Moments of all tracks, those of similar clocks together; None where no pair of fixes is near enough."""
    by_clock: dict[int, list[Track]] = defaultdict(list)
    for track in tracks:
        if len(track.times_s) > 1:
            by_clock[round(log2(max(tau_s, float(np.median(np.diff(track.times_s))))))].append(track)
    groups = [group for each in by_clock.values() if (group := _group(each, tau_s, gap_s)) is not None]
    if not groups:
        return None
    pairs = joined([group.pairs for group in groups])
    speed = np.linalg.norm(pairs.velocity, axis=1)
    usual = _usual(speed)
    persistence, _ = _turning(pairs, usual)
    known = [group for group in groups if group.q is not None]
    q = np.asarray(_weighted([group.q for group in known], known)) if known else None
    noisy = [group for group in groups if group.r is not None]
    r = float(_weighted([group.r for group in noisy], noisy)) if noisy else None
    walking = sum(group.time_s for group in groups if group.is_walk)
    return Moments(
        speed_median_m_s=float(np.median(speed[usual])),
        speed_p95_m_s=float(np.percentile(speed[usual], 95.0)),
        walk_covariance_m2=_walk_covariance(pairs, usual, persistence or 0.0, tau_s, r or 0.0),
        acceleration_intensity=None if q is None else _bounded(q),
        fix_noise_std_m=None if r is None else r**0.5,
        persistence=persistence,
        is_walk=walking > 0.5 * sum(group.time_s for group in groups),
        trimmed_fraction=1.0 - float(usual.mean()),
    )


def _weighted(values: list, groups: list[_Group]) -> np.ndarray | np.floating:
    return np.average(np.array(values), axis=0, weights=[group.time_s for group in groups])


def _group(tracks: list[Track], tau_s: float, gap_s: float) -> _Group | None:
    """Moments of tracks whose clocks are alike."""
    interval_s = float(np.median(np.concatenate([np.diff(track.times_s) for track in tracks])))
    spacing_s = max(tau_s, interval_s)
    pairs = velocities(tracks, spacing_s, gap_s)
    if not len(pairs.dt):
        return None
    q, r, is_walk = _without_noise(tracks, max(spacing_s, _LEAST_SPACING_S), gap_s)
    return _Group(pairs=pairs, q=q, r=r, is_walk=is_walk, time_s=float(pairs.weight.sum()))


def _usual(size: Float[np.ndarray, " pairs"]) -> Bool[np.ndarray, " pairs"]:
    """Mask of the pairs that are not outliers by their size (see the top of `motion`)."""
    return size <= _TRIM_FACTOR * np.percentile(size, _TRIM_PERCENTILE)


def _walk_covariance(
    pairs: Velocities, usual: Bool[np.ndarray, " pairs"], persistence: float, tau_s: float, r: float
) -> Float[np.ndarray, "d d"]:
    """W: mean of dy dy^T over pairs of fixes, each dy scaled from their span dt to one tau by (tau / dt)^(a/2).

    The second moment grows with time to the power a = 1 + log2(1 + max(persistence, 0)): 1 for a random walk, 2 for
    straight motion. It matters only where the fixes are further apart than tau. Their noise is taken off.
    """
    exponent = 1.0 + log2(1.0 + max(persistence, 0.0))
    scale, weight = (tau_s / pairs.dt) ** (exponent / 2.0), pairs.weight[usual]
    steps = pairs.velocity * (pairs.dt * scale)[:, None]
    noise = 2.0 * r * np.average(scale[usual] ** 2, weights=weight)
    return _bounded(_second_moment(steps[usual], weight) - noise * np.eye(steps.shape[1]))


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
    v, w, weight = pairs.velocity[first], pairs.velocity[second], pairs.weight[first]
    power = np.sqrt(np.sum(weight @ v**2) * np.sum(weight @ w**2))
    persistence = float(np.sum(weight @ (v * w)) / power) if power > 0 else 0.0
    change = (w - v) * np.sqrt(3.0 / (pairs.dt[first] + pairs.dt[second]))[:, None]
    kept = _usual(np.linalg.norm(change, axis=1))
    return persistence, _bounded(_second_moment(change[kept], weight[kept]))


def _without_noise(
    tracks: list[Track], spacing_s: float, gap_s: float
) -> tuple[Float[np.ndarray, "d d"] | None, float | None, bool]:
    """q without the fixes' noise, its variance r [m^2], and whether it is a walk (see the top of the module).

    None for q and r where no track is long enough, for r where none is for 2 h.
    """
    persistence, found, moments, spans, times_s = None, [], [], [], 0.0
    for spacing in (spacing_s, 2.0 * spacing_s):
        pairs = velocities(tracks, spacing, gap_s)
        usual = _usual(np.linalg.norm(pairs.velocity, axis=1)) if len(pairs.dt) else np.zeros(0, bool)
        persistence, q = _turning(pairs, usual)
        found.append(q)
        moves = (pairs.velocity * pairs.dt[:, None])[usual]
        moments.append(_second_moment(moves, pairs.weight[usual]) if usual.any() else None)
        spans.append(np.average(pairs.dt[usual], weights=pairs.weight[usual]) if usual.any() else 0.0)
        times_s = times_s or float(pairs.weight.sum())
    (at_h, at_2h), (D_h, D_2h) = found, moments
    if at_h is None or at_2h is None or persistence is None:
        return at_h, None, False
    d = len(at_h)
    if persistence < _WALK_PERSISTENCE:
        share = spans[0] / (spans[1] - spans[0])  # 1 by a regular clock
        r = 0.5 * float(np.trace(D_h - share * (D_2h - D_h))) / d
        error = 1.5 * float(np.trace(D_h)) / d * np.sqrt(2.0 * spacing_s / (d * times_s))
        return at_h, r if r > _SIGNIFICANT * error else 0.0, True
    r = 8.0 / 63.0 * spacing_s**3 * float(np.trace(at_h - at_2h)) / d
    if r <= 0:  # no noise to be seen: rather the spacing that counts more pairs
        return at_h, 0.0, False
    return _bounded((8.0 * at_2h - at_h) / 7.0), r, False


def _second_moment(
    samples: Float[np.ndarray, "samples d"], weight: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "d d"]:
    """Weighted mean of s s^T."""
    return (samples * (weight / weight.sum())[:, None]).T @ samples


def _bounded(moment: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "d d"]:
    """A second moment with its eigenvalues bounded from below: symmetric and safe to invert."""
    values, axes = np.linalg.eigh(moment)
    values = np.maximum(values, max(_MIN_STD**2, _MIN_RATIO * values[-1]))
    moment = (axes * values) @ axes.T
    return (moment + moment.T) / 2.0
