"""Targets that come and go, and the random numbers of scans: the truth of detections without ids.

The targets of the scene have the first places; births, and those that are somewhere before the first step, have the
others, and then whichever is free. All follows from numbers uniform in [0, 1).
"""

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import gammaln, ndtri
from jaxtyping import Array, Bool, Float, Int

from foveate.errors import InputError
from foveate.geometry.linalg import inverse_spd, multiply
from foveate.models.detections.records import DetectionModel, Sources
from foveate.models.problem import Problem
from foveate.simulation.drawn import Drawn, Noise
from foveate.simulation.records import Episode, ScanNoise
from foveate.simulation.truth import Newcomers
from foveate.types import Scalar

LEAST = 1e-7
"""Uniform numbers nearer to 0 or 1 than this would be infinite normal ones."""


class Others(NamedTuple):
    """Targets beside those of the scene, their noise, and all that is drawn for the scans."""

    first: Float[Array, "others n_y"]
    process: Float[Array, "K others n_y"]
    measurement: Float[Array, "K others n_z"]
    newcomers: Newcomers | None
    scans: ScanNoise


def model_of(problem: Problem) -> tuple[DetectionModel, Sources]:
    """The model of detections, and where its targets come from."""
    model = problem.detections
    assert model is not None, "for problems with detections"
    assert model.sources is not None, "a scenario's model has them"
    return model, model.sources


def _beginning_shapes(problem: Problem) -> tuple[tuple[int, ...], ...]:
    """Number, places and states of the targets that are there before the first step."""
    count, motion = model_of(problem)[1].beginners, problem.motion
    return (), (count, motion.dimension), (count, motion.state_size)


def _step_shapes(problem: Problem) -> tuple[tuple[int, ...], ...]:
    """Births (number, boxes, places, states), fates and noises of the others, false alarms (number, places, order)."""
    sources, motion = model_of(problem)[1], problem.motion
    born, others, alarms = sources.births, sources.others, sources.clutter
    births = (), (born,), (born, motion.dimension), (born, motion.state_size)
    return *births, (others, 3), (others, motion.state_size), (others, problem.sensor.size), (), (alarms,), (alarms,)


def noise_shapes(problem: Problem, steps: int, targets: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the uniform numbers of an episode, by their names in `episodes.Noise`."""
    beginning, step = (sum(map(math.prod, of(problem))) for of in (_beginning_shapes, _step_shapes))
    return {"beginning": (beginning,), "steps": (steps, step), "fates": (steps, targets, 3)}


def joined(problem: Problem, scene: Drawn, noise: Noise, with_truth: bool) -> tuple[Drawn, Noise, Others]:
    """A scene and its noise with the other targets behind those of the scene, and these others.

    Raises InputError without truth.
    """
    if not with_truth:
        raise InputError("noise = False: expected True with detections without ids, which are of the truth")
    others = others_of(problem, scene.present, noise)
    count = others.first.shape[0]

    def more(x: Array, axis: int) -> Array:
        return jnp.concatenate([x, jnp.zeros_like(x, shape=(*x.shape[:axis], count, *x.shape[axis + 1 :]))], axis)

    process, measurement = (
        jnp.concatenate([own, new], axis=1)
        for own, new in ((noise.process, others.process), (noise.measurement, others.measurement))
    )
    scene = replace(scene, position=more(scene.position, 0), drift=more(scene.drift, 0), present=more(scene.present, 0))
    first, jitter = more(noise.first, 0), more(noise.jitter, 1)
    return scene, Noise(jitter=jitter, process=process, measurement=measurement, first=first), others


def with_tracks(problem: Problem, episode: Episode, scans: ScanNoise) -> Episode:
    """The episode with scans, whose beliefs are tracks: of known targets from the start, in the first places."""
    model, _ = model_of(problem)
    count = min(model.tracks, episode.mean.shape[0])

    def placed(x: Array) -> Array:
        return jnp.zeros_like(x, shape=(model.tracks, *x.shape[1:])).at[:count].set(x[:count])

    steps, inputs = episode.inputs.shape[0], episode.inputs.shape[2:]
    return replace(
        episode,
        mean=placed(episode.mean),
        present=placed(episode.present & model.known),
        inputs=jnp.zeros_like(episode.inputs, shape=(steps, model.tracks, *inputs)),
        scans=scans,
    )


def others_of(problem: Problem, present: Bool[Array, " n"], noise: Noise) -> Others:
    """The targets beside those `present` in the scene, and the scans of all, from the numbers of `noise_shapes`."""
    beginning, steps, fates = noise.beginning, noise.steps, noise.fates
    assert beginning is not None, "drawn for problems with detections"
    assert steps is not None, "drawn for problems with detections"
    assert fates is not None, "drawn for problems with detections"
    model, sources = model_of(problem)
    count, place, state = cut(beginning, _beginning_shapes(problem))
    certain = sum(sources.first)
    box = jnp.repeat(jnp.arange(len(sources.first)), jnp.array(sources.first, int), total_repeat_length=certain)
    low, high = (
        jnp.concatenate([corners[box], jnp.broadcast_to(grid, (sources.scattered, len(grid)))])
        for corners, grid in ((sources.low, model.grid.low), (sources.high, model.grid.high))
    )
    begin = _states(problem, low + (high - low) * place, state)
    first = jnp.concatenate([begin, jnp.zeros((sources.others - sources.beginners, begin.shape[1]))])
    scattered = jnp.arange(sources.scattered) < poisson(count, sources.undetected, sources.scattered)
    unused = jnp.zeros(sources.others - sources.beginners, bool)
    alive = jnp.concatenate([present, jnp.ones(certain, bool), scattered, unused])

    parts = jax.vmap(lambda row: tuple(cut(row, _step_shapes(problem))))(steps)
    born, which, place, state, own, process, measurement, alarms, picked, alarm_order = parts
    survival, detection, order = jnp.moveaxis(jnp.concatenate([fates, own], axis=1), 2, 0)
    births = jax.vmap(lambda u: poisson(u, jnp.sum(sources.rate), sources.births))(born)
    alive, begins, number = _lives(alive, survival < model.survival, births)
    newcomers = _newcomers(problem, begins, number, which, place, state)
    scans = scan_noise(model, alive, detection, alarms, picked, jnp.concatenate([order, alarm_order], axis=1))
    return Others(first, normal(process), normal(measurement), newcomers, scans)


def scan_noise(
    model: DetectionModel,
    alive: Bool[Array, "instants n"],
    detection: Float[Array, "K n"],
    alarms: Float[Array, " K"],
    picked: Float[Array, "K alarms"],
    order: Float[Array, "K candidates"],
) -> ScanNoise:
    """The scans of the targets that are `alive`, from uniform numbers: of false alarms, their number and places."""
    most = picked.shape[1]
    number = jax.vmap(lambda u: poisson(u, model.clutter, most))(alarms)
    false = jnp.arange(most) < number[:, None]
    points = model.clutter_points_body
    chosen = jnp.minimum(jnp.floor(picked * len(points)), len(points) - 1).astype(int)
    return ScanNoise(alive, detection, points[chosen], false, order)


def _newcomers(
    problem: Problem,
    begins: Bool[Array, "K n"],
    number: Int[Array, "K n"],
    which: Float[Array, "K births"],
    place: Float[Array, "K births d"],
    state: Float[Array, "K births n_y"],
) -> Newcomers | None:
    """New targets by the numbers of their births; None where there are no births."""
    sources = model_of(problem)[1]
    if sources.births == 0:
        return None
    low, high = (corners[_box(sources.rate, which)] for corners in (sources.low, sources.high))
    states = _states(problem, low + (high - low) * place, state)
    return Newcomers(begins, jax.vmap(lambda rows, chosen: rows[chosen])(states, number))


def poisson(uniform: Scalar, mean: Scalar, most: int) -> Int[Array, ""]:
    """A Poisson variable of this mean, at most `most`, by the inverse of its distribution function."""
    if most == 0:
        return jnp.zeros((), int)
    count = jnp.arange(most, dtype=mean.dtype)
    below = jnp.cumsum(jnp.exp(count * jnp.log(mean) - mean - gammaln(count + 1.0)))
    return jnp.sum(uniform >= below)


def _box(rate: Float[Array, " boxes"], uniform: Float[Array, "*b"]) -> Int[Array, "*b"]:
    """Number of a box, each with a probability proportional to its rate."""
    until = jnp.cumsum(rate)[:-1] / jnp.sum(rate)
    return jnp.sum(uniform[..., None] >= until, axis=-1)


def _states(
    problem: Problem, position: Float[Array, "*b d"], uniform: Float[Array, "*b n_y"]
) -> Float[Array, "*b n_y"]:
    """States at these positions, the rest of each drawn from the prior."""
    motion = problem.motion
    back = jnp.linalg.pinv(motion.Z)
    root = jnp.linalg.cholesky(inverse_spd(problem.prior_information))
    rest = jnp.eye(motion.state_size, dtype=back.dtype) - multiply(back, motion.Z)
    drawn = jnp.matmul(normal(uniform), multiply(rest, root).T, precision="highest")
    return jnp.matmul(position, back.T, precision="highest") + drawn


def _lives(
    first: Bool[Array, " n"], survives: Bool[Array, "K n"], births: Int[Array, " K"]
) -> tuple[Bool[Array, "instants n"], Bool[Array, "K n"], Int[Array, "K n"]]:
    """Places alive at each instant, those that begin in each step, and the number of the birth in that step.

    A birth gets a place that was free before the step, so that a life never follows another without a gap.
    """

    def step(alive, inputs):
        survive, births = inputs
        number = jnp.cumsum(~alive) - 1
        begins = ~alive & (number < births)
        after = (alive & survive) | begins
        return after, (after, begins, jnp.where(begins, number, 0))

    alive, begins, number = jax.lax.scan(step, first, (survives, births))[1]
    return jnp.concatenate([first[None], alive]), begins, number


def normal(uniform: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Standard normal numbers of uniform ones."""
    return ndtri(jnp.clip(uniform, LEAST, 1.0 - LEAST))


def cut(flat: Float[Array, " size"], shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    """Numbers in arrays of these shapes."""
    parts, end = [], 0
    for shape in shapes:
        begin, end = end, end + math.prod(shape)
        parts.append(flat[begin:end].reshape(shape))
    return parts
