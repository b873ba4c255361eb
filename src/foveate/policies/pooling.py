"""A stronger network: targets as a set, gathered by several learned queries (Zaheer 2017, Lee 2019), and the time left.

Beyond the paper's: more layers, several ways of looking at the same targets at once, inputs whose size says less and
whose direction says more, and how many steps are left, which every planner knows too.
"""

from dataclasses import dataclass
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from foveate.geometry.space import Space
from foveate.policies.inputs import rich_inputs, rich_numbers
from foveate.policies.layers import fresh_layers, masked_softmax
from foveate.problem import Observation, Policy, Problem
from foveate.types import Action, Key


@dataclass(frozen=True, kw_only=True)
class PoolingSettings:
    """Widths of the layers on each target and after gathering, and how many queries (`heads`) gather.

    Positions enter in units of `length_m`.
    """

    kind: Literal["pooling"]
    target_widths: tuple[int, ...] = (64, 64, 64)
    heads: int = 4
    out_widths: tuple[int, ...] = (64, 64)
    length_m: float = 5.0

    def __post_init__(self) -> None:
        for name in ("target_widths", "out_widths"):
            widths = getattr(self, name)
            if not widths or min(widths) < 1:
                raise ValueError(f"{name} = {widths}: expected at least one width, each >= 1")
        if self.heads < 1:
            raise ValueError(f"heads = {self.heads}: expected >= 1")
        if self.length_m <= 0:
            raise ValueError(f"length_m = {self.length_m}: expected > 0")

    def policy(self, problem: Problem, key: Key) -> "PoolingPolicy":
        """A network with fresh weights, fit for the problem's space, targets and actuated axes."""
        numbers = rich_numbers(problem, self.kind)
        embedding = self.target_widths[-1]
        widths = (
            (numbers, *self.target_widths),
            (embedding, self.heads),
            (self.heads * embedding, *self.out_widths, len(problem.agent.axes)),
        )
        target, query, out = fresh_layers(widths, key)
        return PoolingPolicy(target, query, out, problem.agent.space, self.length_m)


class PoolingPolicy(Policy):
    """Layers on every target; each query's softmax over the targets weighs their mean; layers on all these means."""

    target_layers: tuple[eqx.nn.Linear, ...]
    query_layers: tuple[eqx.nn.Linear, ...]
    out_layers: tuple[eqx.nn.Linear, ...]
    space: Space = eqx.field(static=True)
    length_m: float = eqx.field(static=True)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Deterministic."""
        del key
        targets = rich_inputs(observation, self.space, self.length_m)
        for layer in self.target_layers:
            targets = jax.nn.relu(jax.vmap(layer)(targets))
        (query,) = self.query_layers
        scores = jax.vmap(query)(targets)
        weights = jax.vmap(masked_softmax, (1, None))(scores, observation.present)
        hidden = (weights @ targets).ravel()
        for layer in self.out_layers[:-1]:
            hidden = jax.nn.relu(layer(hidden))
        return jnp.tanh(self.out_layers[-1](hidden)), memory
