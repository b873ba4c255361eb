"""The environment as pure functions: the same numbers as Gymnasium's, under jit and vmap, and with a derivative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import foveate
from foveate.errors import InputError


def test_an_episode_by_reset_and_step():
    environment = foveate.environment("paper")
    state, seen = jax.jit(environment.reset)(jax.random.key(0), jnp.array(3))
    assert int(seen.present.sum()) == 3
    step, total, done = jax.jit(environment.step), float(state.score), False
    first = total
    for k in range(9):
        state, made = step(state, jnp.array([0.5, 0.1]))
        total, done = total + float(made.reward), bool(made.done)
        assert done is (k == 8)
    assert total == pytest.approx(float(made.score), abs=1e-4)
    assert first == pytest.approx(2 * np.log(0.5), abs=1e-6)  # Y_0 = 0.5 I in the plane


def test_several_side_by_side_and_a_derivative():
    environment = foveate.environment("paper", protocol="surrogate", noise=False)
    states, _ = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(1), 4))

    @jax.jit
    def mean_reward(actions):
        return jnp.mean(jax.vmap(environment.step)(states, actions)[1].reward)

    actions = jnp.full((4, 2), 0.1)
    gradient = np.asarray(jax.jit(jax.grad(mean_reward))(actions))
    h = 1e-3
    up, down = (mean_reward(actions.at[2, 0].add(sign * h)) for sign in (1, -1))
    assert gradient[2, 0] == pytest.approx(float(up - down) / (2 * h), rel=2e-2, abs=1e-5)


def test_wrong_use_is_named():
    with pytest.raises(InputError, match="noise = False"):
        foveate.environment("paper", noise=False)
