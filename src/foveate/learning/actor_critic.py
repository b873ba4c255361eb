"""Learning by trying: proximal policy optimisation (Schulman 2017) of a policy of modes, on the world as it is.

The gradient through a soft view leads uphill from where a policy is; it cannot say that another target would have been
the better one to go to, and it is not that of the real view. Here the policy tries its modes in whole batched episodes
with truth, noise and the real filter, and a critic, thrown away afterwards, says how well a try turned out. Episodes
are short, so that all of each is played, and no value is guessed beyond its end.
"""

import math
from collections.abc import Hashable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from foveate.errors import InputError
from foveate.experiment.learners import ActorCriticSettings, Objective
from foveate.geometry.linalg import log_det_spd
from foveate.learning.learner import EpochReport, Learner
from foveate.learning.objective import step_scores
from foveate.models.problem import Problem
from foveate.policies.inputs import pointer_feature_count
from foveate.policies.layers import Layers, fresh_layers
from foveate.policies.pointer import Modes, PointerPolicy, SetEncoder
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, Episode, Observation, Policy, Protocol, per_target
from foveate.simulation.rollout import Outcome, simulate
from foveate.simulation.step import start
from foveate.types import Action, Key, Scalar

CRITIC_WIDTH, CRITIC_QUERIES, CRITIC_LENGTH_M = 64, 4, 5.0
"""Of the network that values states: it is no part of what is kept."""


class Critic(eqx.Module):
    """What is still to be earned in the mean, from a state as the policy sees it."""

    encoder: SetEncoder
    value_layers: Layers

    def __call__(self, observation: Observation) -> Scalar:
        """The value of a state [nat per target, or share of time]."""
        hidden = self.encoder(observation)[1]
        for layer in self.value_layers[:-1]:
            hidden = jax.nn.relu(layer(hidden))
        return self.value_layers[-1](hidden)[0]


class Trajectory(NamedTuple):
    """Every step of an episode: what was seen, tried and earned; `counts` marks those before the horizon."""

    observation: Observation
    action: Float[Array, "K m"]
    log_density: Float[Array, " K"]
    reward: Float[Array, " K"]
    counts: Bool[Array, " K"]


class Samples(NamedTuple):
    """Steps of many episodes, to learn from in any order."""

    observation: Observation
    action: Float[Array, "rows m"]
    log_density: Float[Array, " rows"]
    advantage: Float[Array, " rows"]
    earned: Float[Array, " rows"]
    counts: Bool[Array, " rows"]


def begin(problem: Problem, policy: Policy, settings: ActorCriticSettings, key: Key) -> Learner:
    """A learner before its first epoch, with a fresh critic. Raises ValueError for a policy without modes."""
    if not isinstance(policy, PointerPolicy):
        raise InputError(
            "training.algorithm = 'actor-critic': expected policy.kind = 'pointer', which has modes to try"
        )
    width, embedding = CRITIC_WIDTH, CRITIC_QUERIES * CRITIC_WIDTH
    numbers = pointer_feature_count(problem, "pointer")
    target, query, value = fresh_layers(
        ((numbers, width, width, width), (width, CRITIC_QUERIES), (embedding, width, width, 1)), key
    )
    critic = Critic(SetEncoder(target, query, problem.agent.space, CRITIC_LENGTH_M), value)
    parameters = eqx.filter((policy, critic), eqx.is_inexact_array)
    return Learner(policy, optimizer(settings).init(parameters), jnp.zeros((), int), critic)


def optimizer(settings: ActorCriticSettings) -> optax.GradientTransformation:
    """Adam on the bounded gradients of (policy, critic), each with its own bound and rate."""

    def adam(rate: float) -> optax.GradientTransformation:
        falling = optax.cosine_decay_schedule(rate, settings.epochs * settings.updates)
        return optax.chain(optax.clip_by_global_norm(settings.gradient_bound), optax.adam(falling))

    rules: dict[Hashable, optax.GradientTransformation] = {
        "policy": adam(settings.learning_rate),
        "critic": adam(settings.critic_learning_rate),
    }
    return optax.partition(rules, ("policy", "critic"))


def log_density(modes: Modes, action: Action, action_std: Scalar) -> Scalar:
    """log of the mixture's density at an action, up to a constant that `action_std` alone decides."""
    away = jnp.sum((action - modes.action) ** 2, axis=-1) / (2.0 * action_std**2)
    return jax.nn.logsumexp(jax.nn.log_softmax(modes.log_weight) - away)


def entropy(modes: Modes) -> Scalar:
    """Of the choice among modes [nat]."""
    log_weight = jax.nn.log_softmax(modes.log_weight)
    return -jnp.sum(jnp.exp(log_weight) * log_weight)


def rewards(
    log_det: Float[Array, "K n"], visible: Bool[Array, "K n"], first: Scalar, episode: Episode, objective: Objective
) -> Float[Array, " K"]:
    """What each step earns; the sum over an episode is its objective (less `first`, the log det that it begins with,
    where that at the horizon is what counts).
    """
    scores = step_scores(visible.astype(log_det.dtype) if objective == "seen" else log_det, episode)
    share = scores / episode.horizon.astype(scores.dtype)
    earned = jnp.diff(scores, prepend=first) if objective == "terminal" else share
    return jnp.where(jnp.arange(len(scores)) < episode.horizon, earned, 0.0)


def sample_trajectory(
    problem: Problem,
    policy: PointerPolicy,
    episode: Episode,
    protocol: Protocol,
    objective: Objective,
    action_std: Scalar,
    key: Key,
) -> Trajectory:
    """Play one episode, a mode drawn by its weight and a Gaussian about its action at every step."""

    def decide(observation, memory, key):
        mode_key, noise_key = jax.random.split(key)
        modes = policy.modes(observation)
        mean = modes.action[jax.random.categorical(mode_key, modes.log_weight)]
        action = mean + action_std * jax.random.normal(noise_key, mean.shape)
        # The density is that of the action as drawn; the agent clips what it does.
        return jnp.clip(action, -1.0, 1.0), memory, (action, log_density(modes, action, action_std))

    def record(done: Outcome):
        return done.observation, *done.notes, jnp.mean(log_det_spd(done.state.information), axis=0), done.measured

    observation, action, density, log_det, visible = simulate(problem, decide, episode, protocol, key, record)
    first = start(problem, episode, protocol)
    before = per_target(jnp.mean(log_det_spd(first.information), axis=0), first.present)
    counts = jnp.arange(len(action)) < episode.horizon
    return Trajectory(observation, action, density, rewards(log_det, visible, before, episode, objective), counts)


def advantages(
    reward: Float[Array, " K"], value: Float[Array, " K"], counts: Bool[Array, " K"], gae_lambda: float
) -> Float[Array, " K"]:
    """A_k = delta_k + lambda A_{k+1}, delta_k = r_k + V_{k+1} - V_k, with nothing after the horizon (Schulman 2016)."""
    later = jnp.append(jnp.where(counts[1:], value[1:], 0.0), 0.0)

    def back(following, step):
        delta, count = step
        advantage = jnp.where(count, delta + gae_lambda * following, 0.0)
        return advantage, advantage

    return jax.lax.scan(back, jnp.zeros_like(value[0]), (reward + later - value, counts), reverse=True)[1]


def gather(
    problem: Problem,
    scenes: SceneSettings,
    settings: ActorCriticSettings,
    learner: Learner,
    action_std: Scalar,
    key: Key,
) -> tuple[Samples, Scalar]:
    """Play a batch of fresh episodes; all their steps in a row, and what the episodes were worth in the mean."""
    policy, critic = _networks(learner)
    share, played = settings.episodes // len(settings.protocols), []
    for i, name in enumerate(settings.protocols):
        scene_key, try_key = jax.random.split(jax.random.fold_in(key, i))

        def play(scene_key, try_key, protocol=PROTOCOLS[name]):
            episode = training_episode(problem, scenes, scene_key, noise=True)
            return sample_trajectory(problem, policy, episode, protocol, settings.objective, action_std, try_key)

        played.append(jax.vmap(play)(jax.random.split(scene_key, share), jax.random.split(try_key, share)))
    every: Trajectory = jax.tree.map(lambda *parts: jnp.concatenate(parts), *played)
    value = jax.vmap(jax.vmap(critic))(every.observation)
    advantage = jax.vmap(advantages, (0, 0, 0, None))(every.reward, value, every.counts, settings.gae_lambda)
    middle, scale = (of(advantage, where=every.counts) for of in (jnp.mean, jnp.std))
    scaled = (advantage - middle) / (scale + 1e-8)
    samples = Samples(every.observation, every.action, every.log_density, scaled, advantage + value, every.counts)
    begins = log_det_spd(problem.prior_information) if settings.objective == "terminal" else 0.0
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples), begins + jnp.mean(
        jnp.sum(every.reward, axis=-1)
    )


def _networks(learner: Learner) -> tuple[PointerPolicy, Critic]:
    """Policy and critic of a learner that `begin` made."""
    assert isinstance(learner.policy, PointerPolicy), "begin rejects others"
    return learner.policy, learner.critic


def loss(
    policy: PointerPolicy, critic: Critic, rows: Samples, action_std: Scalar, settings: ActorCriticSettings
) -> Scalar:
    """The clipped surrogate loss of PPO, the choice's entropy, and the critic's squared error, over rows that count."""
    modes = jax.vmap(policy.modes)(rows.observation)
    ratio = jnp.exp(jax.vmap(log_density, (0, 0, None))(modes, rows.action, action_std) - rows.log_density)
    bounded = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    gain = jnp.minimum(ratio * rows.advantage, bounded * rows.advantage)
    error = jax.vmap(critic)(rows.observation) - rows.earned
    cost = error**2 - gain - settings.entropy_weight * jax.vmap(entropy)(modes)
    return jnp.sum(jnp.where(rows.counts, cost, 0.0)) / jnp.maximum(jnp.sum(rows.counts), 1).astype(cost.dtype)


def epoch(
    problem: Problem, scenes: SceneSettings, settings: ActorCriticSettings, learner: Learner, key: Key
) -> tuple[Learner, EpochReport]:
    """Play a batch and go over it `passes` times; the chance of epoch i comes from (key, i) alone."""
    play_key, order_key = jax.random.split(jax.random.fold_in(key, learner.epoch))
    first, last = settings.action_std
    action_std = first + (last - first) * jnp.asarray(learner.epoch, float) / settings.epochs
    samples, earned = gather(problem, scenes, settings, learner, action_std, play_key)
    parameters, rest = eqx.partition(_networks(learner), eqx.is_inexact_array)
    # In each pass rows that count come first, in a new order; a minibatch has one size, whatever the batch.
    steps = math.ceil(settings.episodes * scenes.mean_horizon)
    size = steps // settings.minibatches

    def cost(parameters, rows):
        policy, critic = eqx.combine(parameters, rest)
        return loss(policy, critic, rows, action_std, settings)

    def update(i, carry):
        parameters, state, largest = carry
        turn, part = i // settings.minibatches, i % settings.minibatches
        chance = jax.random.uniform(jax.random.fold_in(order_key, turn), samples.counts.shape)
        order = jnp.argsort(jnp.where(samples.counts, chance, 2.0))
        rows = jax.tree.map(lambda x: x[jax.lax.dynamic_slice_in_dim(order, part * size, size)], samples)
        gradient = jax.grad(cost)(parameters, rows)
        updates, state = optimizer(settings).update(gradient, state, parameters)
        return eqx.apply_updates(parameters, updates), state, jnp.maximum(largest, optax.tree.norm(gradient[0]))

    begun = (parameters, learner.optimizer, jnp.zeros(()))
    parameters, state, norm = jax.lax.fori_loop(0, settings.updates, update, begun)
    policy, critic = eqx.combine(parameters, rest)
    finite = jnp.isfinite(earned) & jnp.isfinite(optax.tree.norm(parameters)) & jnp.isfinite(norm)
    return Learner(policy, state, learner.epoch + 1, critic), EpochReport(earned, norm, finite)
