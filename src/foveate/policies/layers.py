"""Parts of networks: chains of dense layers with random weights, and a softmax over the entries of a mask."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.types import Key

Layers = tuple[eqx.nn.Linear, ...]


def fresh_layers(widths: tuple[tuple[int, ...], ...], key: Key) -> list[Layers]:
    """Build chains of layers; weights and biases are uniform within 1 / sqrt(inputs).

    All are cut from one array of random numbers: drawing a dozen arrays one by one takes a second of compilation each.
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
            layers.append(eqx.tree_at(lambda x: (x.weight, x.bias), layer, (block[:, :-1], block[:, -1])))
        chains.append(tuple(layers))
    return chains


def masked_softmax(scores: Float[Array, " n"], mask: Bool[Array, " n"]) -> Float[Array, " n"]:
    """Softmax over the entries where `mask` holds, 0 elsewhere; all 0, with zero derivative, where none does.

    Both branches of `where` are differentiated, so each is made finite first, also for a mask that holds nowhere.
    """
    largest = jnp.max(scores, initial=-jnp.inf, where=mask)
    shift = jax.lax.stop_gradient(jnp.where(jnp.isfinite(largest), largest, 0.0))
    powers = jnp.where(mask, jnp.exp(jnp.where(mask, scores - shift, 0.0)), 0.0)
    total = jnp.sum(powers)
    return powers / jnp.where(total > 0, total, 1.0)
