"""The paper's network once more, in PyTorch: actor and critic for Stable-Baselines3, and the way back into JAX.

An observation is one row of numbers: those about the agent, those about each target, one flag a target (1: present, 0:
padding), and last the share of its steps that an episode has left, which only a critic may read.
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
from foveate.policies.inputs import policy_features
from foveate.simulation.records import Observation
from foveate.types import Scalar


def flat_inputs(
    problem: Problem, settings: AttentionSettings, observation: Observation, left: Scalar
) -> Float[Array, " size"]:
    """Exactly what `AttentionPolicy` is told, padding as zeros, and the share of steps that is `left`."""
    return policy_features(
        observation, left, problem.agent.space, settings.frame, settings.length_m, settings.information
    ).row


class Attention(nn.Module):
    """`AttentionPolicy` up to its last layer, of any number of outputs and without tanh.

    PyTorch's own first weights are those of `AttentionSettings.policy`: uniform within 1 / sqrt(inputs), biases too.
    """

    def __init__(self, problem: Problem, settings: AttentionSettings, outputs: int, sees_time: bool) -> None:
        super().__init__()
        n_y = problem.motion.state_size
        self.agent_size, self.feature_size = problem.agent.space.twist_size, n_y + n_y * (n_y + 1) // 2
        self.alpha, self.sees_time = settings.alpha, sees_time
        embedding = settings.agent_widths[-1]
        self.agent_layers = _layers(self.agent_size, *settings.agent_widths)
        self.target_layers = _layers(self.feature_size, *settings.target_widths)
        self.out_layers = _layers(2 * embedding + sees_time, *settings.out_widths, outputs)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Rows of observations (batch, size) to outputs (batch, outputs)."""
        n = (rows.shape[1] - self.agent_size - 1) // (self.feature_size + 1)
        agent, targets, mask, left = rows.split([self.agent_size, n * self.feature_size, n, 1], dim=1)
        targets = targets.reshape(len(rows), n, self.feature_size)
        for layer in self.agent_layers:
            agent = torch.relu(layer(agent))
        for layer in self.target_layers:
            targets = torch.relu(layer(targets))
        scores = (targets @ agent[:, :, None])[:, :, 0] / self.alpha
        # The least float in place of -inf: a row without any target gives no NaN, and the mask makes it zero.
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
    """Two networks of their own: tanh of the actor's is the mean of the Gaussian, the critic's one output the value."""

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
        self._made_for = (problem, settings)
        self._critic_sees_time = critic_sees_time
        super().__init__(observation_space, action_space, lr_schedule, **options)

    def _build(self, lr_schedule: Schedule) -> None:
        outputs = len(self._made_for[0].agent.axes)
        self.mlp_extractor = _Both(
            Attention(*self._made_for, outputs, sees_time=False),
            Attention(*self._made_for, 1, sees_time=self._critic_sees_time),
        )
        self.action_net, self.value_net = nn.Tanh(), nn.Identity()
        self.log_std = nn.Parameter(torch.full((outputs,), self.log_std_init))
        # Stable-Baselines3's Adam, in one kernel in place of a dozen a weight.
        self.optimizer = torch.optim.Adam(self.parameters(), lr=lr_schedule(1), fused=True, **self.optimizer_kwargs)

    @property
    def actor(self) -> Attention:
        """The network that decides."""
        return cast(_Both, self.mlp_extractor).actor


class _Both(nn.Module):
    """In the place where Stable-Baselines3 has the bodies of its networks."""

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
    """The policy that decides as the actor's mean action does, without torch."""
    shape = eqx.filter_eval_shape(lambda key: settings.policy(problem, key), jax.random.key(0))
    chains = [actor.agent_layers, actor.target_layers, actor.out_layers]
    names = ("weight", "bias")
    # Copied below: torch goes on training in the memory that its numpy views share.
    weights = [layer.get_parameter(name).detach().numpy() for chain in chains for layer in chain for name in names]
    return eqx.tree_at(_weights, shape, [jnp.array(x, float) for x in weights])


def _weights(policy: AttentionPolicy) -> list[Any]:
    layers = [*policy.agent_layers, *policy.target_layers, *policy.out_layers]
    return [x for layer in layers for x in (layer.weight, layer.bias)]
