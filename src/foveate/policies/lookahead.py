"""Look ahead by the filter's own expectation: which way would leave the least GOSPA, of worlds without ids.

Ways lead to coarse places and to tracks. Along each the expected cost is predicted, in units of a missed target (c^2 /
2 of GOSPA's square): undetected targets count 1 until a look finds them, with the probability of detection, and births
count from their step. A track of existence r and error d counts r 2 E min(d^2, c^2) / c^2, and 1 - r, where it is
reported though it may be false, or r where it is not. After a look that finds it it exists, with the error after that
measurement, which grows from then on. So does the error of a target found on the way, once it is left behind.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import inverse_spd, multiply, symmetrise
from foveate.models.detections.expectation import position_loss
from foveate.models.detections.records import DetectionModel
from foveate.models.detections.visibility import cell_detection
from foveate.models.problem import Problem
from foveate.policies.search import detections_of, undetected_of
from foveate.policies.steering import steer
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key, Point, Pose

STEPS = 10
"""Steps of a way."""
TAIL = 5.0
"""Further steps for which the cost at the end of a way counts."""
LOOKS = 4
"""Looks after which the velocity of a target found on the way is known as well as it counts here."""
GOALS = {2: 6, 3: 4}
"""Most places along each axis that ways lead to, by the dimension of space."""
CELLS = {2: 10, 3: 6}
"""Most cells along each axis on which undetected targets are counted."""


class Errors(NamedTuple):
    """Mean squared errors of positions [m^2] by the number of steps: of tracks without a look, and since one.

    `found` is that of a target found on the way, since its last look; `position_world` are the tracks' means [m].
    """

    unseen: Float[Array, "steps n"]
    seen: Float[Array, "steps n"]
    found: Float[Array, " steps"]
    position_world: Float[Array, "steps n d"]


class Goals(NamedTuple):
    """Where ways lead to: the tracks, and then coarse places [m], with the expected cost [targets] and first action.

    `number` is that of the undetected targets expected at each of the places. Padding costs infinity.
    """

    position_world: Float[Array, "goals d"]
    cost: Float[Array, " goals"]
    action: Float[Array, "goals m"]
    number: Float[Array, " places"]


class LookAhead(Policy):
    """Takes the first action of the way that leaves the least expected GOSPA."""

    problem: Problem
    steps: int = eqx.field(static=True, default=STEPS)
    tail: float = eqx.field(static=True, default=TAIL)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The first action to the best of places and tracks."""
        goals = self.goals(observation)
        return goals.action[jnp.argmin(goals.cost)], memory

    def goals(self, observation: Observation) -> Goals:
        """All tracks and places, with the costs of the ways to them."""
        problem = self.problem.at(observation.step).of_map(observation.map_number)
        model, cells = detections_of(problem, observation)
        places = undetected_of(model, cells, GOALS[len(model.grid.shape)])
        goals = jnp.concatenate([problem.motion.position(observation.mean), places.position_world])
        poses, first = jax.vmap(lambda goal: _way(problem, observation.pose, goal, self.steps))(goals)
        errors = errors_ahead(problem, observation, self.steps)
        cost = jax.vmap(lambda way: self.cost(problem, observation, errors, way))(poses)
        may = jnp.concatenate([observation.present, jnp.ones(len(places.number), bool)])
        return Goals(goals, jnp.where(may, cost, jnp.inf), first, places.number)

    def cost(self, problem: Problem, observation: Observation, errors: Errors, way: Pose) -> Float[Array, ""]:
        """Expected cost over the steps of a way, and the tail [targets]."""
        weight = jnp.ones(self.steps).at[-1].add(self.tail)
        tracks = _of_tracks(problem, observation, errors, way)
        return jnp.sum(weight * (tracks + _of_undetected(problem, observation, errors.found, way)))


def _way(problem: Problem, pose: Pose, goal: Point, steps: int) -> tuple[Float[Array, "steps ..."], Action]:
    """Poses on the way to a goal, and the first action."""
    agent = problem.agent

    def step(pose, _):
        action = steer(agent, problem.tau, agent.space.to_body(pose, goal), 0.0)
        after = problem.move(pose, action, None, jnp.zeros(0, bool))
        return after, (after, action)

    poses, actions = jax.lax.scan(step, pose, None, steps)[1]
    return poses, actions[0]


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
        *covariances, mean = carry
        ahead = [_ahead(problem, P) for P in covariances]
        errors = *map(of, covariances), motion.position(mean)
        return (*ahead, motion.advance(mean, observation.known_input)), errors

    return Errors(*jax.lax.scan(step, (covariance, after, found, observation.mean), None, steps)[1])


def _looked(problem: Problem, information: Float[Array, "*n n_y n_y"]) -> Float[Array, "*n n_y n_y"]:
    """Covariance after a measurement."""
    return inverse_spd(symmetrise(information + problem.sensor.information(problem.sensor.V)))


def _ahead(problem: Problem, covariance: Float[Array, "*n n_y n_y"]) -> Float[Array, "*n n_y n_y"]:
    """Covariance one step later."""
    A, W = problem.motion.A, problem.motion.W
    return symmetrise(multiply(multiply(A, covariance), A.T) + W)


def _of_tracks(problem: Problem, observation: Observation, errors: Errors, way: Pose) -> Float[Array, " steps"]:
    """Expected cost of the tracks after each step [targets]."""
    model, r = problem.detections, observation.existence
    assert model is not None, "for problems with detections"
    assert r is not None, "observations of detections without ids have it"
    r, steps = jnp.where(observation.present, r, 0.0), len(errors.unseen)

    def step(carry, inputs):
        unfound, since = carry
        pose, k, position_world = inputs
        body = problem.agent.space.to_body(pose, position_world)
        chance = model.probability_at(jnp.sqrt(jnp.sum(body**2, axis=-1)))
        looks = problem.sees(pose, position_world)
        unfound = jnp.where(looks, unfound * (1.0 - chance), unfound)
        since = jnp.where(looks, 0, jnp.minimum(since + 1, steps - 1))
        unseen = _of_existence(model, r, errors.unseen[k])
        seen = r * _of_existence(model, jnp.ones_like(r), jnp.take_along_axis(errors.seen, since[None], axis=0)[0])
        return (unfound, since), jnp.sum(unfound * unseen + (1.0 - unfound) * seen)

    begin = jnp.ones_like(r), jnp.zeros(r.shape, int)
    return jax.lax.scan(step, begin, (way, jnp.arange(steps), errors.position_world))[1]


def _of_existence(model: DetectionModel, r: Float[Array, "*n"], error: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Expected cost of tracks of the existence r with this mean squared error [targets]."""
    loss = position_loss(error, model.cutoff)
    return jnp.where(r * (1.0 - loss) > model.confirm, 2.0 * r * loss + 1.0 - r, r)


def _of_undetected(
    problem: Problem, observation: Observation, found_error: Float[Array, " steps"], way: Pose
) -> Float[Array, " steps"]:
    """Expected cost after each step of targets undetected before the first one [targets]."""
    model, cells = detections_of(problem, observation)
    most = CELLS[len(model.grid.shape)]
    undetected, births = (undetected_of(model, each, most) for each in (cells, model.births))
    coarse: DetectionModel = replace(model, grid=undetected.grid)
    cost = _of_existence(model, jnp.ones_like(found_error), found_error)

    def step(carry, pose):
        left, found = carry  # `found` by the number of steps since the last look that has detected them
        chance = cell_detection(problem, coarse, pose).reshape(-1)
        newest = chance * (left + jnp.sum(found, axis=0))
        found = jnp.concatenate([newest[None], ((1.0 - chance) * found)[:-1]])
        left = (1.0 - chance) * left
        return (left + births.number, found), jnp.sum(left) + jnp.sum(cost[:, None] * found)

    nothing = jnp.zeros((len(cost), len(undetected.number)), cells.dtype)
    return jax.lax.scan(step, (undetected.number, nothing), way)[1]
