"""Expected cost along a way, by the filter's own expectation: of worlds whose detections have no ids.

In units of a missed target (c^2 / 2 of GOSPA's square): undetected targets count 1 until a look finds them, with the
probability of detection, and births count from their step. A track of existence r and error d counts
r 2 E min(d^2, c^2) / c^2, and 1 - r, where it is reported though it may be false, or r where it is not. After a look
that finds it it exists, with the error after that measurement, which grows from then on. So does the error of a target
found on the way, once it is left behind.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry.linalg import inverse_spd, multiply, symmetrise
from foveate.models.detections.expectation import position_loss
from foveate.models.detections.records import DetectionModel
from foveate.models.detections.visibility import cell_detection
from foveate.models.problem import Problem
from foveate.policies.search import Undetected, detections_of, undetected_of
from foveate.simulation.records import Observation
from foveate.types import Pose

CELLS = {2: 10, 3: 6}
"""Most cells along each axis on which undetected targets are counted, by the dimension of space."""
LOOKS = 4
"""Looks after which the velocity of a target found on the way is known as well as it counts here."""


class Errors(NamedTuple):
    """Mean squared errors of positions [m^2] by the number of steps: of tracks without a look, and since one.

    `found` is that of a target found on the way, since its last look; `position_world` are the tracks' means [m].
    """

    unseen: Float[Array, "steps n"]
    seen: Float[Array, "steps n"]
    found: Float[Array, " steps"]
    position_world: Float[Array, "steps n d"]


class Left(NamedTuple):
    """Shares of each track, and of undetected targets on coarse cells, that the looks of other robots leave."""

    tracks: Float[Array, " n"]
    cells: Float[Array, " cells"]


def errors_ahead(problem: Problem, observation: Observation, steps: int) -> Errors:
    """Errors of tracks that move on without a look, or after one in the first of the steps; and of targets found."""
    motion, covariance = problem.motion, inverse_spd(observation.information)
    after = _looked(problem, observation.information)
    found = _looked(problem, problem.prior_information)
    for _ in range(LOOKS - 1):
        found = _looked(problem, inverse_spd(_ahead(problem, found)))

    def of(covariance: Float[Array, "*n n_y n_y"]) -> Float[Array, "*n"]:
        return jnp.trace(multiply(multiply(motion.Z, covariance), motion.Z.T), axis1=-2, axis2=-1)

    def step(carry, _):
        unseen, seen, found, mean = carry
        errors = Errors(of(unseen), of(seen), of(found), motion.position(mean))
        ahead = [_ahead(problem, P) for P in (unseen, seen, found)]
        return (*ahead, motion.advance(mean, observation.known_input)), errors

    return jax.lax.scan(step, (covariance, after, found, observation.mean), None, steps)[1]


def _looked(problem: Problem, information: Float[Array, "*n n_y n_y"]) -> Float[Array, "*n n_y n_y"]:
    """Covariance after a measurement."""
    return inverse_spd(symmetrise(information + problem.sensor.information(problem.sensor.V)))


def _ahead(problem: Problem, covariance: Float[Array, "*n n_y n_y"]) -> Float[Array, "*n n_y n_y"]:
    """Covariance one step later."""
    A, W = problem.motion.A, problem.motion.W
    return symmetrise(multiply(multiply(A, covariance), A.T) + W)


def of_tracks(
    problem: Problem, observation: Observation, errors: Errors, way: Pose, left: Left | None
) -> Float[Array, " steps"]:
    """Expected cost of the tracks after each step [targets]."""
    model, r = problem.detections, observation.existence
    assert model is not None, "for problems with detections"
    assert r is not None, "observations of detections without ids have it"
    r, steps = jnp.where(observation.present, r, 0.0), len(errors.unseen)

    def step(carry, inputs):
        unfound, since = carry
        pose, k, position_world = inputs
        looks, missed = _looks(problem, model, pose, position_world)
        unfound = unfound * missed
        since = jnp.where(looks, 0, jnp.minimum(since + 1, steps - 1))
        unseen = _of_track(model, r, errors.unseen[k])
        seen = r * _of_track(model, jnp.ones_like(r), jnp.take_along_axis(errors.seen, since[None], axis=0)[0])
        expected = unfound * unseen + (1.0 - unfound) * seen
        return (unfound, since), jnp.sum(expected if left is None else left.tracks * expected)

    begin = jnp.ones_like(r), jnp.zeros(r.shape, int)
    return jax.lax.scan(step, begin, (way, jnp.arange(steps), errors.position_world))[1]


def of_undetected(
    problem: Problem,
    observation: Observation,
    found_error: Float[Array, " steps"],
    way: Pose,
    left: Left | None = None,
) -> Float[Array, " steps"]:
    """Expected cost after each step of targets undetected before the first one [targets]."""
    model, cells = detections_of(problem, observation)
    undetected, births = (_coarse(model, each) for each in (cells, model.births))
    coarse: DetectionModel = replace(model, grid=undetected.grid)
    cost = _of_track(model, jnp.ones_like(found_error), found_error)
    first = undetected.number if left is None else undetected.number * left.cells

    def step(carry, pose):
        number, found = carry  # `found` by the number of steps since the last look that has detected them
        chance = cell_detection(problem, coarse, pose).reshape(-1)
        newest = chance * (number + jnp.sum(found, axis=0))
        found = jnp.concatenate([newest[None], ((1.0 - chance) * found)[:-1]])
        number = (1.0 - chance) * number
        return (number + births.number, found), jnp.sum(number) + jnp.sum(cost[:, None] * found)

    return jax.lax.scan(step, (first, jnp.zeros((len(cost), len(first)), cells.dtype)), way)[1]


def missed_along(problem: Problem, observation: Observation, errors: Errors, way: Pose, left: Left) -> Left:
    """What is left after the looks of a way."""
    model, cells = detections_of(problem, observation)
    coarse: DetectionModel = replace(model, grid=_coarse(model, cells).grid)

    def step(left: Left, inputs: tuple) -> tuple[Left, None]:
        pose, position_world = inputs
        tracks = left.tracks * _looks(problem, model, pose, position_world)[1]
        return Left(tracks, left.cells * (1.0 - cell_detection(problem, coarse, pose).reshape(-1))), None

    return jax.lax.scan(step, left, (way, errors.position_world))[0]


def _coarse(model: DetectionModel, cells: Float[Array, "*cells"]) -> Undetected:
    """Expected numbers on the coarse cells of this module."""
    return undetected_of(model, cells, CELLS[len(model.grid.shape)])


def _looks(
    problem: Problem, model: DetectionModel, pose: Pose, position_world: Float[Array, "n d"]
) -> tuple[Bool[Array, " n"], Float[Array, " n"]]:
    """True for the tracks that a robot looks at from a pose, and the probability that it does not detect them."""
    body = problem.agent.space.to_body(pose, position_world)
    chance = model.probability_at(jnp.sqrt(jnp.sum(body**2, axis=-1)))
    looks = problem.sees(pose, position_world)
    return looks, jnp.where(looks, 1.0 - chance, 1.0)


def _of_track(model: DetectionModel, r: Float[Array, "*n"], error: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Expected cost of tracks of the existence r with this mean squared error [targets]."""
    loss = position_loss(error, model.cutoff)
    return jnp.where(r * (1.0 - loss) > model.confirm, 2.0 * r * loss + 1.0 - r, r)
