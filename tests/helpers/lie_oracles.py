"""Samples of the Lie groups, and oracles for them: `scipy.linalg.expm` and its Frechet derivatives."""

from functools import partial

import jax
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

# Zero, the small angles where a difference of nearly equal numbers shows, both sides of the switches (1 rad; 2 rad in
# the plane, where half the angle counts; in the logarithm sin(angle / 2) = 0.1, and pi / 2, where about an axis of
# coordinates another row of Shepperd's takes over), and both sides of pi.
SWITCHES = [angle + side for angle in (2 * np.arcsin(0.1), 1.0, np.pi / 2, 2.0) for side in (-1e-6, 1e-6)]
NEAR_PI = [np.pi - 10.0**e for e in range(-3, -8, -1)]
ANGLES = [0.0, 1e-12, 1e-10, *(10.0**e for e in range(-8, 0)), 3e-3, 0.5, *SWITCHES, 2.7, 3.1, *NEAR_PI]
BEYOND_PI = [np.pi, np.pi + 1e-6, 4.0, 6.2]
AXES = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0], [0.6, -0.48, 0.64], [-0.1, 0.02, 0.99]])
AXES = AXES / np.linalg.norm(AXES, axis=1, keepdims=True)
VELOCITIES = np.array([[1.0, -0.7, 0.4], [0.0, 0.0, 0.0], [0.3, 2.0, -1.1]])

ROTATIONS = np.array([angle * axis for angle in ANGLES for axis in AXES])
TWISTS = np.concatenate([np.resize(VELOCITIES, ROTATIONS.shape), ROTATIONS], axis=1)
FAR_TWISTS = np.array([[*VELOCITIES[i % 3], *(a * n)] for a in BEYOND_PI for i, n in enumerate(AXES)])
PLANAR_TWISTS = np.array(
    [[*v[:2], sign * angle] for angle in (*ANGLES, *BEYOND_PI) for v in VELOCITIES for sign in (1.0, -1.0)]
)
POSES = np.array([[1.0, -2.0, 0.3], [-0.5, 4.0, -2.9], [3.0, 0.2, 11.0], [0.0, 0.0, 0.0]])

# Of the largest entry. 1e-10 and 1e-5 would do; the code is better, and a lost digit should not pass unseen.
PRECISIONS = pytest.mark.parametrize(
    ("dtype", "tolerance"), [(np.float64, 1e-13), (np.float32, 1e-6)], ids=["float64", "float32"]
)


# Large graphs that run once cost 40 % less, compiled without optimisation.
jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})

# The matrices of the unit twists, e_i cross e_j in column j.
SO3 = np.array([np.cross(axis, np.eye(3)).T for axis in np.eye(3)])
SE3 = np.zeros((6, 4, 4))
SE3[[0, 1, 2], [0, 1, 2], 3], SE3[3:, :3, :3] = 1.0, SO3
SE2 = SE3[np.ix_([0, 1, 5], [0, 1, 3], [0, 1, 3])]


def hat(generators, twists):
    return np.einsum("...i,iab->...ab", twists, generators)


def matrix_2d(pose):
    matrix = np.eye(3)
    matrix[:2, :2] = Rotation.from_euler("z", pose[2]).as_matrix()[:2, :2]
    matrix[:2, 2] = pose[:2]
    return matrix


def derivative(generators, twists):
    """d expm(hat) / d twist, the twist's axis last: expm [[X, E], [0, X]] has it in its corner."""
    x, e = np.broadcast_arrays(hat(generators, twists)[:, None], generators)
    corner = expm(np.block([[x, e], [np.zeros_like(x), x]]))[..., : x.shape[-1], x.shape[-1] :]
    return np.moveaxis(corner, 1, -1)


def second_derivative(generators, twists):
    """d2 expm(hat) / d twist2, read off a block matrix in the same way (Higham and Relton 2014)."""
    x, a, b = np.broadcast_arrays(hat(generators, twists)[:, None, None], generators[:, None], generators[None, :])
    o = np.zeros_like(x)
    corner = expm(np.block([[x, a, b, o], [o, x, o, b], [o, o, x, a], [o, o, o, x]]))
    return np.moveaxis(corner[..., : x.shape[-1], -x.shape[-1] :], (1, 2), (-2, -1))


def assert_near(actual, expected, tolerance):
    """Every sample's largest error, in parts of the sample's largest entry (at least 1)."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    each = tuple(range(1, expected.ndim))
    error = np.abs(actual - expected).max(axis=each) / np.maximum(np.abs(expected).max(axis=each), 1.0)
    assert np.all(error <= tolerance), f"sample {np.nanargmax(error)}: {error.max():.1e} > {tolerance:.0e}"


def with_jacobians(function, samples):
    """The values and the Jacobians of the reverse and the forward mode, compiled as users compile them."""

    def batched(sample):
        return function(sample), jax.jacrev(function)(sample), jax.jacfwd(function)(sample)

    results = [np.asarray(result) for result in jax.jit(jax.vmap(batched))(samples)]
    assert all(result.dtype == samples.dtype for result in results)
    return results[0], results[1:]
