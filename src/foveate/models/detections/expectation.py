"""GOSPA as the filter itself expects it, of the tracks that it reports (p = 2, alpha = 2)."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import multiply
from foveate.models.detections.records import DetectionModel, Tracks
from foveate.models.problem import Problem
from foveate.types import Scalar


def capped(square: Float[Array, "*b"], cutoff: Scalar) -> Float[Array, "*b"]:
    """E min(d^2, c^2) of a distance d [m] whose square has this mean [m^2]: exact in the plane, alike on both axes."""
    square = jnp.maximum(square, 1e-6 * cutoff**2)
    return square * (1.0 - jnp.exp(-(cutoff**2) / square))


def expected_gospa(
    problem: Problem, model: DetectionModel, tracks: Tracks, undetected: Float[Array, "*cells"]
) -> Scalar:
    """Root of the expected square of GOSPA [m].

    A reported track of existence r costs (1 - r) c^2 / 2 where its target is not there, and r E min(d^2, c^2) where it
    is; a target without a reported track costs c^2 / 2.
    """
    assert model.cutoff is not None, "a scenario's model has it"
    Z, r = problem.motion.Z, tracks.existence
    square = jnp.trace(multiply(multiply(Z, tracks.covariance), Z.T), axis1=-2, axis2=-1)
    alone = 0.5 * model.cutoff**2
    reported = (1.0 - r) * alone + r * capped(square, model.cutoff)
    cost = jnp.sum(jnp.where(r > model.confirm, reported, r * alone)) + alone * jnp.sum(undetected)
    return jnp.sqrt(jnp.maximum(cost, 1e-12 * alone))
