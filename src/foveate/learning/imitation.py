"""Lessons before the ascent: the policy learns to act as one made by hand does (Ross 2011, "DAgger").

It acts itself, and is told at every step what its teacher would do there. So it begins its own ascent where episodes
succeed: a fresh network often ends up circling far from all targets, where no gradient leads on.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.learner_settings import TrainingSettings
from foveate.problem import Episode, Policy, Problem
from foveate.rollout import act, instants, observe, predict, start
from foveate.types import Key


def likeness(
    problem: Problem, policy: Policy, teacher: Policy, episode: Episode, settings: TrainingSettings, key: Key
) -> Float[Array, ""]:
    """Minus the squared difference of the two's normalised actions, in the mean over the steps of an episode.

    Which states the policy comes to is taken as given: the derivative is that of its answers.
    """
    protocol = settings.protocol

    def step(carry, instant):
        state, own, its = carry
        own_key, its_key = jax.random.split(jax.random.fold_in(key, state.step))
        predicted = predict(problem, state, instant.known_input)
        observation = observe(predicted, instant.known_input, episode.horizon)
        action, own = policy(observation, own, own_key)
        wanted, its = teacher(observation, its, its_key)
        state = act(problem, protocol, predicted, instant, jax.lax.stop_gradient(action))[0]
        return (state, own, its), jnp.sum((action - jax.lax.stop_gradient(wanted)) ** 2)

    first = start(problem, episode, protocol)
    observation = observe(predict(problem, first, episode.inputs[0]), episode.inputs[0], episode.horizon)
    begin = (first, policy.start(observation), teacher.start(observation))
    difference = jax.lax.scan(step, begin, instants(episode))[1]
    return -jnp.mean(difference, where=jnp.arange(len(difference)) < episode.horizon)
