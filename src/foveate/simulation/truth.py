"""The true motion of targets, which the agent does not influence."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.models.problem import Problem
from foveate.models.target import LinearGaussian


class Newcomers(NamedTuple):
    """New targets in place of old ones: where `begins`, the target has this `state` after the step."""

    begins: Bool[Array, "K n"]
    state: Float[Array, "K n n_y"]


def true_states(
    problem: Problem,
    first: Float[Array, "n n_y"],
    drift: Float[Array, "n d"] | None,
    inputs: Float[Array, "K n m_y"],
    pushes: Float[Array, "K n n_y"],
    newcomers: Newcomers | None = None,
) -> tuple[Float[Array, "instants n n_y"], Float[Array, "K n m_y"]]:
    """The states y_0 .. y_K of all targets, and their inputs as borders and obstacles have changed them.

    Args:
        problem: Models of agent, sensor and targets, with the region and the obstacles.
        first: States y_0.
        drift: Velocities [m/s] that the inputs contain, of targets that are positions; None for others.
        inputs: The inputs xi of every step.
        pushes: The process noise w of every step.
        newcomers: Targets that begin later, if any does.
    """
    period = problem.period
    entry = jnp.arange(len(inputs)) % len(period.tau)
    motions = jax.tree.map(lambda part: part[entry], period.motion)
    if problem.bounds_targets or problem.turns_targets:
        return _bounded(problem, first, drift, inputs, pushes, motions, period.tau[entry], newcomers)

    def move(state, step):
        motion, known_input, push, new = step
        after = _begun(motion.advance(state, known_input) + push, new)
        return after, after

    return jnp.concatenate([first[None], jax.lax.scan(move, first, (motions, inputs, pushes, newcomers))[1]]), inputs


def _begun(state: Float[Array, "n n_y"], new: Newcomers | None) -> Float[Array, "n n_y"]:
    """The states after a step, those of new targets included."""
    return state if new is None else jnp.where(new.begins[:, None], new.state, state)


def _bounded(
    problem: Problem,
    first: Float[Array, "n n_y"],
    drift: Float[Array, "n d"] | None,
    inputs: Float[Array, "K n m_y"],
    pushes: Float[Array, "K n n_y"],
    motions: LinearGaussian,
    taus: Float[Array, " K"],
    newcomers: Newcomers | None,
) -> tuple[Float[Array, "instants n n_y"], Float[Array, "K n m_y"]]:
    """The same in a region whose borders targets keep, where they are put back, or among obstacles that they go around.

    At an obstacle the rest of a step slides along it, and a velocity into it is reflected.
    """
    region, d = problem.region, problem.agent.space.dimension

    def move(carry, step):
        state, velocity = carry
        motion, known_input, push, tau, new = step
        if drift is not None:
            known_input = known_input + tau * (velocity - drift)
        after = motion.advance(state, known_input) + push
        # The state is d-vectors: position, velocity, ..; a drift is the velocity of a state without one.
        blocks = [after[:, i : i + d] for i in range(0, after.shape[1], d)]
        if problem.bounds_targets:
            assert region is not None, "for problems whose targets keep borders"
            *blocks, velocity = region.put_back(*blocks, velocity)
        if problem.turns_targets:
            assert problem.obstacles is not None, "for problems whose targets go around obstacles"
            *blocks, velocity = jax.vmap(problem.obstacles.go_around)(state[:, :d], *blocks, velocity)
        after = _begun(jnp.concatenate(blocks, axis=1), new)
        return (after, velocity), (after, known_input)

    begin = (first, jnp.zeros_like(first[:, :d]) if drift is None else drift)
    states, executed = jax.lax.scan(move, begin, (motions, inputs, pushes, taus, newcomers))[1]
    return jnp.concatenate([first[None], states]), executed
