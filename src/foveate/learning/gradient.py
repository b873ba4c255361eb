"""The mean of what many episodes cost, and its gradient: a micro-batch at a time, and over all devices.

What a micro-batch remembers for its way back is forgotten before the next begins: memory does not grow with the batch,
and on a CPU it stays in the cache.
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

Cost = Callable[[Any, Any], Scalar]
"""What an episode costs under these parameters; the second argument is all that differs between episodes."""


def mean_and_gradient(cost: Cost, parameters: PyTree, episodes: PyTree, micro_batch: int) -> tuple[Scalar, PyTree]:
    """The mean of `cost` over the leading axis of `episodes`, and its gradient with respect to `parameters`.

    At most `micro_batch` episodes are worked on at once by each device. How a batch is cut up changes rounding only. The
    cores of one machine cut it up alike and add up in one order however many they are: the same numbers, as long as XLA
    does not cut up single products by the number of cores, as it does from some 1,000 rows on.
    """
    count = len(jax.tree.leaves(episodes)[0])
    devices, rounds, size = sharded(count, micro_batch)
    row = np.arange(rounds * devices * size).reshape(rounds, devices, size)
    # What is left over is filled up with episodes that count nothing.
    cut = jax.tree.map(lambda x: x[np.minimum(row, count - 1)], episodes)
    weight = jnp.asarray(row < count, float) / count
    if devices == 1:
        return _in_turn(cost, parameters, cut, weight, _alone)

    def on_one(parameters, cut, weight):
        if jax.process_count() == 1:
            return _in_turn(cost, parameters, cut, weight, lambda one: jax.lax.all_gather(one, AXIS))
        # Between machines every exchange is a delay: one a batch.
        return jax.lax.psum(_in_turn(cost, parameters, cut, weight, _alone), AXIS)

    spread = PartitionSpec(None, AXIS)
    return jax.shard_map(
        on_one,
        mesh=mesh(devices),
        in_specs=(PartitionSpec(), spread, spread),
        out_specs=PartitionSpec(),
        check_vma=False,  # what every device has gathered or summed is the same in all of them
    )(parameters, cut, weight)


def _alone(one: PyTree) -> PyTree:
    return jax.tree.map(lambda x: x[None], one)


def _in_turn(
    cost: Cost, parameters: PyTree, cut: PyTree, weight: Float[Array, "rounds 1 size"], gather: Callable
) -> tuple[Scalar, PyTree]:
    """The weighted sum of costs and its gradient, a round after the other: in each, one part on every device."""

    def one_round(total, part):
        episodes, weight = jax.tree.map(lambda x: x[0], part)
        found = jax.value_and_grad(lambda p: jnp.sum(weight * jax.vmap(cost, (None, 0))(p, episodes)))(parameters)
        # One after the other, so that the sum does not depend on how many are found at once.
        return jax.lax.scan(lambda total, one: (jax.tree.map(jnp.add, total, one), None), total, gather(found))[0], None

    nothing = jnp.zeros((), weight.dtype), jax.tree.map(jnp.zeros_like, parameters)
    return jax.lax.scan(one_round, nothing, (cut, weight))[0]
