"""Attention policy, the paper's network: the agent's embedding attends to those of the targets (section 3.2)."""

from dataclasses import dataclass
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from foveate.geometry.space import Space
from foveate.io.settings import Settings
from foveate.io.validate import positive, require
from foveate.models.problem import Problem
from foveate.policies.inputs import Frame, Scale, policy_inputs, require_position_first
from foveate.policies.layers import Layers, apply_relu, fresh_layers, masked_softmax
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key


@dataclass(frozen=True, kw_only=True)
class AttentionSettings(Settings):
    """Settings of the paper's network.

    Positions enter in units of `length_m` (the paper: metres): distances of many units would saturate the attention of
    an untrained network. `information` is the scale on which information matrices enter (the paper: plain).
    """

    kind: Literal["attention"] = "attention"
    frame: Frame = "body"
    """Frame of its inputs: the agent's body, or the world."""
    agent_widths: tuple[int, ...] = (32, 32)
    """Layers on the pose."""
    target_widths: tuple[int, ...] = (64, 32)
    """Layers on each target; the last as wide as that of `agent_widths`."""
    out_widths: tuple[int, ...] = (64,)
    """Layers before the command."""
    alpha: float = 4.0
    """Divisor of the attention scores."""
    length_m: float = 1.0
    information: Scale = "plain"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("agent_widths", "target_widths", "out_widths"):
            widths = getattr(self, name)
            require(min(widths, default=0) >= 1, name, widths, "expected at least one width, each >= 1")
        right = f"expected to end in {self.agent_widths[-1]} as agent_widths does"
        require(self.target_widths[-1] == self.agent_widths[-1], "target_widths", self.target_widths, right)
        positive(self, "alpha", "length_m")

    def policy(self, problem: Problem, key: Key) -> "AttentionPolicy":
        """A network with random weights, sized for the problem's space, targets and actuated axes."""
        if self.frame == "body":
            require_position_first(problem, "frame", "body")
        space, n_y = problem.agent.space, problem.motion.state_size
        widths = (
            (space.twist_size, *self.agent_widths),
            (n_y + n_y * (n_y + 1) // 2, *self.target_widths),
            (2 * self.agent_widths[-1], *self.out_widths, len(problem.agent.axes)),
        )
        agent, target, out = fresh_layers(widths, key)
        return AttentionPolicy(agent, target, out, space, self.frame, self.alpha, self.length_m, self.information)


class AttentionPolicy(Policy):
    """u = pi_theta(s): AP_FC on the pose, LI_FC on each target, attention of the pose to the targets, Out_FC."""

    agent_layers: Layers
    target_layers: Layers
    out_layers: Layers
    space: Space = eqx.field(static=True)
    frame: Frame = eqx.field(static=True)
    alpha: float = eqx.field(static=True)
    length_m: float = eqx.field(static=True)
    information: Scale = eqx.field(static=True)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Deterministic: tanh of the last layer."""
        pose, targets = policy_inputs(observation, self.space, self.frame, self.length_m, self.information)
        pose, targets = apply_relu(self.agent_layers, pose), apply_relu(self.target_layers, targets)
        weights = masked_softmax(targets @ pose / self.alpha, observation.present)
        hidden = jnp.concatenate([jax.nn.relu(weights @ targets), pose])
        return jnp.tanh(self.out_layers[-1](apply_relu(self.out_layers[:-1], hidden))), memory
