"""A damped derivative against central differences of an episode whose later poses are held, step by step."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.linalg import log_det_spd
from foveate.models.sensor import Softness
from foveate.planning.receding import Given
from foveate.problem import Episode
from foveate.rollout import EXACT, Flow, Protocol, act, instants, log_dets, predict, start
from foveate.scenario import Scenario

PROBLEM, KEY, STEPS = Scenario().problem(), jax.random.key(0), 4
PROTOCOL = Protocol(levels=(Softness(1.0, 1.5),))
RNG = np.random.default_rng(3)
EPISODE = Episode(
    pose=jnp.array([0.3, -0.2, 0.4]),
    mean=jnp.asarray(RNG.uniform(-4, 4, (3, 2))),
    present=jnp.ones(3, bool),
    inputs=jnp.asarray(0.3 * RNG.normal(size=(STEPS, 3, 2))),
    horizon=jnp.asarray(STEPS),
)
ACTIONS = jnp.asarray(RNG.uniform(-0.6, 0.6, (STEPS, 2)))


def total(actions, flow):
    return jnp.sum(log_dets(PROBLEM, Given(actions), EPISODE, PROTOCOL, KEY, flow)[-1])


@jax.jit
def alone(actions, changed, at):
    """The same score where step `at` takes the `changed` action, but every later step begins where it did before."""

    def step(carry, x):
        state, pose = carry
        instant, action, k = x
        predicted = predict(PROBLEM, eqx.tree_at(lambda s: s.pose, state, pose), instant.known_input)
        before = act(PROBLEM, PROTOCOL, predicted, instant, action)[0].pose
        state = act(PROBLEM, PROTOCOL, predicted, instant, jnp.where(k == at, changed, action))[0]
        return (state, before), None

    first = start(PROBLEM, EPISODE, PROTOCOL)
    (last, _), _ = jax.lax.scan(step, (first, first.pose), (instants(EPISODE), actions, jnp.arange(STEPS)))
    return jnp.sum(log_det_spd(last.information[0]))


def test_without_foresight_an_action_counts_for_what_is_seen_right_after_it():
    ours = jax.jit(jax.grad(lambda a: total(a, Flow(foresight=0.0))))(ACTIONS)
    np.testing.assert_allclose(alone(ACTIONS, ACTIONS[1], 1), total(ACTIONS, EXACT), rtol=1e-12)
    for k in range(STEPS):
        for axis in range(2):
            ahead, behind = (alone(ACTIONS, ACTIONS[k].at[axis].add(h), k) for h in (1e-5, -1e-5))
            np.testing.assert_allclose(ours[k, axis], (ahead - behind) / 2e-5, rtol=1e-6, atol=1e-7)
    exact = jax.jit(jax.grad(lambda a: total(a, EXACT)))(ACTIONS)
    np.testing.assert_allclose(ours[-1], exact[-1], rtol=1e-12)
    assert np.abs(ours - exact)[:-1].max() > 0.1 * np.abs(exact).max()


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_is_a_polynomial_of_the_steps_between(share):
    """d J / d a_0 = sum over k of share^k g_k: four shares give the four g_k, and so every other share."""

    def slope(x):
        return jax.grad(lambda a: total(a, Flow(foresight=float(x))))(ACTIONS)[0]

    nodes = np.array([0.1, 0.5, 0.7, 0.9])
    parts = np.linalg.solve(np.vander(nodes, STEPS, increasing=True), np.array([slope(x) for x in nodes]))
    np.testing.assert_allclose(slope(share), np.array([share**k for k in range(STEPS)]) @ parts, atol=1e-9)


@pytest.mark.parametrize("flow", [Flow(0.0, 0.0), Flow(0.5, 0.3)])
def test_values_do_not_change(flow):
    np.testing.assert_allclose(total(ACTIONS, flow), total(ACTIONS, EXACT), rtol=1e-12)
