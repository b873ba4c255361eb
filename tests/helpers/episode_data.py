"""Data of episodes that no simulation made, for the tests of pictures."""

import numpy as np
from scipy.spatial.transform import Rotation

from foveate.geometry.space import SPACES
from foveate.plotting.episode_data import EpisodeData

TRIANGLE = np.array([[0.0, 0.0], [2.0, -3.0], [2.0, 3.0], [0.0, 0.0]])
SQUARE = np.array([[2.0, -1, -1], [2, 1, -1], [2, 1, 1], [2, -1, 1], [2, -1, -1]])
PYRAMID = (SQUARE, *(np.array([[0.0, 0, 0], corner]) for corner in SQUARE[:4]))


def random_episode(steps=4, n=3, seed=0, **changes) -> EpisodeData:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(steps + 1, n, 2, 2))
    truth = rng.uniform(-8, 8, (n, 2)) + rng.normal(0, 0.3, (steps + 1, n, 2)).cumsum(axis=0)
    values = {
        "title": "made up",
        "space": SPACES["planar"],
        "visible": rng.random((steps, n)) < 0.4,
        "log_det": rng.normal(3, 2, (steps, n)),
        "times_s": 0.5 * np.arange(steps + 1),
        "pose": rng.normal(0, [0.8, 0.8, 0.5], (steps + 1, 3)).cumsum(axis=0),
        "truth": truth,
        "estimate": truth + rng.normal(0, 0.4, (steps + 1, n, 2)),
        "covariance": root @ root.swapaxes(-1, -2) + 0.1 * np.eye(2),
        "present": np.ones((steps + 1, n), bool),
        "outline": (TRIANGLE,),
    }
    return EpisodeData(**{**values, **changes})


def late_sightings(dimension=2, steps=4, n=3, **changes):
    """An episode whose beliefs are wide until, from the third instant on, all are seen; of made-up numbers."""
    rng, d = np.random.default_rng(5), dimension
    pose = np.cumsum(np.tile([0.8, 0.3, 0.2], (steps + 1, 1)), axis=0)
    if d == 3:
        turn = Rotation.from_euler("z", pose[:, 2:]).as_matrix()
        position, pose = (
            np.pad(pose[:, :2], ((0, 0), (0, 1)), constant_values=1.0),
            np.tile(np.eye(4), (steps + 1, 1, 1)),
        )
        pose[:, :3, :3], pose[:, :3, 3] = turn, position
    truth = rng.uniform(-6, 6, (n, d)) + rng.normal(0, 0.1, (steps + 1, n, d)).cumsum(axis=0)
    root = rng.normal(size=(n, d, d))
    wide = root @ root.swapaxes(-1, -2) + np.eye(d)
    late = np.arange(steps + 1) >= 2
    values = {
        "title": "made up",
        "space": SPACES["planar" if d == 2 else "spatial"],
        "visible": np.tile(late[1:, None], (1, n)),
        "log_det": np.where(late[1:, None], 6.0, -1.0) + np.arange(n),
        "times_s": 0.5 * np.arange(steps + 1),
        "pose": pose,
        "truth": truth,
        "estimate": truth + 0.1,
        "covariance": np.where(late[:, None, None, None], 0.02, 1.0) * wide,
        "present": np.ones((steps + 1, n), bool),
        "outline": (TRIANGLE,) if d == 2 else PYRAMID,
    }
    return EpisodeData(**{**values, **changes})
