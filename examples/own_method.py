"""A method of your own beside all others, on the same scenes with the same noise:

    foveate reproduce --quick --add examples/own_method.py:METHOD

This one goes to the target that it knows least about, but takes a near one first.
"""

from typing import Any

import jax
import jax.numpy as jnp

import foveate

NATS_PER_METRE = 0.3
"""Information that a metre of the way is worth."""


class NearAndUncertain(foveate.Steering):
    """Steers to the target with the least log det of information plus price of the way."""

    def goal(self, observation: foveate.Observation, memory: Any) -> tuple[jax.Array, jax.Array, Any]:
        """Position of the goal in the world [m], whether there is one, and the memory for the next step."""
        position_world = self.problem.motion.position(observation.mean)
        distance = jnp.linalg.norm(position_world - self.problem.agent.space.position(observation.pose), axis=-1)
        cost = jnp.linalg.slogdet(observation.information).logabsdet + NATS_PER_METRE * distance
        choice = jnp.argmin(jnp.where(observation.present, cost, jnp.inf))
        return position_world[choice], observation.present.any(), memory


def make(experiment: foveate.Experiment) -> foveate.Policy:
    """Build the policy for an experiment: it stands off by half the depth of the view."""
    scenario = experiment.scenario
    return NearAndUncertain(scenario.problem(), 0.5 * float(scenario.view.depth_m))


METHOD = foveate.Fixed(name="near-uncertain", make=make)
