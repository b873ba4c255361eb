"""The mean of what many episodes cost, and its gradient: a micro-batch at a time, and over all devices.

What a micro-batch remembers for its way back is forgotten before the next begins: memory does not grow with the batch,
and on a CPU it stays in the cache.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, PyTree

from foveate.learning.devices import AXIS, mesh
from foveate.types import Scalar

TOGETHER = {"cpu": 64}
"""Episodes of a micro-batch where nothing else is asked for: what a cache holds; on accelerators OTHERWISE."""
OTHERWISE = 16384

Cost = Callable[[Any, Any], Scalar]
"""What an episode costs under these parameters; the second argument is all that differs between episodes."""


def mean_and_gradient(
    cost: Cost, parameters: PyTree, episodes: PyTree, together: int | None = None
) -> tuple[Scalar, PyTree]:
    """The mean of `cost` over the leading axis of `episodes`, and its gradient with respect to `parameters`.

    At most `together` episodes are worked on at once by each device. How a batch is cut up changes rounding only.
    """
    count, devices = len(jax.tree.leaves(episodes)[0]), jax.device_count()
    share = math.ceil(count / devices)
    parts = math.ceil(share / (together or TOGETHER.get(jax.default_backend(), OTHERWISE)))
    if devices == parts == 1:
        return jax.value_and_grad(lambda p: jnp.mean(jax.vmap(cost, (None, 0))(p, episodes)))(parameters)
    size = math.ceil(share / parts)
    row = np.arange(devices * parts * size).reshape(devices * parts, size)
    # What is left over is filled up with episodes that count nothing.
    cut = jax.tree.map(lambda x: x[np.minimum(row, count - 1)], episodes)
    weight = jnp.asarray(row < count, float) / count
    if devices == 1:
        return _in_turn(cost, parameters, cut, weight)

    def on_one(parameters, cut, weight):
        return jax.lax.psum(_in_turn(cost, parameters, cut, weight), AXIS)

    spread = PartitionSpec(AXIS)
    return jax.shard_map(
        on_one,
        mesh=mesh(),
        in_specs=(PartitionSpec(), spread, spread),
        out_specs=PartitionSpec(),
        check_vma=False,  # what is summed over devices is summed above, by hand
    )(parameters, cut, weight)


def _in_turn(cost: Cost, parameters: PyTree, cut: PyTree, weight: Float[Array, "parts size"]) -> tuple[Scalar, PyTree]:
    """The weighted sum of costs and its gradient, one part after the other."""

    def part(total, one):
        episodes, weight = one
        found = jax.value_and_grad(lambda p: jnp.sum(weight * jax.vmap(cost, (None, 0))(p, episodes)))(parameters)
        return jax.tree.map(jnp.add, total, found), None

    nothing = jnp.zeros((), weight.dtype), jax.tree.map(jnp.zeros_like, parameters)
    return jax.lax.scan(part, nothing, (cut, weight))[0]
