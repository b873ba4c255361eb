"""A method of your own beside all others, on the same scenes with the same noise:

    foveate reproduce --quick --add examples/own_method.py:METHOD

This one goes after the target that it knows least about, but takes a near one first.
"""

from typing import Any

import jax.numpy as jnp

from foveate.experiment.experiment import Experiment
from foveate.geometry.linalg import log_det_spd
from foveate.policies.heuristics import Steering
from foveate.simulation.records import Observation, Policy
from foveate.study.methods import Fixed
from foveate.types import Flag, Point

NATS_PER_METRE = 0.3
"""How much knowledge a metre of way is worth."""


class NearAndUncertain(Steering):
    """Steers to the target with the least log det of information plus price of the way."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """Where to go, whether there is anything to go to, and what to remember."""
        position = self.problem.motion.position(observation.mean)
        away = jnp.linalg.norm(position - self.problem.agent.space.position(observation.pose), axis=-1)
        cost = log_det_spd(observation.information) + NATS_PER_METRE * away
        choice = jnp.argmin(jnp.where(observation.present, cost, jnp.inf))
        return position[choice], observation.present.any(), memory


def make(experiment: Experiment) -> Policy:
    """Build the policy for an experiment: it stands off by half the depth of the view."""
    return NearAndUncertain(experiment.scenario.problem(), 0.5 * float(experiment.scenario.view.depth_m))


METHOD = Fixed(name="near-uncertain", make=make)
