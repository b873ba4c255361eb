"""The stages of a step whose detections have no ids: a scan of all targets, and the filter's update with it."""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import cholesky_spd, inverse_spd, multiply
from foveate.models.detections import filter as pmb
from foveate.models.detections.expectation import confirmed, expected_gospa
from foveate.models.detections.records import NO_IDENTITY, Population, Scan, Tracks
from foveate.models.problem import Problem
from foveate.simulation.draft import Draft, noise_covariance, positions_body
from foveate.simulation.records import Episode, Protocol, State


def begin(problem: Problem, episode: Episode) -> Population:
    """The filter before the first step; targets of the scene that are known have a track each."""
    model = problem.detections
    assert model is not None, "for problems with detections"
    known = episode.present
    covariance = inverse_spd(problem.prior_information)
    tracks = Tracks(
        existence=known.astype(episode.mean.dtype),
        mean=episode.mean,
        covariance=jnp.broadcast_to(covariance, (len(known), *covariance.shape)),
        identity=jnp.where(known, jnp.arange(len(known)), NO_IDENTITY),
    )
    return pmb.start(problem, model, episode.pose, tracks)


def predict_population(problem: Problem, state: State, known_input: Float[Array, "n m_y"]) -> State:
    """Predict tracks and undetected targets one step ahead; `problem` is that of the step."""
    assert problem.detections is not None, "for problems with detections"
    assert state.population is not None, "`start` makes it"
    return shown(problem, state, pmb.predict(problem, problem.detections, state.population, known_input))


def shown(problem: Problem, state: State, population: Population) -> State:
    """The state with this population: its tracks are the beliefs, and those that may well exist are present."""
    assert problem.detections is not None, "for problems with detections"
    tracks = population.tracks
    return replace(
        state,
        population=population,
        mean=tracks.mean,
        information=inverse_spd(tracks.covariance)[None],
        present=tracks.existence > problem.detections.tell,
    )


def scan(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Detect the targets in view, each with its probability, and false alarms, in a random order."""
    model, reality, scans = problem.detections, draft.instant.truth, draft.instant.scans
    assert model is not None, "a stage of problems with detections"
    assert reality is not None, "a stage of episodes with truth"
    assert scans is not None, "a stage of episodes with scans"
    space, pose, dropped = problem.agent.space, draft.state.pose, draft.state.dropped
    assert dropped is not None, "`start` counts them"
    position_body = positions_body(problem, pose, reality.state)
    in_view = problem.sees(pose, problem.motion.position(reality.state), scans.alive)
    chance = model.probability_at(jnp.sqrt(jnp.sum(position_body**2, axis=-1)))
    detected = in_view & (scans.detection < chance)
    root = cholesky_spd(noise_covariance(problem, pose, position_body))
    noise = multiply(root, reality.measurement_noise[..., None])[..., 0]
    false_world = space.to_world(pose, scans.clutter_body)
    back = jnp.linalg.pinv(problem.motion.Z)
    false = problem.sensor.expected(jnp.matmul(false_world, back.T, precision="highest"), scans.clutter_body)
    measurement = jnp.concatenate([problem.sensor.expected(reality.state, position_body) + noise, false])
    valid = jnp.concatenate([detected, scans.is_false])
    order = jnp.argsort(jnp.where(valid, scans.order, 2.0))
    kept = order[: model.detections]
    taken = jnp.zeros(len(valid), bool).at[kept].set(True)
    lost = jnp.sum(valid & ~taken).astype(dropped.dtype)
    return draft._replace(
        scan=Scan(measurement[kept], valid[kept]),
        measured=detected & taken[: len(detected)],
        state=replace(draft.state, dropped=dropped + lost),
    )


def update_population(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Update tracks and undetected targets with the scan."""
    model, population, found = problem.detections, draft.state.population, draft.scan
    assert model is not None, "a stage of problems with detections"
    assert population is not None, "`start` makes it"
    assert found is not None, "`scan` comes first"
    updated = pmb.update(problem, model, population, draft.state.pose, found)
    return draft._replace(state=shown(problem, draft.state, updated))


def expected(problem: Problem, state: State) -> dict[str, Array]:
    """Existence of tracks, those that are confirmed, number of other targets, GOSPA; nothing of detections with ids."""
    model, population = problem.detections, state.population
    if model is None or population is None:
        return {}
    return {
        "existence": population.tracks.existence,
        "confirmed": confirmed(problem, model, population.tracks),
        "undetected": jnp.sum(population.undetected),
        "expected_gospa": expected_gospa(problem, model, population.tracks, population.undetected),
    }


def dropped(state: State) -> Array | None:
    """Number of detections and tracks so far for which there was no room; None of detections with ids."""
    if state.population is None or state.dropped is None:
        return None
    return state.dropped + state.population.overflow.astype(state.dropped.dtype)
