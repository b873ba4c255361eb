"""Look ahead by the filter's own expectation: which way would leave the least GOSPA, of worlds without ids.

Ways lead to coarse places and to tracks; what each is expected to cost is in `policies.expected_cost`.

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

from foveate.models.problem import Problem
from foveate.policies.expected_cost import (
    CELLS,
    Errors,
    Left,
    errors_ahead,
    missed_along,
    of_tracks,
    of_undetected,
)
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


class Goals(NamedTuple):
    """Where ways lead to: the tracks, and then coarse places [m], with the expected cost [targets] and first action.

    `number` is that of the undetected targets expected at each of the places. Padding costs infinity.
    """

    position_world: Float[Array, "goals d"]
    cost: Float[Array, " goals"]
    action: Float[Array, "goals m"]
    number: Float[Array, " places"]


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
        tracks = of_tracks(problem, observation, errors, way, left)
        return jnp.sum(weight * (tracks + of_undetected(problem, observation, errors.found, way, left)))

    def _left_by_mates(self, problem: Problem, observation: Observation, errors: Errors) -> Left | None:
        """What the robots before this one leave on their ways; None where there are none, or none is ever heard."""
        team = observation.team
        if team is None or self.problem.team is None or self.problem.team.radio.kind == "silent":
            return None

        def take(left: Left, mate: tuple) -> tuple[Left, None]:
            number, pose, age = mate
            goals, ways = self._goals(problem, replace(observation, pose=pose), errors, left)
            after = missed_along(problem, observation, errors, ways[jnp.argmin(goals.cost)], left)
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
        after = problem.move(pose, action, None)
        return after, (after, action)

    poses, actions = jax.lax.scan(step, pose, None, steps)[1]
    return poses, actions[0]
