"""A program on equal parts of a batch, the shards, on as many devices as there are."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec
from jaxtyping import PyTree

from foveate.learning.devices import AXIS, mesh

Total = Callable[[PyTree], PyTree]
"""Sum over all shards, of this device and others, of arrays with a leading axis of this device's shards."""


def over_shards(program: Callable[[PyTree, PyTree, Total], Any], common: PyTree, parts: PyTree, shards: int) -> Any:
    """Run `program(common, parts, total)`; `parts` have a leading axis of shards, split among the devices.

    It returns (the same on every device, a part of each shard, the same on every device), of which the second is
    gathered. Sums are in one order, so that results do not depend on the number of devices.
    """
    devices = devices_for(shards)
    if devices == 1:
        return program(common, parts, _sum)

    def on_device(common, parts):
        same, own, report = program(common, parts, _sum_of_all)
        return same, _of_all(own), report

    return jax.shard_map(
        on_device,
        mesh=mesh(devices),
        in_specs=(PartitionSpec(), PartitionSpec(AXIS)),
        out_specs=PartitionSpec(),
        check_vma=False,  # all devices gather and sum the same
    )(common, parts)


def devices_for(shards: int) -> int:
    """Number of devices that equal numbers of shards run on: one in a training of several processes."""
    most = min(shards, jax.device_count()) if jax.process_count() == 1 else 1
    return max(devices for devices in range(1, most + 1) if shards % devices == 0)


def _sum(tree: PyTree) -> PyTree:
    # One by one: floating-point sums depend on the order.
    first, rest = jax.tree.map(lambda x: x[0], tree), jax.tree.map(lambda x: x[1:], tree)
    return jax.lax.scan(lambda total, x: (jax.tree.map(jnp.add, total, x), None), first, rest)[0]


def _sum_of_all(tree: PyTree) -> PyTree:
    return _sum(_of_all(tree))


def _of_all(tree: PyTree) -> PyTree:
    return jax.tree.map(lambda x: jax.lax.all_gather(x, AXIS, tiled=True), tree)
