"""Tracks that a scan missed: the probability that it had to detect them, and what remains of each belief.

The belief, given that its target was missed, is (1 - p_D(x)) N(x), which is no Gaussian where the view's border cuts
it. Moment matching puts probability back into the view, and the next missed detection must not count it again: neither
shrink the belief again, nor take the same probability off its existence. So a track carries one number more, how much
was put back (`Look.excess`).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry.linalg import cholesky_spd, inverse_spd, multiply, symmetrise
from foveate.models.detections.records import DetectionModel, Look, Tracks
from foveate.models.missed_detection import MIN_OUTSIDE, standard_points
from foveate.models.problem import Problem
from foveate.types import Pose

POINTS = 64
"""Positions that represent a belief: a quarter of those of a single target's filter, as there are many tracks."""
LEAST_SHARE = 1e-3
"""Shares of a belief below this are of no point or of a few, and say nothing of each other."""


class Missed(NamedTuple):
    """For every track: probability of detection, and mean and covariance given that it was missed.

    `excess` is that of the next `Look`. `within` and `beyond` are factors on the Gaussian before this look, on the
    ground that the previous look showed and on the rest, that make it the belief after that look.
    """

    detection: Float[Array, " n"]
    mean: Float[Array, "n n_y"]
    covariance: Float[Array, "n n_y n_y"]
    excess: Float[Array, " n"]
    within: Float[Array, " n"]
    beyond: Float[Array, " n"]


class _Position(NamedTuple):
    """Gaussians of positions: N(middle, covariance), their points, and the gain by which the whole state follows.

    `covariance` has 0 along an axis on which the position is known for certain.
    """

    middle: Float[Array, "n d"]
    covariance: Float[Array, "n d d"]
    offset: Float[Array, "n p d"]
    gain: Float[Array, "n n_y d"]


def look_in_vain(problem: Problem, model: DetectionModel, tracks: Tracks, look: Look, pose: Pose) -> Missed:
    """What a look from `pose` does to tracks that it misses, `look` being the previous one."""
    Z = problem.motion.Z
    standard, weights = (jnp.asarray(x, tracks.mean.dtype) for x in standard_points(len(Z), POINTS))
    before = _position(tracks.mean, tracks.covariance, Z, standard)
    points = before.middle[:, None] + before.offset
    shown = _sees(problem, pose, points)
    known = look.missed[:, None] & _sees(problem, look.pose, points)
    body = problem.agent.space.to_body(pose, points)
    chance = jnp.where(shown, model.probability_at(jnp.sqrt(jnp.sum(body**2, axis=-1))), 0.0)
    within, beyond = _factors(weights, known, look.excess)
    mass = weights * jnp.where(known, within[:, None], beyond[:, None])
    detection = jnp.clip(jnp.sum(mass * chance, axis=1), 0.0, 1.0)
    left = jnp.sum(jnp.where(shown, mass * (1.0 - chance), 0.0), axis=1) / jnp.maximum(1.0 - detection, LEAST_SHARE)

    # The shape changes by what this look adds to the previous one.
    kept = weights * jnp.where(known, 1.0, 1.0 - chance)
    total = jnp.sum(kept, axis=1)
    is_informative = jnp.any(shown & ~known, axis=1) & (total >= MIN_OUTSIDE)
    shares = kept / jnp.where(is_informative, total, 1.0)[:, None]
    moved = jnp.einsum("np,npi->ni", shares, before.offset, precision="highest")
    apart = before.offset - moved[:, None]
    remaining = jnp.einsum("np,npi,npj->nij", shares, apart, apart, precision="highest")
    gain = before.gain
    change = multiply(multiply(gain, remaining - before.covariance), jnp.swapaxes(gain, -1, -2))
    mean = jnp.where(is_informative[:, None], tracks.mean + multiply(gain, moved[..., None])[..., 0], tracks.mean)
    covariance = jnp.where(is_informative[:, None, None], symmetrise(tracks.covariance + change), tracks.covariance)

    after = _position(mean, covariance, Z, standard)
    put_back = _sees(problem, pose, after.middle[:, None] + after.offset)
    excess = jnp.sum(jnp.where(put_back, weights, 0.0), axis=1) - jnp.clip(left, 0.0, 1.0)
    return Missed(detection, mean, covariance, excess, within, beyond)


def _sees(problem: Problem, pose: Pose, points: Float[Array, "n p d"]) -> Bool[Array, "n p"]:
    return problem.sees(pose, points.reshape(-1, points.shape[-1])).reshape(points.shape[:-1])


def _position(
    mean: Float[Array, "n n_y"], covariance: Float[Array, "n n_y n_y"], Z: Float[Array, "d n_y"], standard: Array
) -> _Position:
    cross = multiply(covariance, Z.T)
    of_position = symmetrise(multiply(Z, cross))
    spreads = (jnp.diagonal(of_position, axis1=-2, axis2=-1) > 0.0).astype(cross.dtype)
    # A variance of 1 in place of 0 makes the inverse exist; the points do not spread along it.
    padded = of_position + (1.0 - spreads)[..., None] * jnp.eye(len(Z), dtype=cross.dtype)
    root = cholesky_spd(padded) * spreads[..., None]
    # A product of the library's: the sum over so few terms of so many points costs 40 times as much.
    offset = jnp.einsum("pj,nij->npi", standard, root, precision="highest")
    middle = jnp.matmul(mean, Z.T, precision="highest")
    return _Position(middle, of_position, offset, multiply(cross, inverse_spd(padded)))


def _factors(
    weights: Float[Array, " p"], known: Bool[Array, "n p"], excess: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Factors that take the excess off the previous look's ground, and add it beyond."""
    there = jnp.sum(jnp.where(known, weights, 0.0), axis=1)
    share = jnp.clip(there - excess, 0.0, 1.0)
    splits = (there > LEAST_SHARE) & (there < 1.0 - LEAST_SHARE)
    within = jnp.where(splits, share / jnp.where(splits, there, 0.5), 1.0)
    beyond = jnp.where(splits, (1.0 - share) / jnp.where(splits, 1.0 - there, 0.5), 1.0)
    return within, beyond


def detected_factors(problem: Problem, look: Look, missed: Missed, point: Float[Array, "m d"]) -> Float[Array, "n m"]:
    """For every track and detection, the factor on the track's Gaussian where the detection is [m, in the world].

    Without it a track that was looked for in vain, and so is likely beyond the view, would claim false alarms in it.
    """
    known = look.missed[:, None] & problem.sees(look.pose, point)
    return jnp.where(known, missed.within[:, None], missed.beyond[:, None])
