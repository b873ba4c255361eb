"""Single decisions: observations with beliefs of given information, the command of a policy, and what it steers to."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from foveate.simulation.records import Observation


def seen(pose, mean, log_dets, present, left=9):
    """Predicted beliefs about positions whose information matrices have the given log determinants."""
    information = np.exp(np.asarray(log_dets, float) / 2)[:, None, None] * np.array([[1.25, 0.5], [0.5, 1.0]])
    inputs = jnp.zeros((len(mean), 2))
    return Observation(
        *map(jnp.asarray, (0, left, np.array(pose, float), np.array(mean, float), information, present)), inputs
    )


@eqx.filter_jit
def decide(policy, observation, key):
    """The action of a first decision, and its command [m/s, rad/s]."""
    action, _ = policy(observation, policy.start(observation), key)
    return action, policy.problem.agent.control(action)


def bearing_to(pose, point):
    """Angle from the heading to a point in the plane [rad], in [-pi, pi)."""
    bearing = np.arctan2(*(np.asarray(point) - pose[:2])[::-1]) - pose[2]
    return (bearing + np.pi) % (2 * np.pi) - np.pi


def steered_to(control, pose, goal):
    """True if a command turns the shorter way to `goal`, as far as it can, and does not drive away from it."""
    bearing = bearing_to(pose, goal)
    turns = np.isclose(control[1], np.clip(bearing, -np.pi / 3, np.pi / 3), atol=1e-9)
    return bool(turns and (abs(bearing) < np.pi / 2 or control[0] == 0))
