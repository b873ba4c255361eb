"""Starts of a planner's ascent: straight ahead, as in the publication, and tours from target to target.

Random controls rarely pass near more than one target, and a soft view has no gradient at distant targets.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.fov import FieldOfView
from foveate.geometry.fov_spatial import Prism
from foveate.models.problem import Problem
from foveate.policies.detour import steer_to
from foveate.simulation.information import Future
from foveate.types import Key, Scalar

MAX_START_ACTION = 0.9
"""Largest size of an action that an ascent starts from: at the limits, +-1, tanh has no gradient."""

MAX_DWELL = 3
"""Most looks of a tour at a target before it turns to the next."""

PREFERENCE_STD = 0.7
"""Std of the log factors by which each tour rescales its distances to the targets."""

RAW_ACTION_STD = 0.2
"""Std of the noise on a tour's raw actions."""


def straight_ahead(problem: Problem, steps: int) -> Float[Array, "K m"]:
    """Raw actions in the middle of every control's range: half speed and no turn for a vehicle."""
    return jnp.zeros((steps, len(problem.agent.axes)))


def best_range(view: FieldOfView) -> Scalar:
    """Range straight ahead at which a target is deepest in view [m]; 0 for a view without bounds ahead."""
    if isinstance(view, Prism):
        return best_range(view.base)
    ahead = jnp.linspace(0.0, 1.0, 101) * jnp.where(jnp.isfinite(view.depth), view.depth, 0.0)
    points = jnp.zeros((len(ahead), view.dimension)).at[:, 0].set(ahead)
    return ahead[jnp.argmin(view.signed_distance(points))]


def tours(problem: Problem, future: Future, count: int, key: Key) -> Float[Array, "count K m"]:
    """Raw actions that steer to the least observed target, the nearest of equals by the tour's rescaled distances."""
    standoff_m = best_range(problem.sensor.view)
    return jax.vmap(lambda k: _tour(problem, future, standoff_m, k))(jax.random.split(key, count))


def _tour(problem: Problem, future: Future, standoff_m: Scalar, key: Key) -> Float[Array, "K m"]:
    problem, agent = problem.of_map(future.map_number), problem.agent
    preference_key, dwell_key, noise_key = jax.random.split(key, 3)
    targets = len(future.present)
    # Tours must differ: each has its own order of the targets and its own time at each.
    preference = jnp.exp(PREFERENCE_STD * jax.random.normal(preference_key, (targets,)))
    dwell = jax.random.randint(dwell_key, (), 1, MAX_DWELL + 1)

    def step(carry, now):
        pose, looks = carry
        state, bodies = now
        positions_world = problem.motion.position(state)
        points_body = agent.space.to_body(pose, positions_world)
        distance = preference * jnp.sqrt(jnp.sum(points_body**2, axis=-1))
        rounds = jnp.where(future.present, looks // dwell, len(future.state))
        distance = jnp.where(rounds == jnp.min(rounds), distance, jnp.inf)
        action = steer_to(problem, pose, positions_world[jnp.argmin(distance)], standoff_m, bodies)
        pose = problem.move(pose, action, bodies)
        seen = problem.sees(pose, positions_world)
        return (pose, jnp.where(seen, looks + 1, looks)), action

    action = jax.lax.scan(step, (future.pose, jnp.zeros(targets, int)), (future.state, future.in_the_way(problem)))[1]
    raw = jnp.arctanh(jnp.clip(action, -MAX_START_ACTION, MAX_START_ACTION))
    return raw + RAW_ACTION_STD * jax.random.normal(noise_key, raw.shape)
