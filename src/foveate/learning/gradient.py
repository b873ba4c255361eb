"""Compute the mean loss of many episodes and its gradient, in micro-batches and on all devices.

A micro-batch frees the memory of its backward pass before the next begins: memory does not grow with the batch, and on
a CPU it stays in the cache.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, PyTree

from foveate.learning.devices import AXIS, mesh, sharded
from foveate.types import Scalar

Loss = Callable[[Any, Any], Scalar]
"""Loss of one episode: (parameters, all that differs between episodes) -> loss."""


def mean_and_gradient(loss: Loss, parameters: PyTree, episodes: PyTree, micro_batch: int) -> tuple[Scalar, PyTree]:
    """Compute the mean of `loss` over the leading axis of `episodes`, and its gradient in `parameters`.

    Each device works on at most `micro_batch` episodes at once; this changes rounding only. On one machine numbers do
    not depend on the number of cores, which split the batch alike and add in one order, unless XLA splits single
    products by it, as it does from some 1,000 rows on.
    """
    count = len(jax.tree.leaves(episodes)[0])
    devices, rounds, size = sharded(count, micro_batch)
    row = np.arange(rounds * devices * size).reshape(rounds, devices, size)
    # Copies of the last episode, of weight zero, fill the last micro-batches.
    batches = jax.tree.map(lambda x: x[np.minimum(row, count - 1)], episodes)
    weight = jnp.asarray(row < count, float) / count
    if devices == 1:
        return _sum_rounds(loss, parameters, batches, weight, _with_device_axis)

    def on_device(parameters, batches, weight):
        if jax.process_count() == 1:
            return _sum_rounds(loss, parameters, batches, weight, lambda part: jax.lax.all_gather(part, AXIS))
        # Between machines every exchange costs a delay: one per batch, not one per round.
        return jax.lax.psum(_sum_rounds(loss, parameters, batches, weight, _with_device_axis), AXIS)

    by_device = PartitionSpec(None, AXIS)
    return jax.shard_map(
        on_device,
        mesh=mesh(devices),
        in_specs=(PartitionSpec(), by_device, by_device),
        out_specs=PartitionSpec(),
        check_vma=False,  # all devices gather or sum the same
    )(parameters, batches, weight)


def _with_device_axis(part: PyTree) -> PyTree:
    return jax.tree.map(lambda x: x[None], part)


def _sum_rounds(
    loss: Loss, parameters: PyTree, batches: PyTree, weight: Float[Array, "rounds 1 size"], gather: Callable
) -> tuple[Scalar, PyTree]:
    """Weighted sum of losses and its gradient; `gather` collects the parts of all devices in a round."""

    def add_round(total, batch):
        episodes, weight = jax.tree.map(lambda x: x[0], batch)
        part = jax.value_and_grad(lambda p: jnp.sum(weight * jax.vmap(loss, (None, 0))(p, episodes)))(parameters)
        # One by one: floating-point sums depend on the order, and this one is the same for any number of devices.
        return jax.lax.scan(lambda total, x: (jax.tree.map(jnp.add, total, x), None), total, gather(part))[0], None

    zero = jnp.zeros((), weight.dtype), jax.tree.map(jnp.zeros_like, parameters)
    return jax.lax.scan(add_round, zero, (batches, weight))[0]
