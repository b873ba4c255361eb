"""Random observations in the plane and in space, as plain arrays and as a policy sees them."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from foveate.experiment.presets import QUADROTOR
from foveate.models.robot import Robot
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Observation

SCENARIOS = {"plane": Scenario(), "space": QUADROTOR}


def scene(dimension, n, seed=0, reach_m=5.0):
    """Rotation and place of the agent; states, information matrices and known inputs of the targets."""
    rng = np.random.default_rng(seed)
    n_y = 2 if dimension == 2 else 6
    root = rng.normal(size=(n, n_y, n_y))
    turn = rotation([0, 0, 2.2] if dimension == 2 else [0.3, -0.8, 1.9], dimension)
    information = root @ np.swapaxes(root, 1, 2) + np.eye(n_y)
    return (
        turn,
        rng.normal(size=dimension),
        reach_m * rng.normal(size=(n, n_y)),
        information,
        rng.normal(size=(n, dimension)),
    )


def rotation(vector, dimension):
    """Matrix of a rotation vector [rad], cut to the plane."""
    return Rotation.from_rotvec(vector).as_matrix()[:dimension, :dimension]


def seen(scenario, turn, place, mean, information, known_input, present=None, left=7):
    """The observation of a scene in a scenario."""
    if len(place) == 2:
        pose = np.array([*place, np.arctan2(turn[1, 0], turn[0, 0])])
    else:
        pose = np.block([[turn, place[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    present = np.ones(len(mean), bool) if present is None else present
    arrays = (0, left, pose, mean, information, present, known_input)
    return Observation(*map(jnp.asarray, arrays), Robot.of(scenario.problem()))


def moved(turn, place, mean, information, known_input):
    """The same scene with the world's origin and axes elsewhere."""
    d, n_y = len(place), mean.shape[1]
    other = rotation([0, 0, -0.9] if d == 2 else [1.1, 0.4, -0.6], d)
    whole, shift = np.kron(np.eye(n_y // d), other), np.arange(1.0, d + 1)
    states = mean @ whole.T + np.concatenate([shift, np.zeros(n_y - d)])
    return other @ turn, other @ place + shift, states, whole @ information @ whole.T, known_input @ other.T
