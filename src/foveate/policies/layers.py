"""What networks are made of here: chains of dense layers with fresh weights, and a softmax that knows padding."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.types import Key

Layers = tuple[eqx.nn.Linear, ...]


def fresh_layers(widths: tuple[tuple[int, ...], ...], key: Key) -> list[Layers]:
    """Chains of layers, weights and biases uniform within 1 / sqrt(inputs), cut from one draw.

    A draw of its own for each of a dozen arrays would cost a second of compilation each.
    """
    sizes = [[(out, into + 1) for into, out in itertools.pairwise(chain)] for chain in widths]
    total = sum(out * columns for chain in sizes for out, columns in chain)
    numbers, start, chains = jax.random.uniform(key, (total,), minval=-1.0), 0, []
    for chain in sizes:
        layers = []
        for out, columns in chain:
            block = numbers[start : start + out * columns].reshape(out, columns) / math.sqrt(columns - 1)
            start += out * columns
            layer = eqx.filter_eval_shape(eqx.nn.Linear, columns - 1, out, key=key)
            layers.append(eqx.tree_at(lambda one: (one.weight, one.bias), layer, (block[:, :-1], block[:, -1])))
        chains.append(tuple(layers))
    return chains


def masked_softmax(scores: Float[Array, " n"], mask: Bool[Array, " n"]) -> Float[Array, " n"]:
    """Softmax over the entries where `mask` holds, 0 elsewhere; all 0, with zero derivative, where none does."""
    largest = jnp.max(scores, initial=-jnp.inf, where=mask)
    shift = jax.lax.stop_gradient(jnp.where(jnp.isfinite(largest), largest, 0.0))
    powers = jnp.where(mask, jnp.exp(jnp.where(mask, scores - shift, 0.0)), 0.0)
    total = jnp.sum(powers)
    return powers / jnp.where(total > 0, total, 1.0)
