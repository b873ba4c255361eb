"""Actor-critic: proximal policy optimisation (PPO, Schulman 2017) of a pointer policy on full noisy episodes.

The gradient through a soft view leads uphill from the current policy; it cannot tell that another target would have
been the better choice, and it is not that of the real view. Here the policy samples its modes in batches of episodes
with truth, noise and the real filter, and a critic, discarded after training, estimates the return. Episodes are short,
so each is simulated to its end, and no value is bootstrapped beyond it.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from foveate.errors import InputError
from foveate.experiment.learners import ActorCriticSettings, Objective
from foveate.geometry.linalg import log_det_spd
from foveate.learning.learner import EpochReport, Learner, step_scores
from foveate.models.problem import Problem
from foveate.policies.inputs import pointer_feature_count
from foveate.policies.layers import Layers, apply_relu, fresh_layers
from foveate.policies.pointer import Modes, PointerPolicy, SetEncoder
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, Episode, Observation, Policy, Protocol, per_target
from foveate.simulation.rollout import Outcome, simulate
from foveate.simulation.step import start
from foveate.types import Action, Key, Scalar

CRITIC_WIDTH, CRITIC_QUERIES, CRITIC_LENGTH_M = 64, 4, 5.0
"""Size of the critic's network, and its unit of length [m]."""


class Critic(eqx.Module):
    """Value network: the expected return of the steps left, from an observation."""

    encoder: SetEncoder
    value_layers: Layers

    def __call__(self, observation: Observation) -> Scalar:
        """The value of an observation [nat per target, or share of time]."""
        hidden = apply_relu(self.value_layers[:-1], self.encoder(observation)[1])
        return self.value_layers[-1](hidden)[0]


class Trajectory(NamedTuple):
    """Every step of an episode; `counts` marks those before the horizon."""

    observation: Observation
    action: Float[Array, "K m"]
    log_density: Float[Array, " K"]
    reward: Float[Array, " K"]
    counts: Bool[Array, " K"]


class Samples(NamedTuple):
    """Steps of many episodes, in any order."""

    observation: Observation
    action: Float[Array, "rows m"]
    log_density: Float[Array, " rows"]
    advantage: Float[Array, " rows"]
    value_target: Float[Array, " rows"]
    counts: Bool[Array, " rows"]


def begin(problem: Problem, policy: Policy, settings: ActorCriticSettings, key: Key) -> Learner:
    """A learner before its first epoch, with a new critic. Raises InputError for a policy without modes."""
    if not isinstance(policy, PointerPolicy):
        raise InputError("training.algorithm = 'actor-critic': expected policy.kind = 'pointer', which has modes")
    features, width, pooled = pointer_feature_count(problem), CRITIC_WIDTH, CRITIC_QUERIES * CRITIC_WIDTH
    widths = ((features, width, width, width), (width, CRITIC_QUERIES), (pooled, width, width, 1))
    target, query, value = fresh_layers(widths, key)
    critic = Critic(SetEncoder(target, query, problem.agent.space, CRITIC_LENGTH_M), value)
    parameters = eqx.filter((policy, critic), eqx.is_inexact_array)
    return Learner(policy, optimizer(settings).init(parameters), jnp.zeros((), int), critic)


def optimizer(settings: ActorCriticSettings) -> optax.GradientTransformation:
    """Adam on the clipped gradients of (policy, critic), each with its own clipping and learning rate."""

    def adam(rate: float) -> optax.GradientTransformation:
        schedule = optax.cosine_decay_schedule(rate, settings.epochs * settings.updates)
        return optax.chain(optax.clip_by_global_norm(settings.gradient_bound), optax.adam(schedule))

    rates = {"policy": settings.learning_rate, "critic": settings.critic_learning_rate}
    return optax.partition({name: adam(rate) for name, rate in rates.items()}, ("policy", "critic"))


def log_density(modes: Modes, action: Action, action_std: Scalar) -> Scalar:
    """log of the mixture's density at an action, up to a constant that depends on `action_std` only."""
    exponent = jnp.sum((action - modes.action) ** 2, axis=-1) / (2.0 * action_std**2)
    return jax.nn.logsumexp(jax.nn.log_softmax(modes.log_weight) - exponent)


def entropy(modes: Modes) -> Scalar:
    """Entropy of the choice among modes [nat]."""
    log_weight = jax.nn.log_softmax(modes.log_weight)
    return -jnp.sum(jnp.exp(log_weight) * log_weight)


def rewards(
    log_det: Float[Array, "K n"], visible: Bool[Array, "K n"], first: Scalar, episode: Episode, objective: Objective
) -> Float[Array, " K"]:
    """Rewards whose sum is the episode's objective; with "terminal" less `first`, its initial log det [nat]."""
    scores = step_scores(visible.astype(log_det.dtype) if objective == "seen" else log_det, episode)
    steps = episode.horizon.astype(scores.dtype)
    reward = jnp.diff(scores, prepend=first) if objective == "terminal" else scores / steps
    return jnp.where(jnp.arange(len(scores)) < episode.horizon, reward, 0.0)


def sample_trajectory(
    problem: Problem,
    policy: PointerPolicy,
    episode: Episode,
    protocol: Protocol,
    objective: Objective,
    action_std: Scalar,
    key: Key,
) -> Trajectory:
    """Simulate one episode; each action is sampled from a Gaussian about that of a mode, sampled by its weight."""

    def decide(observation, memory, key):
        mode_key, noise_key = jax.random.split(key)
        modes = policy.modes(observation)
        mean = modes.action[jax.random.categorical(mode_key, modes.log_weight)]
        action = mean + action_std * jax.random.normal(noise_key, mean.shape)
        # The density is that of the sampled action, before the agent clips it.
        return jnp.clip(action, -1.0, 1.0), memory, (action, log_density(modes, action, action_std))

    def record(done: Outcome):
        return done.observation, *done.notes, jnp.mean(log_det_spd(done.state.information), axis=0), done.measured

    observation, action, density, log_det, visible = simulate(problem, decide, episode, protocol, key, record)
    initial = start(problem, episode, protocol)
    first = per_target(jnp.mean(log_det_spd(initial.information), axis=0), initial.present)
    reward = rewards(log_det, visible, first, episode, objective)
    return Trajectory(observation, action, density, reward, jnp.arange(len(reward)) < episode.horizon)


def advantages(
    reward: Float[Array, " K"], value: Float[Array, " K"], counts: Bool[Array, " K"], gae_lambda: float
) -> Float[Array, " K"]:
    """A_k = delta_k + lambda A_{k+1}, delta_k = r_k + V_{k+1} - V_k, zero after the horizon (Schulman 2016)."""
    next_value = jnp.append(jnp.where(counts[1:], value[1:], 0.0), 0.0)

    def step(following, inputs):
        delta, count = inputs
        advantage = jnp.where(count, delta + gae_lambda * following, 0.0)
        return advantage, advantage

    return jax.lax.scan(step, jnp.zeros_like(value[0]), (reward + next_value - value, counts), reverse=True)[1]


def gather(
    problem: Problem,
    scenes: SceneSettings,
    settings: ActorCriticSettings,
    learner: Learner,
    action_std: Scalar,
    key: Key,
) -> tuple[Samples, Scalar]:
    """Simulate a batch of new episodes; return all their steps, and the mean score of the episodes."""
    policy, critic = _networks(learner)
    share, batches = settings.episodes // len(settings.protocols), []
    for i, name in enumerate(settings.protocols):
        scene_key, action_key = jax.random.split(jax.random.fold_in(key, i))

        def sample(scene_key, action_key, protocol=PROTOCOLS[name]):
            episode = training_episode(problem, scenes, scene_key, noise=True)
            return sample_trajectory(problem, policy, episode, protocol, settings.objective, action_std, action_key)

        batches.append(jax.vmap(sample)(jax.random.split(scene_key, share), jax.random.split(action_key, share)))
    batch: Trajectory = jax.tree.map(lambda *parts: jnp.concatenate(parts), *batches)
    value = jax.vmap(jax.vmap(critic))(batch.observation)
    advantage = jax.vmap(advantages, (0, 0, 0, None))(batch.reward, value, batch.counts, settings.gae_lambda)
    mean, std = (of(advantage, where=batch.counts) for of in (jnp.mean, jnp.std))
    scaled = (advantage - mean) / (std + 1e-8)
    samples = Samples(batch.observation, batch.action, batch.log_density, scaled, advantage + value, batch.counts)
    initial = log_det_spd(problem.prior_information) if settings.objective == "terminal" else 0.0
    score = initial + jnp.mean(jnp.sum(batch.reward, axis=-1))
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples), score


def _networks(learner: Learner) -> tuple[PointerPolicy, Critic]:
    assert isinstance(learner.policy, PointerPolicy), "begin rejects others"
    return learner.policy, learner.critic


def loss(
    policy: PointerPolicy, critic: Critic, rows: Samples, action_std: Scalar, settings: ActorCriticSettings
) -> Scalar:
    """Mean clipped loss of PPO, with the modes' entropy and the critic's squared error, over rows that count."""
    modes = jax.vmap(policy.modes)(rows.observation)
    ratio = jnp.exp(jax.vmap(log_density, (0, 0, None))(modes, rows.action, action_std) - rows.log_density)
    bounded = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    gain = jnp.minimum(ratio * rows.advantage, bounded * rows.advantage)
    error = jax.vmap(critic)(rows.observation) - rows.value_target
    cost = error**2 - gain - settings.entropy_weight * jax.vmap(entropy)(modes)
    return jnp.sum(jnp.where(rows.counts, cost, 0.0)) / jnp.maximum(jnp.sum(rows.counts), 1).astype(cost.dtype)


def epoch(
    problem: Problem, scenes: SceneSettings, settings: ActorCriticSettings, learner: Learner, key: Key
) -> tuple[Learner, EpochReport]:
    """Simulate a batch and learn from it for `update_epochs`; random numbers of epoch i depend on (key, i) alone."""
    batch_key, order_key = jax.random.split(jax.random.fold_in(key, learner.epoch))
    first, last = settings.action_std
    action_std = first + (last - first) * jnp.asarray(learner.epoch, float) / settings.epochs
    samples, score = gather(problem, scenes, settings, learner, action_std, batch_key)
    parameters, rest = eqx.partition(_networks(learner), eqx.is_inexact_array)
    # In each pass, rows that count come first, in a new order; a minibatch has one size, whatever the batch.
    size = math.ceil(settings.episodes * scenes.mean_horizon) // settings.minibatches

    def cost(parameters, rows):
        policy, critic = eqx.combine(parameters, rest)
        return loss(policy, critic, rows, action_std, settings)

    def update(i, carry):
        parameters, state, largest = carry
        number, part = i // settings.minibatches, i % settings.minibatches
        rank = jax.random.uniform(jax.random.fold_in(order_key, number), samples.counts.shape)
        order = jnp.argsort(jnp.where(samples.counts, rank, 2.0))
        rows = jax.tree.map(lambda x: x[jax.lax.dynamic_slice_in_dim(order, part * size, size)], samples)
        gradient = jax.grad(cost)(parameters, rows)
        updates, state = optimizer(settings).update(gradient, state, parameters)
        return eqx.apply_updates(parameters, updates), state, jnp.maximum(largest, optax.tree.norm(gradient[0]))

    initial = (parameters, learner.optimizer, jnp.zeros(()))
    parameters, state, norm = jax.lax.fori_loop(0, settings.updates, update, initial)
    policy, critic = eqx.combine(parameters, rest)
    finite = jnp.isfinite(score) & jnp.isfinite(optax.tree.norm(parameters)) & jnp.isfinite(norm)
    return Learner(policy, state, learner.epoch + 1, critic), EpochReport(score, norm, finite)
