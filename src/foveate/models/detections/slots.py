"""Slots of tracks: which of the old and the new ones stay, and the return of the others to the intensity."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.geometry.linalg import multiply
from foveate.models.detections.records import NO_IDENTITY, DetectionModel, Population, Tracks
from foveate.models.problem import Problem


def merged(problem: Problem, model: DetectionModel, population: Population, old: Tracks, new: Tracks) -> Population:
    """Keep the likeliest of old and new tracks; the others return to the intensity of undetected targets.

    Old tracks stay in their slots, new ones get the free ones. A track with an existence of at most `recycle` gets
    none; one above it that does not fit is counted.
    """
    n = len(old.existence)
    existence = jnp.concatenate([old.existence, new.existence])
    fits = _rank(existence) < n
    stays = fits & (existence > model.recycle)
    kept, enters = stays[:n], stays[n:]
    slots, source = _fill(~kept, enters)

    def place(slot_values: Array, new_values: Array) -> Array:
        shape = (n,) + (1,) * (slot_values.ndim - 1)
        return jnp.where(slots.reshape(shape), new_values[source], slot_values)

    identity = (population.born + jnp.cumsum(enters) - 1).astype(old.identity.dtype)
    tracks = jax.tree.map(place, old, replace(new, identity=identity))
    is_used = kept | slots
    tracks = replace(
        tracks,
        existence=jnp.where(is_used, tracks.existence, 0.0),
        identity=jnp.where(is_used, tracks.identity, NO_IDENTITY),
    )
    everything = jax.tree.map(lambda *parts: jnp.concatenate(parts), old, new)
    look = population.look
    return replace(
        population,
        tracks=tracks,
        undetected=population.undetected + _returned(problem, model, everything, ~stays),
        look=replace(look, missed=look.missed & kept),
        born=population.born + jnp.sum(enters),
        overflow=population.overflow + jnp.sum(~fits & (existence > model.recycle)),
    )


def _rank(values: Float[Array, " k"]) -> Int[Array, " k"]:
    """Place of each value in descending order, equal ones in order: by comparisons, which a batch runs at once."""
    here = jnp.arange(len(values))
    before = (values > values[:, None]) | ((values == values[:, None]) & (here < here[:, None]))
    return jnp.sum(before, axis=1)


def _fill(free: Bool[Array, " n"], enters: Bool[Array, " m"]) -> tuple[Bool[Array, " n"], Int[Array, " n"]]:
    """Slots that get a new track, the first free ones, and for each the index of that track."""
    place, number = jnp.cumsum(free) - 1, jnp.cumsum(enters) - 1
    matches = free[:, None] & enters & (place[:, None] == number)
    return jnp.any(matches, axis=1), jnp.argmax(matches, axis=1)


def _returned(
    problem: Problem, model: DetectionModel, tracks: Tracks, which: Bool[Array, " k"]
) -> Float[Array, "*cells"]:
    """Intensity of the tracks that return: their existence, where they may be."""
    Z = problem.motion.Z
    variance = jnp.diagonal(multiply(multiply(Z, tracks.covariance), Z.T), axis1=-2, axis2=-1)
    weight = jnp.where(which, tracks.existence, 0.0)
    least = 1e-6 * model.grid.size
    return model.grid.deposit(weight, problem.motion.position(tracks.mean), jnp.maximum(jnp.sqrt(variance), least))
