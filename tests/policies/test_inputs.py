"""Features of a policy against scipy's rotations."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from foveate.geometry.space import SPACES
from foveate.policies import inputs
from foveate.simulation.records import Observation

policy_inputs = eqx.filter_jit(inputs.policy_inputs)
RNG = np.random.default_rng(0)


def seen(pose, mean, information, present):
    arrays = (pose, mean, information, present)
    pose, mean, information, present = (jnp.asarray(x) for x in arrays)
    return Observation(jnp.asarray(0), jnp.asarray(9), pose, mean, information, present, jnp.zeros((len(mean), 2)))


@pytest.mark.parametrize("n_y", [3, 6, 9])
def test_inputs_in_space(n_y):
    """Body frame: every vector of a state, and both sides of its information matrix, turned by scipy's rotation."""
    turn = Rotation.from_rotvec([0.3, -0.8, 1.9])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), [1.0, -2.0, 0.5]
    mean, root = RNG.normal(size=(4, n_y)), RNG.normal(size=(4, n_y, n_y))
    information = root @ np.swapaxes(root, 1, 2)
    observation = seen(T, mean, information, np.ones(4, bool))
    pose_body, features = policy_inputs(observation, SPACES["spatial"], "body", length_m=2.0)
    np.testing.assert_array_equal(pose_body, np.zeros(6))
    whole = np.kron(np.eye(n_y // 3), T[:3, :3])
    for row, p, P in zip(np.asarray(features), mean, information, strict=True):
        vectors = p.reshape(-1, 3) - np.eye(n_y // 3, 1) * T[:3, 3]
        np.testing.assert_allclose(row[:n_y], turn.inv().apply(vectors).ravel() / 2.0, atol=1e-12)
        np.testing.assert_allclose(row[n_y:], (whole.T @ P @ whole)[np.tril_indices(n_y)], atol=1e-12)
    pose_world, _ = policy_inputs(observation, SPACES["spatial"], "world")
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = np.cross(np.eye(3), np.asarray(pose_world[3:])), pose_world[:3]
    np.testing.assert_allclose(expm(twist), T, atol=1e-12)
