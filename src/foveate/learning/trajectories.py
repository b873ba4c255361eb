"""Trajectories of the actor-critic: windows of full noisy episodes, with their rewards and advantages.

Those of windows have the critic's value of what comes after.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.experiment.learners import Objective
from foveate.geometry.linalg import log_det_spd
from foveate.learning.learner import step_scores
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.policies.pointer import Modes, PointerPolicy, command
from foveate.policies.tokens import Tokens
from foveate.simulation.records import Episode, Observation, Protocol, State, observe, per_target
from foveate.simulation.rollout import Outcome, simulate
from foveate.simulation.scans import expected
from foveate.simulation.step import predict
from foveate.types import Count, Key, Scalar


class Trajectory(NamedTuple):
    """Every step of a window; `counts` marks those before the end of the episode, `ends` its last step.

    `tokens` has one more, after the last step.
    """

    tokens: Tokens
    action: Float[Array, "K n_u"]
    log_density: Float[Array, " K"]
    reward: Float[Array, " K"]
    counts: Bool[Array, " K"]
    ends: Bool[Array, " K"]
    seen: Tokens | None = None
    """What a critic is told, where that is more than the tokens: those of all robots of a team, as of one set."""


def log_density(modes: Modes, action: Float[Array, " n_u"], action_std: Float[Array, " n_u"]) -> Scalar:
    """log of the mixture's density at an action, up to a constant that depends on `action_std` only.

    Axes with a standard deviation of 0, which the robot lacks, are left out.
    """
    away = (action - modes.action) / jnp.where(action_std > 0, action_std, jnp.inf)
    exponent = 0.5 * jnp.sum(away**2, axis=-1)
    return jax.nn.logsumexp(jax.nn.log_softmax(modes.log_weight) - exponent)


class Sample(NamedTuple):
    """An action that was sampled from a policy, what the policy was told, and the log density of the action."""

    tokens: Tokens
    action: Float[Array, " n_u"]
    log_density: Scalar


def sampled(
    policy: PointerPolicy, observation: Observation, action_std: Scalar, key: Key
) -> tuple[Int[Array, ""], Sample]:
    """An action about that of a mode, itself sampled by its weight, and the mode; `action_std` in units of the view."""
    mode_key, noise_key = jax.random.split(key)
    tokens = policy.tokens(observation)
    modes = policy.modes(tokens)
    mode = jax.random.categorical(mode_key, modes.log_weight)
    std = action_std * tokens.unit
    action = modes.action[mode] + std * jax.random.normal(noise_key, std.shape)
    # The density is that of the sampled action, before the agent clips it.
    return mode, Sample(tokens, action, log_density(modes, action, std))


def play(
    problem: Problem,
    policy: PointerPolicy,
    episode: Episode,
    protocol: Protocol,
    objective: Objective,
    action_std: Scalar,
    key: Key,
    state: State,
    ends: Count,
    discounted: bool,
    whole: bool,
) -> tuple[Trajectory, State]:
    """Play the steps of an episode, or of a part of it, from a state; return them and the state after the last.

    Actions are `sampled`.
    """
    assert episode.truth is not None, "training episodes are noisy"
    following, here = episode.inputs[-1], problem.of_map(episode.map_number)
    episode = replace(episode, inputs=episode.inputs[: len(episode.truth.measurement_noise)])

    def decide(observation, memory, key):
        _, sample = sampled(policy, observation, action_std, key)
        return command(observation, sample.action), memory, sample

    def record(done: Outcome):
        log_det = jnp.mean(log_det_spd(done.state.information), axis=0)
        return done.notes, log_det, done.measured, expected(here, done.state).get("expected_gospa"), done.state

    sample, log_det, visible, gospa, states = simulate(problem, decide, episode, protocol, key, record, state=state)
    last: State = jax.tree.map(lambda x: x[-1], states)
    predicted = predict(problem, last, following)
    after = policy.tokens(observe(predicted, following, episode.horizon, Robot.of(here)))
    tokens = jax.tree.map(lambda x, y: jnp.concatenate([x, y[None]]), sample.tokens, after)
    first = per_target(jnp.mean(log_det_spd(state.information), axis=0), state.present)
    if gospa is None:
        reward = rewards(log_det, visible, first, episode, objective, discounted, whole)
    else:
        reward = -gospa / (episode.horizon.astype(gospa.dtype) if whole else 1.0)
    step = state.step + jnp.arange(len(reward))
    counts = step < ends
    reward = jnp.where(counts, reward, 0.0)
    return Trajectory(tokens, sample.action, sample.log_density, reward, counts, step == ends - 1), last


def rewards(
    log_det: Float[Array, "K n"],
    visible: Bool[Array, "K n"],
    first: Scalar,
    episode: Episode,
    objective: Objective,
    discounted: bool,
    whole: bool,
) -> Float[Array, " K"]:
    """Rewards of all steps.

    Of `whole` episodes their sum is the objective, with "terminal" less `first`, the log det before the first step
    [nat]; of windows their mean is. With a discount g they are the growth of log det for "mean" too: sum g^k (s_k+1 -
    s_k) is (1 - g) sum g^k s_k+1 less a constant, and a critic of the growth need not know what is known already.
    """
    scores = step_scores(visible.astype(log_det.dtype) if objective == "seen" else log_det, episode)
    if objective == "terminal" or (discounted and objective == "mean"):
        return jnp.diff(scores, prepend=first)
    return scores / episode.horizon.astype(scores.dtype) if whole else scores


def advantages(
    trajectory: Trajectory, value: Float[Array, " instants"], discount: float, gae_lambda: float
) -> Float[Array, " K"]:
    """A_k = delta_k + g lambda A_{k+1}, delta_k = r_k + g V_{k+1} - V_k, 0 after the end (Schulman 2016).

    Without a discount the value after the end of an episode is 0: time is up. With one, the end is where we stopped
    looking, and watching would have continued.
    """
    is_last = trajectory.ends
    worth = jnp.where(is_last, 0.0, value[1:]) if discount == 1.0 else value[1:]
    delta = trajectory.reward + discount * worth - value[:-1]

    def step(following, inputs):
        delta, count, last = inputs
        kept = jnp.where(last, 0.0, following)
        advantage = jnp.where(count, delta + discount * gae_lambda * kept, 0.0)
        return advantage, advantage

    parts = (delta, trajectory.counts, is_last)
    return jax.lax.scan(step, jnp.zeros_like(value[0]), parts, reverse=True)[1]
