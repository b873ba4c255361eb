"""A program on shards gives the same bits on any number of devices, and sums over all of them."""

import jax
import jax.numpy as jnp
import numpy as np

from foveate.learning import shards
from foveate.learning.shards import devices_for, over_shards


def test_results_do_not_depend_on_the_number_of_devices(monkeypatch):
    rng = np.random.default_rng(0)
    parts, scale = rng.normal(size=(4, 5, 3)), jnp.asarray(1.7)

    def program(scale, parts, total):
        mean = total(jnp.sum(parts, axis=1)) / 20
        return scale * mean, scale * (parts - mean), jnp.sum(mean)

    found = []
    for devices in (1, 2):
        monkeypatch.setattr(shards, "devices_for", lambda shards, devices=devices: devices)
        found.append(jax.jit(lambda scale, parts: over_shards(program, scale, parts, 4))(scale, jnp.asarray(parts)))
    jax.tree.map(np.testing.assert_array_equal, *found)
    same, own, report = found[1]
    mean = parts.mean(axis=(0, 1))
    np.testing.assert_allclose(same, 1.7 * mean, rtol=1e-12)
    np.testing.assert_allclose(own, 1.7 * (parts - mean), rtol=1e-10)
    np.testing.assert_allclose(report, mean.sum(), rtol=1e-10)


def test_devices_share_the_shards_equally():
    assert jax.device_count() == 2, "as conftest.py says"
    assert [devices_for(shards) for shards in (1, 2, 3, 4)] == [1, 2, 1, 2]
