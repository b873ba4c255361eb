"""The Poisson multi-Bernoulli filter of one agent (Williams 2015; Garcia-Fernandez et al. 2018), to be `vmap`ed.

Prediction: r <- p_S r, Gaussians as in `models.belief`, u <- p_S (u spread by the motion) + births. Update with the
detections z_1 .. z_m of a scan: weights, marginal probabilities of association (`association`), each track the
moment-matched mixture of "missed" (with what the view has excluded) and each detection; each detection also begins a
track with the existence that no track claims it and that it is no false alarm; u <- u (1 - p_D) in the view; the
weakest tracks return to u. With p_D = 1, survival 1, no clutter, no births, u = 0 and existence 1 this is the Kalman
filter.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import inverse_spd, log_det_spd, multiply, symmetrise
from foveate.models.detections import visibility
from foveate.models.detections.association import Association, associate
from foveate.models.detections.missed import Missed, detected_factors, look_in_vain
from foveate.models.detections.records import NO_IDENTITY, DetectionModel, Look, Population, Scan, Tracks, empty_tracks
from foveate.models.detections.slots import merged
from foveate.models.detections.visibility import Measured
from foveate.models.gate import one_point
from foveate.models.problem import Problem
from foveate.types import Pose


class Pairs(NamedTuple):
    """Every track with every detection: innovations z - H p, the density of z, gain K, covariance after the update."""

    innovation: Float[Array, "n m n_z"]
    density: Float[Array, "n m"]
    gain: Float[Array, "n n_y n_z"]
    covariance: Float[Array, "n n_y n_y"]


def start(problem: Problem, model: DetectionModel, pose: Pose, tracks: Tracks | None = None) -> Population:
    """The filter before the first step: without tracks, or with those given, in the first slots."""
    slots, born = empty_tracks(model, problem.prior_information), jnp.zeros((), int)
    if tracks is not None:
        count = tracks.existence.shape[0]
        slots = jax.tree.map(lambda all_slots, given: all_slots.at[:count].set(given), slots, tracks)
        born = jnp.max(tracks.identity, initial=-1) + 1
    nothing = jnp.zeros(model.tracks, slots.mean.dtype)
    look = Look(pose, jnp.zeros(model.tracks, bool), nothing)
    return Population(slots, model.first, look, born, jnp.zeros((), int))


def predict(
    problem: Problem, model: DetectionModel, population: Population, known_input: Float[Array, "n m_y"]
) -> Population:
    """One step ahead of all; `problem` is that of the step."""
    motion, tracks = problem.motion, population.tracks
    spread = symmetrise(multiply(multiply(motion.A, tracks.covariance), motion.A.T) + motion.W)
    exists = tracks.existence > 0
    ahead = replace(
        tracks,
        existence=model.survival * tracks.existence,
        mean=motion.advance(tracks.mean, known_input),
        # Empty slots keep what they have: after many predictions it would be infinite.
        covariance=jnp.where(exists[:, None, None], spread, tracks.covariance),
    )
    return replace(population, tracks=ahead, undetected=undetected_ahead(problem, model, population.undetected))


def undetected_ahead(
    problem: Problem, model: DetectionModel, undetected: Float[Array, "*cells"]
) -> Float[Array, "*cells"]:
    """The intensity of undetected targets one step ahead: u <- p_S (u spread by the motion) + births."""
    return model.survival * model.grid.spread(undetected, _step_variance(problem)) + model.births


def _step_variance(problem: Problem) -> Float[Array, " d"]:
    """Variance of a step of a target that was never detected [m^2], its velocity that of a first belief."""
    motion = problem.motion
    first = inverse_spd(problem.prior_information)
    moved = motion.A - jnp.eye(motion.state_size, dtype=motion.A.dtype)
    step = multiply(multiply(moved, first), moved.T) + motion.W
    return jnp.diagonal(multiply(multiply(motion.Z, step), motion.Z.T))


def update(problem: Problem, model: DetectionModel, population: Population, pose: Pose, scan: Scan) -> Population:
    """The filter after a scan from `pose`; `problem` is that of the step."""
    tracks = population.tracks
    missed = look_in_vain(problem, model, tracks, population.look, pose)
    pairs = _pairs(problem, model, tracks, pose)(scan)
    measured = visibility.measured(problem, pose, scan)
    sight = visibility.in_sight(problem, pose, measured)
    new, arrivals = _new_tracks(problem, model, population, scan, measured)
    # Of tracks, too, by the detection alone. Bayes has the track's own place after it; but a belief is not cut at the
    # border when its target is detected, so that later misses cost too little, and of false alarms on both sides of the
    # border tracks grew that followed nothing.
    chance = sight * visibility.chance(problem, model, pose, measured.position_world, measured.std)
    arrivals = arrivals * chance

    r = tracks.existence
    not_there, overlooked = 1.0 - r, r * jnp.maximum(1.0 - missed.detection, 1e-9)
    density = pairs.density * chance
    density *= detected_factors(problem, population.look, missed, measured.position_world)
    clutter = model.clutter / model.view_volume
    found = associate(
        not_there + overlooked,
        jnp.where(scan.valid, r[:, None] * density, 0.0),
        jnp.where(scan.valid, clutter + arrivals, 0.0),
    )
    still_there = found.missed * overlooked / (not_there + overlooked)
    kept = _mixture(tracks, missed, pairs, found, still_there)
    # What cannot be a false alarm is a target, also where none was expected.
    share = jnp.where(clutter > 0, arrivals / jnp.where(clutter > 0, clutter + arrivals, 1.0), 1.0)
    new = replace(new, existence=jnp.where(scan.valid, found.unclaimed * share, 0.0))
    undetected = population.undetected * (1.0 - visibility.cell_detection(problem, model, pose))
    next_look = Look(pose, found.missed > 0.5, missed.excess)
    return merged(problem, model, replace(population, undetected=undetected, look=next_look), kept, new)


def _mixture(
    tracks: Tracks, missed: Missed, pairs: Pairs, found: Association, still_there: Float[Array, " n"]
) -> Tracks:
    """Moment-matched tracks: "missed", with its own mean and covariance, and each detection, p + K (z_j - H p)."""
    existence = still_there + jnp.sum(found.pair, axis=1)
    total = jnp.where(existence > 0, existence, 1.0)
    miss, share = still_there / total, found.pair / total[:, None]
    shift = jnp.einsum("nmz,nyz->nmy", pairs.innovation, pairs.gain, precision="highest")
    away = missed.mean - tracks.mean
    mean = miss[:, None] * away + jnp.sum(share[..., None] * shift, axis=1)
    apart, away = shift - mean[:, None], away - mean
    scatter = jnp.einsum("nm,nmi,nmj->nij", share, apart, apart, precision="highest")
    scatter += miss[:, None, None] * (missed.covariance + away[..., None] * away[:, None])
    covariance = (1.0 - miss)[:, None, None] * pairs.covariance + scatter
    exists = existence > 0
    return Tracks(
        existence=jnp.clip(existence, 0.0, 1.0),
        mean=jnp.where(exists[:, None], tracks.mean + mean, tracks.mean),
        covariance=jnp.where(exists[:, None, None], symmetrise(covariance), tracks.covariance),
        identity=tracks.identity,
    )


def _pairs(problem: Problem, model: DetectionModel, tracks: Tracks, pose: Pose):
    """Function of a scan: all pairs of a track and a detection, by the sensor about each track's mean."""
    H, V = problem.sensor.H, visibility.noise(problem, pose, tracks.mean)
    cross = multiply(tracks.covariance, H.T)
    S = symmetrise(multiply(H, cross) + V)
    inverse = inverse_spd(S)
    gain = multiply(cross, inverse)
    # Joseph's form: a sum of semidefinite matrices however K is rounded.
    rest = jnp.eye(H.shape[1], dtype=H.dtype) - multiply(gain, H)
    covariance = multiply(multiply(rest, tracks.covariance), jnp.swapaxes(rest, -1, -2))
    covariance += multiply(multiply(gain, V), jnp.swapaxes(gain, -1, -2))
    log_scale = -0.5 * (log_det_spd(S) + len(H) * jnp.log(2.0 * jnp.pi))
    expected = jnp.matmul(tracks.mean, H.T, precision="highest")

    def of(scan: Scan) -> Pairs:
        innovation = scan.measurement - expected[:, None]
        distance = jnp.sum(innovation * jnp.sum(inverse[:, None] * innovation[..., None, :], axis=-1), axis=-1)
        density = jnp.exp(log_scale[:, None] - 0.5 * distance)
        if model.gate is not None:
            density = jnp.where(distance <= model.gate, density, 0.0)
        return Pairs(innovation, density, gain, symmetrise(covariance))

    return of


def _new_tracks(
    problem: Problem, model: DetectionModel, population: Population, scan: Scan, measured: Measured
) -> tuple[Tracks, Float[Array, " m"]]:
    """A track of every detection, by one-point initiation, and the density of undetected targets that it may be of."""
    H, Z = problem.sensor.H, problem.motion.Z
    begun = jax.vmap(one_point, (None, 0, None, 0))(problem.prior_information, scan.measurement, H, measured.V)
    covariance = inverse_spd(begun.information)
    variance = jnp.diagonal(multiply(multiply(Z, covariance), Z.T), axis1=-2, axis2=-1)
    density = model.grid.density(population.undetected, problem.motion.position(begun.mean), jnp.sqrt(variance))
    nothing, unnamed = jnp.zeros_like(density), jnp.full(len(density), NO_IDENTITY)
    return Tracks(nothing, begun.mean, covariance, unnamed), density
