"""What the filter itself expects of GOSPA (p = 2, alpha = 2), and the tracks that it therefore reports."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry.linalg import multiply
from foveate.models.detections.records import DetectionModel, Tracks
from foveate.models.problem import Problem
from foveate.types import Scalar


def position_loss(square: Float[Array, "*b"], cutoff: Scalar) -> Float[Array, "*b"]:
    """E min(d^2, c^2) / c^2 of a distance d [m] with this mean square [m^2], in [0, 1], at the cutoff c [m].

    Exact of Gaussian errors in the plane, alike on both axes.
    """
    square = jnp.maximum(square / cutoff**2, 1e-6)
    return -square * jnp.expm1(-1.0 / square)  # 1 - exp(-x) would be rounded to 0 for a belief as wide as float32 goes


def confirmed(problem: Problem, model: DetectionModel, tracks: Tracks) -> Bool[Array, " n"]:
    """True for the tracks that are reported: r (1 - E min(d^2, c^2) / c^2) > `confirm`.

    With r = 1 the track must be well located, at d = 0 it must exist. At 1/2 this minimises the expected GOSPA: a
    reported track costs (1 - r) c^2 / 2 + r E min(d^2, c^2), one that is not r c^2 / 2.
    """
    return tracks.existence * (1.0 - _loss(problem, model, tracks)) > model.confirm


def expected_gospa(
    problem: Problem, model: DetectionModel, tracks: Tracks, undetected: Float[Array, "*cells"]
) -> Scalar:
    """Root of the expected square of GOSPA [m].

    A reported track of existence r costs (1 - r) c^2 / 2 where its target is not there, and r E min(d^2, c^2) where it
    is; a target without a reported track costs c^2 / 2.
    """
    r, alone = tracks.existence, 0.5 * model.cutoff**2
    reported = (1.0 - r) * alone + r * model.cutoff**2 * _loss(problem, model, tracks)
    shown = confirmed(problem, model, tracks)
    cost = jnp.sum(jnp.where(shown, reported, r * alone)) + alone * jnp.sum(undetected)
    return jnp.sqrt(jnp.maximum(cost, 1e-12 * alone))


def _loss(problem: Problem, model: DetectionModel, tracks: Tracks) -> Float[Array, " n"]:
    Z = problem.motion.Z
    square = jnp.trace(multiply(multiply(Z, tracks.covariance), Z.T), axis1=-2, axis2=-1)
    return position_loss(square, model.cutoff)
