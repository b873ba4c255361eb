"""Multiply-adds of dense layers, counted in traced programs; by hand from the layers' shapes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from foveate.bench.operations import multiply_adds, per_episode
from foveate.scenario.scenes import SceneSettings

LAYER = eqx.nn.Linear(5, 7, key=jax.random.key(0))


def halves(layer, x, context):
    """W [x; c] = W_x x + W_c c, with the context's product once."""
    return jax.vmap(lambda one: layer.weight[:, :3] @ one)(x) + layer.weight[:, 3:] @ context


class Network(eqx.Module):
    layer: eqx.nn.Linear
    call: object = eqx.field(static=True)

    def __call__(self, *inputs):
        return self.call(self.layer, *inputs)


def folded(layer, rows):
    """A loop of four steps, one of them skipped if its row is negative; the dearer branch counts."""

    def step(total, row):
        return jax.lax.cond(row[0] > 0, lambda: total + layer(row), lambda: total), None

    return jax.lax.scan(step, jnp.zeros(7), rows)[0]


@pytest.mark.parametrize(
    ("call", "shapes", "expected"),
    [
        (lambda layer, x: layer(x), [(5,)], 35),
        (lambda layer, x: jax.vmap(layer)(x), [(4, 5)], 4 * 35),
        (lambda layer, x: jax.vmap(jax.vmap(layer))(x), [(2, 4, 5)], 8 * 35),
        (lambda layer, x: jax.jit(jax.vmap(layer))(x), [(4, 5)], 4 * 35),
        (lambda layer, x: x @ layer.weight.T, [(4, 5)], 4 * 35),
        (halves, [(4, 3), (2,)], 4 * 7 * 3 + 7 * 2),
        (folded, [(4, 5)], 4 * 35),
        (lambda layer, x: x @ x.T, [(4, 5)], 0),  # of computed numbers only, as in attention
        (lambda layer, x: layer.weight @ jax.nn.softmax(x @ x), [(5, 5)], 7 * 5 * 5),
    ],
)
def test_products_with_parameters_are_counted(call, shapes, expected):
    assert multiply_adds(Network(LAYER, call), *map(jnp.ones, shapes)) == expected


def test_steps_of_an_episode_are_real_ones():
    """1 to 3 targets for twice as many steps: (1 x 2 + 2 x 4 + 3 x 6) / 3 steps of targets."""
    scenes = SceneSettings(targets_min=1, targets_max=3, steps_per_target=2)
    assert per_episode(float, scenes) == pytest.approx(28 / 3)
    assert per_episode(lambda n: 1.0, scenes) == scenes.mean_horizon
