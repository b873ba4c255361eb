"""Where ascent begins: straight ahead, as the publication has it, and tours that look at one target after another.

Random controls rarely pass near more than one target, and a soft view has no gradient at what is far away.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.fov import FieldOfView
from foveate.geometry.fov_spatial import Prism
from foveate.models.problem import Problem
from foveate.planning.information import Future
from foveate.policies.heuristics import twist_towards
from foveate.types import Key, Scalar

FULLEST = 0.9
"""How near to the limits of the controls a tour goes: at them tanh has no gradient."""


DWELL = 3
"""Most looks that a tour spends on a target before it turns to the next."""


SPREAD = 0.7
"""Standard deviation of the logarithm of a tour's taste for each target."""


JITTER = 0.2
"""Standard deviation of the noise on a tour's raw actions."""


def straight_ahead(problem: Problem, steps: int) -> Float[Array, "K m"]:
    """Raw actions in the middle of every control's range: for a vehicle half speed, no turn."""
    return jnp.zeros((steps, len(problem.agent.axes)))


def best_range(view: FieldOfView) -> Scalar:
    """How far straight ahead a target is deepest in view [m]; 0 for a view without bounds ahead."""
    if isinstance(view, Prism):
        return best_range(view.base)
    ahead = jnp.linspace(0.0, 1.0, 101) * jnp.where(jnp.isfinite(view.depth), view.depth, 0.0)
    points = jnp.zeros((len(ahead), view.dimension)).at[:, 0].set(ahead)
    return ahead[jnp.argmin(view.signed_distance(points))]


def tours(problem: Problem, future: Future, count: int, key: Key) -> Float[Array, "count K m"]:
    """Raw actions that steer to the target least looked at, among equals to the nearest by the tour's own taste."""
    standoff_m = best_range(problem.sensor.view)
    return jax.vmap(lambda k: _tour(problem, future, standoff_m, k))(jax.random.split(key, count))


def _tour(problem: Problem, future: Future, standoff_m: Scalar, key: Key) -> Float[Array, "K m"]:
    agent, view = problem.agent, problem.sensor.view
    taste_key, dwell_key, jitter_key = jax.random.split(key, 3)
    targets = len(future.present)
    taste = jnp.exp(SPREAD * jax.random.normal(taste_key, (targets,)))
    dwell = jax.random.randint(dwell_key, (), 1, DWELL + 1)

    def step(carry, state):
        pose, looks = carry
        points = agent.space.to_body(pose, problem.motion.position(state))
        away = taste * jnp.sqrt(jnp.sum(points**2, axis=-1))
        rounds = jnp.where(future.present, looks // dwell, len(future.state))
        away = jnp.where(rounds == jnp.min(rounds), away, jnp.inf)
        twist = twist_towards(points[jnp.argmin(away)], standoff_m, problem.tau)
        action = agent.action(twist[jnp.array(agent.axes)])
        pose = agent.move(pose, action, problem.tau)
        seen = view.contains(agent.space.to_body(pose, problem.motion.position(state)))
        return (pose, jnp.where(seen, looks + 1, looks)), action

    action = jax.lax.scan(step, (future.pose, jnp.zeros(targets, int)), future.state)[1]
    raw = jnp.arctanh(jnp.clip(action, -FULLEST, FULLEST))
    return raw + JITTER * jax.random.normal(jitter_key, raw.shape)
