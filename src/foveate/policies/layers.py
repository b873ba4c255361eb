"""Parts of networks: chains of dense layers with random weights, a masked softmax, and an encoder of sets."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.policies.tokens import Tokens
from foveate.types import Key

Layers = tuple[eqx.nn.Linear, ...]


def fresh_layers(widths: tuple[tuple[int, ...], ...], key: Key) -> list[Layers]:
    """Build chains of layers; weights and biases are uniform within 1 / sqrt(inputs).

    All are cut from one array of random numbers: drawing a dozen arrays one by one takes a second of compilation each.
    """
    total = sum(out * (into + 1) for chain in widths for into, out in itertools.pairwise(chain))
    numbers, start, chains = jax.random.uniform(key, (total,), minval=-1.0), 0, []
    for chain in widths:
        layers = []
        for into, out in itertools.pairwise(chain):
            block = numbers[start : start + out * (into + 1)].reshape(out, into + 1) / math.sqrt(into)
            start += block.size
            layer = eqx.filter_eval_shape(eqx.nn.Linear, into, out, key=key)
            layers.append(eqx.tree_at(lambda x: (x.weight, x.bias), layer, (block[:, :-1], block[:, -1])))
        chains.append(tuple(layers))
    return chains


def apply_relu(layers: Layers, x: Float[Array, "*n width"]) -> Float[Array, "*n out"]:
    """Apply layers, with a ReLU after each, to a vector or to every row of a matrix."""
    for layer in layers:
        x = jax.nn.relu(layer(x) if x.ndim == 1 else jax.vmap(layer)(x))
    return x


def masked_softmax(scores: Float[Array, " n"], mask: Bool[Array, " n"]) -> Float[Array, " n"]:
    """Softmax over the entries where `mask` holds, 0 elsewhere; all 0, with zero derivative, where none does.

    Both branches of `where` are differentiated, so each is made finite first.
    """
    largest = jnp.max(scores, initial=-jnp.inf, where=mask)
    shift = jax.lax.stop_gradient(jnp.where(jnp.isfinite(largest), largest, 0.0))
    powers = jnp.where(mask, jnp.exp(jnp.where(mask, scores - shift, 0.0)), 0.0)
    total = jnp.sum(powers)
    return powers / jnp.where(total > 0, total, 1.0)


class SetEncoder(eqx.Module):
    """Layers on every target, pooled by attention: one mean over the targets per query, weighted by its softmax."""

    target_layers: Layers
    query_layers: Layers

    def __call__(self, tokens: Tokens) -> tuple[Float[Array, "n embedding"], Float[Array, " pooled"]]:
        """The embedding of each target, and the pooled one of all, zero where none is present."""
        targets = apply_relu(self.target_layers, tokens.features)
        (query,) = self.query_layers
        weights = jax.vmap(masked_softmax, (1, None))(jax.vmap(query)(targets), tokens.present)
        return targets, (weights @ targets).ravel()
