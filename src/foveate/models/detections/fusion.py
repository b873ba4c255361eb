"""Fusion of the populations of two robots that may share information of unknown extent.

Both are posteriors of one prior, each of the scans that its robot has heard, some of which both may have. Let u0 be the
intensity of undetected targets if nobody had ever looked: u / u0 is the probability that all looks that a robot knows
of have missed a target that is at this place.

Track i of one robot and j of the other are of one target, or of two, of which each robot has missed the other's. Given
positions x_i, x_j and their covariances, and a prior that is flat over these, one target is the likelier if (Chong,
Mori & Chang 1990)

    N(x_i - x_j; 0, P_i + P_j) > u_i(x_j) u_j(x_i) / u0(x_i)        [1/m^d]

where u_i is of the robot of track i: u0 times its probability of a miss. Pairs are those with the largest product of
these ratios. What two robots have in common makes x_i and x_j nearer than P_i + P_j says, never farther.

A pair becomes one track by the normalised weighted geometric mean of both densities, generalised covariance
intersection (Mahler 2000; Clark et al. 2010): covariance intersection of the Gaussians with a weight w, and an
existence r whose log(r / (1 - r)) is the mean of both by the same weights. Neither covariance nor existence is surer
than the surer of the two. The overlap of the Gaussians, by which that mean also lowers r, is left out: that the target
is one is decided before.

A track that only the other has enters with the existence r v / (1 - r + r v), v = u / u0 at its place: Bayes' rule if
the own looks were not among those of the other, and else too small. Undetected are the targets that both have missed,
no more than each has: u is the smaller of both, exact if one robot's looks are among the other's, and else too large.
Only what one robot has returned to its u for want of a slot may be lost by that.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int
from optax.assignment import hungarian_algorithm

from foveate.geometry.linalg import inverse_spd, log_det_spd, multiply, symmetrise
from foveate.models.belief import Belief
from foveate.models.detections.records import DetectionModel, Population, Tracks
from foveate.models.detections.slots import merged
from foveate.models.fusion import weighted_intersection
from foveate.models.gate import gate_limit
from foveate.models.problem import Problem
from foveate.names import GATE

LEAST = 1e-30
"""Least density of two targets: 0 would have no logarithm."""


def fused(
    problem: Problem, model: DetectionModel, own: Population, other: Population, unseen: Float[Array, "*cells"]
) -> Population:
    """The own population with what another robot's says; `unseen` is the intensity u0 if nobody had ever looked.

    Own tracks keep their slots and identities. Equal populations stay as they are.
    """
    partner = partners(problem, model, own, other, unseen)
    has = partner >= 0
    tracks, changed = _together(own.tracks, jax.tree.map(lambda x: x[partner], other.tracks), has)
    is_taken = jnp.any(has & (partner == jnp.arange(len(has))[:, None]), axis=1)
    missed = _share(problem, model, own.undetected, unseen, other.tracks)
    r = jnp.where(is_taken, 0.0, other.tracks.existence)
    r = r * missed / jnp.where(r * missed > 0, 1.0 - r + r * missed, 1.0)
    entering = replace(other.tracks, existence=jnp.where(r > model.recycle, r, 0.0))
    look = replace(own.look, missed=own.look.missed & ~changed)
    undetected = jnp.minimum(own.undetected, other.undetected)
    return merged(problem, model, replace(own, undetected=undetected, look=look), tracks, entering)


def partners(
    problem: Problem, model: DetectionModel, own: Population, other: Population, unseen: Float[Array, "*cells"]
) -> Int[Array, " n"]:
    """The other's track that is of the same target as each of the own, or -1; none twice."""
    (mine, P), (theirs, Q) = _positions(problem, own.tracks), _positions(problem, other.tracks)
    # A position that is known for certain would have no inverse.
    apart, S = mine[:, None] - theirs, symmetrise(P[:, None] + Q) + jnp.diag((1e-6 * model.grid.size) ** 2)
    distance = jnp.sum(apart * jnp.matmul(inverse_spd(S), apart[..., None], precision="highest")[..., 0], axis=-1)
    d = apart.shape[-1]
    one = -0.5 * (distance + log_det_spd(S) + d * jnp.log(2.0 * jnp.pi))
    by_own = _density(problem, model, own.undetected, other.tracks)
    two = by_own * _share(problem, model, other.undetected, unseen, own.tracks)[:, None]
    ratio = one - jnp.log(jnp.maximum(two, LEAST))
    exist = (own.tracks.existence > 0)[:, None] & (other.tracks.existence > 0)
    limit = gate_limit(GATE, d)
    assert limit is not None, "of a probability"
    worth = jnp.where(exist & (ratio > 0) & (distance <= limit), ratio, 0.0)
    rows, columns = hungarian_algorithm(-worth)
    chosen = jnp.zeros(len(mine), int).at[rows].set(columns.astype(int))
    return jnp.where(worth[jnp.arange(len(mine)), chosen] > 0, chosen, -1)


def _together(own: Tracks, other: Tracks, has: Bool[Array, " n"]) -> tuple[Tracks, Bool[Array, " n"]]:
    """Own tracks fused with those beside them where they have one, and which of them have changed."""

    def pair(mean, covariance, their_mean, their_covariance):
        mine, theirs = Belief(mean, inverse_spd(covariance)), Belief(their_mean, inverse_spd(their_covariance))
        belief, weight = weighted_intersection(mine, theirs)
        return belief.mean, inverse_spd(belief.information), weight

    mean, covariance, weight = jax.vmap(pair)(own.mean, own.covariance, other.mean, other.covariance)
    r, s = own.existence, other.existence
    there, gone = r ** (1.0 - weight) * s**weight, (1.0 - r) ** (1.0 - weight) * (1.0 - s) ** weight
    changed = has & (weight > 0)
    tracks = Tracks(
        existence=jnp.where(changed, there / jnp.where(changed, there + gone, 1.0), r),
        mean=jnp.where(changed[:, None], mean, own.mean),
        covariance=jnp.where(changed[:, None, None], symmetrise(covariance), own.covariance),
        identity=own.identity,
    )
    return tracks, changed


def _positions(problem: Problem, tracks: Tracks) -> tuple[Float[Array, "n d"], Float[Array, "n d d"]]:
    Z = problem.motion.Z
    return problem.motion.position(tracks.mean), symmetrise(multiply(multiply(Z, tracks.covariance), Z.T))


def _density(
    problem: Problem, model: DetectionModel, intensity: Float[Array, "*cells"], tracks: Tracks
) -> Float[Array, " n"]:
    """Intensity [1/m^d] where each track is."""
    position, P = _positions(problem, tracks)
    std = jnp.maximum(jnp.sqrt(jnp.diagonal(P, axis1=-2, axis2=-1)), 1e-6 * model.grid.size)
    return model.grid.density(intensity, position, std)


def _share(
    problem: Problem,
    model: DetectionModel,
    intensity: Float[Array, "*cells"],
    unseen: Float[Array, "*cells"],
    tracks: Tracks,
) -> Float[Array, " n"]:
    """u / u0 where each track is, in [0, 1]; 1 where nothing is expected, and no look says anything."""
    density, most = (_density(problem, model, each, tracks) for each in (intensity, unseen))
    return jnp.where(most > 0, jnp.clip(density / jnp.where(most > 0, most, 1.0), 0.0, 1.0), 1.0)
