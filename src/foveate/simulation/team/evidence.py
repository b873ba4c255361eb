"""What one robot of a team has measured of every target in a step, and the beliefs that its step has begun."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.models.belief import Belief
from foveate.models.fusion import Evidence, evidence_of, linear_pull
from foveate.models.problem import Problem
from foveate.simulation.draft import Draft
from foveate.simulation.team.window import Fresh


def fresh(draft: Draft) -> Fresh:
    """Beliefs that a robot's own step has begun."""
    begins = jnp.zeros_like(draft.measured) if draft.restart is None else draft.restart[0]
    if draft.instant.arrivals is not None:
        begins = begins | (draft.state.present & ~draft.predicted.present)
    return Fresh(begins, draft.state.mean, draft.state.information[-1])


def evidence(problem: Problem, draft: Draft, reference: Float[Array, "n n_y"]) -> Evidence:
    """What one robot has measured of every target in a step."""
    before, corrected, measured, weight = draft.predicted, draft.state.mean, draft.measured, draft.weight
    if draft.restart is not None or draft.instant.arrivals is not None:
        # A belief that begins is told as such: its mean is no correction of the one before, and nothing is beside it.
        begins = fresh(draft).begins
        measured, weight = measured & ~begins, jnp.where(begins, 0.0, weight)
        corrected = jnp.where(begins[:, None], before.mean, corrected)
    gain = jax.vmap(problem.sensor.information)(draft.covariance) if draft.gain is None else draft.gain
    taken = jnp.where(measured[:, None, None], gain, 0.0)
    weighed = weight[..., None, None] * gain
    growth = jnp.moveaxis(jnp.where(weight[..., None, None] > 0, weighed, 0.0), 0, 1)
    if problem.sensor.polar is None and draft.sensed is not None:
        # Not from the corrected mean: a team that exchanges at once needs no correction by each robot.
        pull = jax.vmap(linear_pull, (None, 0, 0, 0))(
            problem.sensor.H, draft.covariance, draft.sensed.measurement, reference
        )
        return Evidence(taken, jnp.where(measured[:, None], pull, 0.0), growth)

    def of(mean, information, gain, growth, corrected, reference):
        return evidence_of(Belief(mean, information), gain, growth, corrected, reference)

    return jax.vmap(of)(before.mean, before.information[-1], taken, growth, corrected, reference)
