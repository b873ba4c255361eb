"""Actor and critic for Stable-Baselines3: the paper's network in PyTorch, and its conversion to JAX.

An observation is one row: the features of the agent, those of each target, one flag per target (1: present, 0:
padding), and the share of the episode's steps that is left, which only a critic may read.
"""

# Without the extra `ppo` there is no torch to check against.
# pyright: reportMissingImports=false

import itertools
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import torch
from gymnasium import spaces
from jaxtyping import Array, Float
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import nn

from foveate.models.problem import Problem
from foveate.policies.attention import AttentionPolicy, AttentionSettings
from foveate.policies.inputs import masked_features
from foveate.simulation.records import Observation
from foveate.types import Scalar


def flat_inputs(
    problem: Problem, settings: AttentionSettings, observation: Observation, left: Scalar
) -> Float[Array, " size"]:
    """Features of `AttentionPolicy`, with padding as zeros, and the share of steps that is `left`."""
    scales = (settings.frame, settings.length_m, settings.information)
    return masked_features(observation, left, problem.agent.space, *scales).row


class Attention(nn.Module):
    """`AttentionPolicy` up to its last layer, with any number of outputs and without tanh.

    PyTorch's initial weights are those of `AttentionSettings.policy`: uniform within 1 / sqrt(inputs), biases too.
    """

    def __init__(self, problem: Problem, settings: AttentionSettings, outputs: int, sees_time: bool) -> None:
        super().__init__()
        n_y = problem.motion.state_size
        self.agent_size, self.feature_size = problem.agent.space.twist_size, n_y + n_y * (n_y + 1) // 2
        self.alpha, self.sees_time = settings.alpha, sees_time
        self.agent_layers = _layers(self.agent_size, *settings.agent_widths)
        self.target_layers = _layers(self.feature_size, *settings.target_widths)
        self.out_layers = _layers(2 * settings.agent_widths[-1] + sees_time, *settings.out_widths, outputs)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Map rows of observations (batch, size) to outputs (batch, outputs)."""
        n = (rows.shape[1] - self.agent_size - 1) // (self.feature_size + 1)
        agent, targets, mask, left = rows.split([self.agent_size, n * self.feature_size, n, 1], dim=1)
        targets = targets.reshape(len(rows), n, self.feature_size)
        for layer in self.agent_layers:
            agent = torch.relu(layer(agent))
        for layer in self.target_layers:
            targets = torch.relu(layer(targets))
        scores = (targets @ agent[:, :, None])[:, :, 0] / self.alpha
        # The least float in place of -inf: a row without targets gives no NaN, and the mask makes it zero.
        weights = mask * torch.softmax(scores.masked_fill(mask == 0, torch.finfo(scores.dtype).min), dim=1)
        context = torch.relu((weights[:, None] @ targets)[:, 0])
        hidden = torch.cat([context, agent, left] if self.sees_time else [context, agent], dim=1)
        *layers, out = self.out_layers
        for layer in layers:
            hidden = torch.relu(layer(hidden))
        return out(hidden)


def _layers(*widths: int) -> nn.ModuleList:
    return nn.ModuleList(nn.Linear(into, out) for into, out in itertools.pairwise(widths))


class ActorAndCritic(ActorCriticPolicy):
    """Separate networks: tanh of the actor's output is the mean of the Gaussian, the critic's output the value."""

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        problem: Problem,
        settings: AttentionSettings,
        critic_sees_time: bool,
        **options: Any,
    ) -> None:
        self._problem, self._settings, self._critic_sees_time = problem, settings, critic_sees_time
        super().__init__(observation_space, action_space, lr_schedule, **options)

    def _build(self, lr_schedule: Schedule) -> None:
        outputs = len(self._problem.agent.axes)
        self.mlp_extractor = _ActorCriticBody(
            Attention(self._problem, self._settings, outputs, sees_time=False),
            Attention(self._problem, self._settings, 1, sees_time=self._critic_sees_time),
        )
        self.action_net, self.value_net = nn.Tanh(), nn.Identity()
        self.log_std = nn.Parameter(torch.full((outputs,), self.log_std_init))
        # Stable-Baselines3's Adam, but fused: one kernel in place of a dozen per weight.
        self.optimizer = torch.optim.Adam(self.parameters(), lr=lr_schedule(1), fused=True, **self.optimizer_kwargs)

    @property
    def actor(self) -> Attention:
        """The network that chooses actions."""
        return cast(_ActorCriticBody, self.mlp_extractor).actor


class _ActorCriticBody(nn.Module):
    """Replaces Stable-Baselines3's feature extractor by one network for each head."""

    def __init__(self, actor: Attention, critic: Attention) -> None:
        super().__init__()
        self.actor, self.critic = actor, critic

    def forward(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.actor(rows), self.critic(rows)

    def forward_actor(self, rows: torch.Tensor) -> torch.Tensor:
        return self.actor(rows)

    def forward_critic(self, rows: torch.Tensor) -> torch.Tensor:
        return self.critic(rows)


def to_jax(actor: Attention, problem: Problem, settings: AttentionSettings) -> AttentionPolicy:
    """Convert the actor to the JAX policy whose action is the actor's mean action."""

    def weights(network: Any) -> list[Any]:
        layers = [*network.agent_layers, *network.target_layers, *network.out_layers]
        return [x for layer in layers for x in (layer.weight, layer.bias)]

    shape = eqx.filter_eval_shape(lambda key: settings.policy(problem, key), jax.random.key(0))
    # Copied by jnp.array: numpy views share the memory in which torch continues to train.
    return eqx.tree_at(weights, shape, [jnp.array(x.detach().numpy(), float) for x in weights(actor)])
