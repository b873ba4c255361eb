"""Recordings made in memory."""

import numpy as np

from foveate.recordings.recording import Recording, Track

DEPTH, ANGLE, TAU = 6.0, 90.0, 0.5
"""View [m], [deg] and step [s] of the scenario in tests/recordings/conftest.py."""


def track(times, positions, track_id="a") -> Track:
    return Track(track_id=track_id, times_s=np.asarray(times, float), positions_m=np.asarray(positions, float))


def recording(*tracks: Track) -> Recording:
    return Recording(name="made up", dimension=tracks[0].positions_m.shape[1], tracks=tracks)


def walk(rng, times, covariance_per_s, start: float | np.ndarray = 0.0) -> np.ndarray:
    """A random walk whose displacement over dt has covariance dt * covariance_per_s."""
    root = np.linalg.cholesky(covariance_per_s)
    steps = rng.standard_normal((len(times) - 1, len(root))) @ root.T * np.sqrt(np.diff(times))[:, None]
    return start + np.concatenate([np.zeros((1, len(root))), np.cumsum(steps, axis=0)])
