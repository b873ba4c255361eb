"""Scans of the robots of a team beside the first, where detections have no ids: their share of the random numbers.

Every robot detects the same targets by numbers of its own, and has false alarms and an order of its own.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.models.detections.records import DetectionModel
from foveate.models.problem import Problem
from foveate.simulation.drawn import Noise
from foveate.simulation.population import cut, model_of, normal, scan_noise
from foveate.simulation.records import Instant, ScanNoise
from foveate.simulation.team.records import MateScans, TeamDraws


def _shapes(problem: Problem) -> tuple[tuple[int, ...], ...]:
    """Noise, detection and order of the targets beside those of the scene; false alarms (number, places, order)."""
    sources = model_of(problem)[1]
    others, alarms = sources.others, sources.clutter
    return (others, problem.sensor.size), (others, 2), (), (alarms,), (alarms,)


def mate_scan_shapes(problem: Problem, steps: int, targets: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the uniform numbers of the other robots' scans, by their names in `Noise`; nothing with ids."""
    if problem.team is None or problem.detections is None:
        return {}
    mates, numbers = problem.team.agents - 1, sum(map(math.prod, _shapes(problem)))
    return {"mate_steps": (steps, mates, numbers), "mate_fates": (steps, mates, targets, 2)}


def team_draws(
    problem: Problem, poses: Float[Array, "mates ..."], noise: Noise, alive: Bool[Array, "instants n"] | None
) -> TeamDraws | None:
    """What an episode fixes for the other robots, at these poses; `alive` are its targets, None with ids.

    None where no noise is drawn for them.
    """
    if noise.mates is None or noise.radio is None:
        return None
    if alive is None or problem.detections is None:
        return TeamDraws(poses, noise.mates, noise.radio)
    assert noise.mate_steps is not None, "drawn for a team without ids"
    assert noise.mate_fates is not None, "drawn for a team without ids"
    rows = jax.vmap(jax.vmap(lambda row: tuple(cut(row, _shapes(problem)))))(noise.mate_steps)
    measurement, own, alarms, picked, alarm_order = rows
    detection, order = jnp.moveaxis(jnp.concatenate([noise.mate_fates, own], axis=2), 3, 0)
    measurement = jnp.concatenate([noise.mates, normal(measurement)], axis=2)
    order = jnp.concatenate([order, alarm_order], axis=2)
    scans = mate_scans(problem.detections, alive, detection, alarms, picked, order)
    return TeamDraws(poses, measurement, noise.radio, scans)


def mate_scans(
    model: DetectionModel,
    alive: Bool[Array, "instants n"],
    detection: Float[Array, "K mates n"],
    alarms: Float[Array, "K mates"],
    picked: Float[Array, "K mates alarms"],
    order: Float[Array, "K mates candidates"],
) -> MateScans:
    """Scans of the other robots from uniform numbers, each as those of the first (`population.scan_noise`)."""

    def of_robot(*numbers: Array) -> MateScans:
        found = scan_noise(model, alive, *numbers)
        return MateScans(found.detection, found.clutter_body, found.is_false, found.order)

    return jax.vmap(of_robot, 1, 1)(detection, alarms, picked, order)


def scans_of_all(instant: Instant, draws: TeamDraws) -> ScanNoise | None:
    """The random numbers of all robots' scans in a step, with a leading axis of M; None with ids."""
    first, mates = instant.scans, draws.scans
    if first is None or mates is None:
        return None
    own = first.detection, first.clutter_body, first.is_false, first.order
    others = mates.detection, mates.clutter_body, mates.is_false, mates.order
    every = [jnp.concatenate([one[None], rest]) for one, rest in zip(own, others, strict=True)]
    return ScanNoise(jnp.broadcast_to(first.alive, (len(every[0]), *first.alive.shape)), *every)
