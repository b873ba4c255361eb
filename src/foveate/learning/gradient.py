"""Compute the mean loss of many episodes and its gradient, in micro-batches and on all devices.

A micro-batch frees the memory of its backward pass before the next begins: memory does not grow with the batch, and on
a CPU it stays in the cache.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec
from jaxtyping import PyTree

from foveate.learning.devices import AXIS, Schedule, Share, mesh, schedule
from foveate.types import Count, Scalar

Loss = Callable[[Any, Any], Scalar]
"""Loss of one episode: (parameters, all that differs between episodes) -> loss."""


class Group(NamedTuple):
    """Episodes of one shape: their loss, and all that differs between them, stacked; they make up `share`."""

    loss: Loss
    episodes: PyTree
    share: Share


def mean_and_gradient(groups: Sequence[Group], parameters: PyTree) -> tuple[Scalar, PyTree]:
    """Compute the mean loss of the episodes of all groups, and its gradient in `parameters`.

    Each device works on at most `micro_batch` episodes at once; this changes rounding only. On one machine numbers do
    not depend on the number of cores, which add in one order, unless XLA splits single products by it, as it does from
    some 1,000 rows on.
    """
    plan = schedule([group.share for group in groups])
    episodes = [group.episodes for group in groups]
    if plan.devices == 1:
        return _total(_lanes(groups, plan, jnp.zeros((), int), parameters, episodes))

    def on_device(parameters, episodes):
        lanes = _lanes(groups, plan, jax.lax.axis_index(AXIS), parameters, episodes)
        # A single exchange, since between machines each costs a delay. Other devices have zeros in a lane.
        return _total(jax.lax.psum(lanes, AXIS))

    return jax.shard_map(
        on_device,
        mesh=mesh(plan.devices),
        in_specs=(PartitionSpec(), PartitionSpec()),
        out_specs=PartitionSpec(),
        check_vma=False,  # all devices sum the same
    )(parameters, episodes)


def _lanes(groups: Sequence[Group], plan: Schedule, device: Count, parameters: PyTree, episodes: PyTree) -> PyTree:
    """Sums of this device's micro-batches, (loss, gradient) by lane."""
    total = sum(group.share.episodes for group in groups)
    lanes = jax.tree.map(lambda x: jnp.zeros((plan.lane_count, *x.shape), x.dtype), (jnp.zeros(()), parameters))
    for i, (loss, _, share) in enumerate(groups):
        most = max(map(len, plan.parts[i]))
        numbers = jnp.asarray([own + (-1,) * (most - len(own)) for own in plan.parts[i]])[device]

        def add(lanes, number, i=i, loss=loss, last=share.episodes - 1):
            rows = number * plan.sizes[i] + jnp.arange(plan.sizes[i])
            # Copies of the last episode, of weight zero, fill the last micro-batch.
            weight = (rows <= last).astype(float) / total
            batch = jax.tree.map(lambda x: x[jnp.minimum(rows, last)], episodes[i])
            sums = jax.value_and_grad(lambda p: jnp.sum(weight * jax.vmap(loss, (None, 0))(p, batch)))(parameters)
            lane = jnp.asarray(plan.lanes[i])[number]
            return jax.tree.map(lambda lanes, new: lanes.at[lane].add(new), lanes, sums)

        def add_own(lanes, number, add=add):
            return jax.lax.cond(number >= 0, add, lambda lanes, _: lanes, lanes, number), None

        # Loops of unknown length are slow on a CPU. The barrier keeps XLA from compiling a micro-batch differently, and
        # so from rounding differently, where the condition is known, as on one device.
        lanes, _ = jax.lax.scan(add_own, lanes, jax.lax.optimization_barrier(numbers))
    return lanes


def _total(lanes: PyTree) -> PyTree:
    """Sum of the lanes, one by one: floating-point sums depend on the order, and this one is always the same."""
    zero = jax.tree.map(lambda x: jnp.zeros_like(x[0]), lanes)
    return jax.lax.scan(lambda total, x: (jax.tree.map(jnp.add, total, x), None), zero, lanes)[0]
