"""Compare your own method with all others, on the same scenes with the same noise:

    foveate reproduce --quick --add examples/own_method.py:METHOD

This one drives to the least known target, with a preference for near ones.
"""

from typing import Any

import jax
import jax.numpy as jnp

import foveate

NATS_PER_METRE = 0.3
"""Price of a metre of distance in information [nat]."""


class NearAndUncertain(foveate.Steering):
    """Steers to the target with the least sum of log det of information and price of the distance."""

    def goal(self, observation: foveate.Observation, memory: Any) -> tuple[jax.Array, jax.Array, Any]:
        """Return the goal's position in the world [m], a flag for its existence, and the memory for the next step."""
        position_world = self.problem.motion.position(observation.mean)
        distance = jnp.linalg.norm(position_world - self.problem.agent.space.position(observation.pose), axis=-1)
        cost = jnp.linalg.slogdet(observation.information).logabsdet + NATS_PER_METRE * distance
        choice = jnp.argmin(jnp.where(observation.present, cost, jnp.inf))
        return position_world[choice], observation.present.any(), memory


def make(experiment: foveate.Experiment) -> foveate.Policy:
    """Build the policy for an experiment, with a stand-off distance of half the view's depth."""
    scenario = experiment.scenario
    return NearAndUncertain(scenario.problem(), 0.5 * float(scenario.view.depth_m))


METHOD = foveate.Fixed(name="near-uncertain", make=make)
