"""Look ahead by the filter's own expectation: which way would leave the least GOSPA, of worlds without ids.

Ways lead to coarse places and to tracks. Along each the expected cost is predicted, in units of a missed target (c^2 /
2 of GOSPA's square): undetected targets count 1 until a look finds them, with the probability of detection, and births
count from their step. A track of existence r and error d counts r 2 E min(d^2, c^2) / c^2, and 1 - r, where it is
reported though it may be false, or r where it is not. After a look that finds it it exists, with the error after that
measurement, which grows from then on.

The robots of a team choose in turn (sequential greedy assignment, Atanasov et al. 2015): each works out the ways of
those before it by the same rule, from where it has heard them last, and leaves to them what they will see. Without that
all copies would run to the same place.
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
GOALS = {2: 6, 3: 4}
"""Most places along each axis that ways lead to, by the dimension of space."""
CELLS = {2: 10, 3: 6}
"""Most cells along each axis on which undetected targets are counted."""


class Errors(NamedTuple):
    """Mean squared errors of the tracks' positions [m^2] after each step: without a look, and since one."""

    unseen: Float[Array, "steps n"]
    seen: Float[Array, "steps n"]
    position_world: Float[Array, "steps n d"]


class Goals(NamedTuple):
    """Where ways lead to: the tracks, and then coarse places [m], with the expected cost [targets] and first action.

    `number` is that of the undetected targets expected at each of the places. Padding costs infinity.
    """

    position_world: Float[Array, "goals d"]
    cost: Float[Array, " goals"]
    action: Float[Array, "goals m"]
    number: Float[Array, " places"]


class Left(NamedTuple):
    """Shares of each track, and of undetected targets on coarse cells, that the looks of other robots leave."""

    tracks: Float[Array, " n"]
    cells: Float[Array, " cells"]


class LookAhead(Policy):
    """Takes the first action of the way that leaves the least expected GOSPA; in a team of what others leave."""

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
        errors = errors_ahead(problem, observation, self.steps)
        left = self._left_by_mates(problem, observation, errors)
        return self._goals(problem, observation, errors, left)[0]

    def _goals(
        self, problem: Problem, observation: Observation, errors: Errors, left: Left | None
    ) -> tuple[Goals, Float[Array, "goals steps ..."]]:
        """All goals from the pose of an observation, and the poses on the ways to them."""
        model, cells = detections_of(problem, observation)
        places = undetected_of(model, cells, GOALS[len(model.grid.shape)])
        goals = jnp.concatenate([problem.motion.position(observation.mean), places.position_world])
        poses, first = jax.vmap(lambda goal: _way(problem, observation.pose, goal, self.steps))(goals)
        cost = jax.vmap(lambda way: self.cost(problem, observation, errors, way, left))(poses)
        may = jnp.concatenate([observation.present, jnp.ones(len(places.number), bool)])
        return Goals(goals, jnp.where(may, cost, jnp.inf), first, places.number), poses

    def cost(
        self, problem: Problem, observation: Observation, errors: Errors, way: Pose, left: Left | None = None
    ) -> Float[Array, ""]:
        """Expected cost over the steps of a way, and the tail [targets], of what other robots leave."""
        weight = jnp.ones(self.steps).at[-1].add(self.tail)
        tracks = _of_tracks(problem, observation, errors, way, left)
        return jnp.sum(weight * (tracks + _of_undetected(problem, observation, way, left)))

    def _left_by_mates(self, problem: Problem, observation: Observation, errors: Errors) -> Left | None:
        """What the robots before this one leave on their ways; None where there are none, or none is ever heard."""
        team = observation.team
        if team is None or self.problem.team is None or self.problem.team.radio.kind == "silent":
            return None

        def take(left: Left, mate: tuple) -> tuple[Left, None]:
            number, pose, age = mate
            goals, ways = self._goals(problem, replace(observation, pose=pose), errors, left)
            after = _missed_along(problem, observation, errors, ways[jnp.argmin(goals.cost)], left)
            is_before = (number < team.number) & (age < self.steps)
            return jax.tree.map(lambda new, old: jnp.where(is_before, new, old), after, left), None

        places = undetected_of(*detections_of(problem, observation), CELLS[problem.agent.space.dimension])
        everything = Left(jnp.ones_like(observation.mean[:, 0]), jnp.ones_like(places.number))
        mates = jnp.arange(len(team.age)), team.pose, team.age
        return jax.lax.scan(take, everything, jax.tree.map(lambda x: x[:-1], mates))[0]


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
    """Errors of tracks that move on without a look, or after one in the first of the steps."""
    motion, sensor = problem.motion, problem.sensor
    covariance = inverse_spd(observation.information)
    after = inverse_spd(symmetrise(observation.information + sensor.information(sensor.V)))

    def of(covariance: Float[Array, "n n_y n_y"]) -> Float[Array, " n"]:
        return jnp.trace(multiply(multiply(motion.Z, covariance), motion.Z.T), axis1=-2, axis2=-1)

    def step(carry, _):
        unseen, seen, mean = carry
        errors = of(unseen), of(seen), motion.position(mean)
        ahead = [symmetrise(multiply(multiply(motion.A, P), motion.A.T) + motion.W) for P in (unseen, seen)]
        return (*ahead, motion.advance(mean, observation.known_input)), errors

    return Errors(*jax.lax.scan(step, (covariance, after, observation.mean), None, steps)[1])


def _missed_along(problem: Problem, observation: Observation, errors: Errors, way: Pose, left: Left) -> Left:
    """What is left after the looks of a way."""
    model, cells = detections_of(problem, observation)
    grid = undetected_of(model, cells, CELLS[len(model.grid.shape)]).grid
    coarse: DetectionModel = replace(model, grid=grid)

    def step(left: Left, inputs: tuple) -> tuple[Left, None]:
        pose, position_world = inputs
        body = problem.agent.space.to_body(pose, position_world)
        chance = model.probability_at(jnp.sqrt(jnp.sum(body**2, axis=-1)))
        tracks = jnp.where(problem.sees(pose, position_world), left.tracks * (1.0 - chance), left.tracks)
        return Left(tracks, left.cells * (1.0 - cell_detection(problem, coarse, pose).reshape(-1))), None

    return jax.lax.scan(step, left, (way, errors.position_world))[0]


def _of_tracks(
    problem: Problem, observation: Observation, errors: Errors, way: Pose, left: Left | None
) -> Float[Array, " steps"]:
    """Expected cost of the tracks after each step [targets]."""
    model, r = problem.detections, observation.existence
    assert model is not None, "for problems with detections"
    assert r is not None, "observations of detections without ids have it"
    r, steps = jnp.where(observation.present, r, 0.0), len(errors.unseen)

    def cost(existence: Float[Array, " n"], error: Float[Array, " n"]) -> Float[Array, " n"]:
        loss = position_loss(error, model.cutoff)
        is_reported = existence * (1.0 - loss) > model.confirm
        return jnp.where(is_reported, 2.0 * existence * loss + 1.0 - existence, existence)

    def step(carry, inputs):
        unfound, since = carry
        pose, k, position_world = inputs
        body = problem.agent.space.to_body(pose, position_world)
        chance = model.probability_at(jnp.sqrt(jnp.sum(body**2, axis=-1)))
        looks = problem.sees(pose, position_world)
        unfound = jnp.where(looks, unfound * (1.0 - chance), unfound)
        since = jnp.where(looks, 0, jnp.minimum(since + 1, steps - 1))
        unseen = cost(r, errors.unseen[k])
        seen = r * cost(jnp.ones_like(r), jnp.take_along_axis(errors.seen, since[None], axis=0)[0])
        expected = unfound * unseen + (1.0 - unfound) * seen
        return (unfound, since), jnp.sum(expected if left is None else left.tracks * expected)

    begin = jnp.ones_like(r), jnp.zeros(r.shape, int)
    return jax.lax.scan(step, begin, (way, jnp.arange(steps), errors.position_world))[1]


def _of_undetected(
    problem: Problem, observation: Observation, way: Pose, left: Left | None = None
) -> Float[Array, " steps"]:
    """Expected number of undetected targets after each step."""
    model, cells = detections_of(problem, observation)
    most = CELLS[len(model.grid.shape)]
    found, births = (undetected_of(model, each, most) for each in (cells, model.births))
    coarse: DetectionModel = replace(model, grid=found.grid)
    number = found.number if left is None else found.number * left.cells

    def step(number, pose):
        number = number * (1.0 - cell_detection(problem, coarse, pose).reshape(-1))
        return number + births.number, jnp.sum(number)

    return jax.lax.scan(step, number, way)[1]
