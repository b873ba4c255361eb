"""Actor-critic: proximal policy optimisation (PPO, Schulman 2017) of a pointer policy on full noisy episodes.

The gradient through a soft view leads uphill from the current policy; it cannot tell that another target would have
been the better choice, and it is not that of the real view. Here the policy samples its modes in batches of episodes
with truth, noise and the real filter, and a critic, discarded after training, estimates the return.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, UInt32
from jaxtyping import Key as Keys

from foveate.errors import InputError
from foveate.experiment.learners import ActorCriticSettings
from foveate.geometry.linalg import log_det_spd
from foveate.learning.critic import Critic, Samples, judge, moments, new_critic, rescaled, samples_of
from foveate.learning.learner import EpochReport, Learner
from foveate.learning.shards import over_shards
from foveate.learning.team_play import play_team
from foveate.learning.trajectories import Trajectory, log_density, play
from foveate.learning.windows import (
    Ongoing,
    begin_ongoing,
    continued,
    cut,
    first_state,
    plays_whole,
    step_of,
    window_steps,
)
from foveate.learning.worlds import World, informed, most_targets
from foveate.policies.pointer import Modes, PointerPolicy
from foveate.simulation.records import Policy
from foveate.simulation.team.step import TeamState
from foveate.types import Count, Key, Scalar

SHARDS = 2
"""Parts of a batch, which the cores share."""


def begin(worlds: Sequence[World], policy: Policy, settings: ActorCriticSettings, key: Key) -> Learner:
    """A learner before its first epoch, with a new critic.

    Raises InputError for a policy without modes, or for fewer decisions than minibatches.
    """
    if not isinstance(policy, PointerPolicy):
        raise InputError("training.algorithm = 'actor-critic': expected policy.kind = 'pointer', which has modes")
    if minibatch_size(worlds, settings) == 0:
        least = SHARDS * settings.minibatches
        raise InputError(f"training.episodes = {settings.episodes}: expected episodes of {least} decisions in all")
    network_key, ongoing_key = jax.random.split(key)
    critic = new_critic(policy.encoder.target_layers[0].weight.shape[1], network_key, len(worlds))
    parameters = eqx.filter((policy, critic), eqx.is_inexact_array)
    keys = [ongoing_key] if len(worlds) == 1 else jax.random.split(ongoing_key, len(worlds))
    ongoing = tuple(begin_ongoing(world, settings, key) for world, key in zip(worlds, keys, strict=True))
    ongoing = jax.tree.map(lambda x: x.reshape(SHARDS, -1, *x.shape[1:]), ongoing)
    return Learner(policy, optimizer(settings).init(parameters), jnp.zeros((), int), critic, ongoing)


def minibatch_size(worlds: Sequence[World], settings: ActorCriticSettings) -> int:
    """Decisions of a minibatch, in each of the SHARDS of a batch."""
    return sum(settings.decisions(world.scenes, world.agents) for world in worlds) // settings.minibatches // SHARDS


def optimizer(settings: ActorCriticSettings) -> optax.GradientTransformation:
    """Adam on the clipped gradients of (policy, critic), each with its own clipping and learning rate."""

    def adam(rate: float) -> optax.GradientTransformation:
        schedule = optax.cosine_decay_schedule(rate, settings.epochs * settings.updates)
        # On one flat vector: dozens of small arrays cost more in dispatch than in arithmetic.
        return optax.flatten(optax.chain(optax.clip_by_global_norm(settings.gradient_bound), optax.adam(schedule)))

    rates = {"policy": settings.learning_rate, "critic": settings.critic_learning_rate}
    return optax.partition({name: adam(rate) for name, rate in rates.items()}, ("policy", "critic"))


def entropy(modes: Modes) -> Scalar:
    """Entropy of the choice among modes [nat]."""
    log_weight = jax.nn.log_softmax(modes.log_weight)
    return -jnp.sum(jnp.exp(log_weight) * log_weight)


def gather(
    world: World,
    settings: ActorCriticSettings,
    policy: PointerPolicy,
    action_std: Scalar,
    keys: Keys[Array, " trajectories"],
    ongoing: Ongoing | None,
) -> tuple[Trajectory, Ongoing | None]:
    """Play as many episodes as there are keys; return their trajectories, and the episodes in progress.

    Of a team every robot has a trajectory of its own.
    """
    scenes, policy = world.scenes, informed(policy, world, settings)
    length, discounted = window_steps(scenes, settings), settings.discount_of(scenes) < 1.0
    whole = plays_whole(scenes, settings)
    share, batches = len(keys) // len(settings.protocols), []
    for i in range(len(settings.protocols)):
        rows, protocol = slice(i * share, (i + 1) * share), settings.protocol_of(i)

        def play_one(key, one, protocol=protocol):
            scene_key, action_key = jax.random.split(key)
            problem, episode = world.drawn(scene_key if one is None else one.key)
            if one is None:
                state, ends = first_state(problem, episode, protocol), episode.horizon
            else:
                episode, state, ends = cut(episode, step_of(one.state), length), one.state, one.ends
            what, how, until = (problem, policy, episode, protocol), (action_std, action_key), (ends, discounted, whole)
            if isinstance(state, TeamState):
                trajectory, last = play_team(*what, world.objective, *how, state, *until)
            else:
                trajectory, last = play(*what, world.objective, *how, state, *until)
            return trajectory, None if one is None else continued(world, protocol, one, last, scene_key)

        part = None if ongoing is None else jax.tree.map(lambda x, rows=rows: x[rows], ongoing)
        trajectories, after = jax.vmap(play_one)(keys[rows], part)
        if world.agents > 1:
            trajectories = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), trajectories)
        batches.append((trajectories, after))
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *batches)


def score_of(world: World, settings: ActorCriticSettings, trajectory: Trajectory) -> Scalar:
    """Mean score of whole episodes; of windows the mean growth of the score, or share of time in view, per step.

    Of robots with assigned targets the mean of their own rewards, which is no score of the team.
    """
    total = jnp.sum(trajectory.reward, axis=-1)
    if not plays_whole(world.scenes, settings):
        return jnp.mean(total / jnp.maximum(jnp.sum(trajectory.counts, axis=-1), 1).astype(total.dtype))
    initial = log_det_spd(world.problem.prior_information) if world.objective == "terminal" else 0.0
    return initial + jnp.mean(total)


def _networks(learner: Learner) -> tuple[PointerPolicy, Critic]:
    assert isinstance(learner.policy, PointerPolicy), "begin rejects others"
    return learner.policy, learner.critic


def loss(
    policy: PointerPolicy, critic: Critic, rows: Samples, action_std: Scalar, settings: ActorCriticSettings
) -> Scalar:
    """Mean clipped loss of PPO, with the modes' entropy and the critic's squared error, over rows that count."""

    def density(tokens, action):
        modes = policy.modes(tokens)
        return log_density(modes, action, action_std * tokens.unit), entropy(modes)

    new, choice = jax.vmap(density)(rows.tokens, rows.action)
    # Beyond e^20 the ratio is clipped anyway; where it overflows, its derivative would be 0 times infinity.
    ratio = jnp.exp(jnp.clip(new - rows.log_density, -20.0, 20.0))
    bounded = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    gain = jnp.minimum(ratio * rows.advantage, bounded * rows.advantage)
    error = jax.vmap(critic.normalised)(rows.tokens if rows.seen is None else rows.seen) - rows.value_target
    cost = 0.5 * error**2 - gain - settings.entropy_weight * choice
    return jnp.sum(jnp.where(rows.counts, cost, 0.0)) / jnp.maximum(jnp.sum(rows.counts), 1).astype(cost.dtype)


def epoch(
    worlds: Sequence[World], settings: ActorCriticSettings, learner: Learner, key: Key
) -> tuple[Learner, EpochReport]:
    """Simulate a batch and learn from it for `update_epochs`; random numbers of epoch i depend on (key, i) alone.

    The batch has SHARDS parts, on as many devices as there are: numbers do not depend on the number of cores.
    """
    batch_key, order_key = jax.random.split(jax.random.fold_in(key, learner.epoch))
    counts = [settings.trajectories(world.scenes, world.agents) // SHARDS for world in worlds]
    keys = jax.random.split(batch_key, (SHARDS, sum(counts)))
    parts = (jax.random.key_data(keys), jax.random.key_data(jax.random.split(order_key, SHARDS)), learner.ongoing)
    arrays, static = eqx.partition(replace(learner, ongoing=None), eqx.is_array)

    def on_device(arrays, parts, total):
        return _epoch_of_shards(worlds, settings, eqx.combine(arrays, static), parts, total)

    trained, ongoing, report = over_shards(on_device, arrays, parts, SHARDS)
    return replace(eqx.combine(trained, static), ongoing=ongoing), report


def _epoch_of_shards(worlds, settings, learner, parts, total):
    """An epoch on some of the shards; `total` sums a part of each over all of them."""
    keys, order_keys, ongoing = parts
    first, last = settings.action_std
    action_std = first + (last - first) * jnp.asarray(learner.epoch, float) / settings.epochs
    policy, critic = _networks(learner)

    def collect(part):
        keys, ongoing = part
        keys, end, found = jax.random.wrap_key_data(keys), 0, []
        for i, world in enumerate(worlds):
            first, end = end, end + settings.trajectories(world.scenes, world.agents) // SHARDS
            trajectory, after = gather(world, settings, policy, action_std, keys[first:end], ongoing[i])
            judged = judge(critic, trajectory, settings, settings.discount_of(world.scenes), i)
            found.append((judged, after, score_of(world, settings, trajectory)))
        return tuple(zip(*found, strict=True))

    judged, ongoing, scores = jax.lax.map(collect, (keys, ongoing))
    critic, samples = _on_scale(worlds, critic, judged, total)
    parameters, rest = eqx.partition((policy, critic), eqx.is_inexact_array)
    size = minibatch_size(worlds, settings)

    def cost(parameters, rows):
        policy, critic = eqx.combine(parameters, rest)
        return loss(policy, critic, rows, action_std, settings) / SHARDS

    def update(carry, rows):
        parameters, state, largest = carry
        gradient = total(jax.lax.map(lambda rows: jax.grad(cost)(parameters, rows), rows))
        updates, state = optimizer(settings).update(gradient, state, parameters)
        return (eqx.apply_updates(parameters, updates), state, jnp.maximum(largest, optax.tree.norm(gradient[0]))), None

    def go_through(i, carry):
        deal = partial(_minibatches, number=i, count=settings.minibatches, size=size)
        rows = jax.vmap(deal, out_axes=1)(samples, order_keys)
        return jax.lax.scan(update, carry, rows)[0]

    initial = (parameters, learner.optimizer, jnp.zeros(()))
    parameters, state, norm = jax.lax.fori_loop(0, settings.update_epochs, go_through, initial)
    policy, critic = eqx.combine(parameters, rest)
    score = jnp.mean(jnp.stack([total(score) for score in scores])) / SHARDS
    finite = jnp.isfinite(score) & jnp.isfinite(optax.tree.norm(parameters)) & jnp.isfinite(norm)
    learner = Learner(policy, state, learner.epoch + 1, critic)
    return eqx.filter(learner, eqx.is_array), ongoing, EpochReport(score, norm, finite)


def _on_scale(worlds, critic, judged, total):
    """The critic and the samples of all worlds, with each world's advantages and returns on its own scale."""
    sums = jnp.stack([total(jax.vmap(moments)(each)) for each in judged])  # (worlds, advantages and returns, moments)
    mean, square = sums[..., 1] / sums[..., 0], sums[..., 2] / sums[..., 0]
    std, most = jnp.sqrt(jnp.maximum(square - mean**2, 0.0)), most_targets(worlds)
    critic = rescaled(critic, mean[:, 1], std[:, 1])
    samples = [
        jax.vmap(lambda part, i=i: samples_of(part, critic, mean[i, 0], std[i, 0], i, most))(each)
        for i, each in enumerate(judged)
    ]
    return critic, jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=1), *samples)


def _minibatches(samples: Samples, order_key: UInt32[Array, " words"], number: Count, count: int, size: int) -> Samples:
    """Minibatches of one size, whatever the batch, in a new order for each pass; rows that count come first."""
    key = jax.random.fold_in(jax.random.wrap_key_data(order_key), number)
    rank = jax.random.uniform(key, samples.counts.shape)
    order = jnp.argsort(jnp.where(samples.counts, rank, 2.0))[: count * size]
    return jax.tree.map(lambda x: x[order].reshape(count, size, *x.shape[1:]), samples)
