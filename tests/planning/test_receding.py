"""Planning again at every step: what an online planner knows, and what it believes about later inputs."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.plans import FEW, PROBLEM, TWO

from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.experiment.presets import PRESETS
from foveate.planning.receding import Receding
from foveate.planning.shooting import PAPER, plan
from foveate.planning.tours import straight_ahead
from foveate.simulation.information import believed_future
from foveate.simulation.records import SURROGATE, TRUE, Observation, Policy


def receding(settings=FEW, policy=None):
    return Receding(problem=PROBLEM, settings=settings, window=TWO.horizon, policy=policy)


class Gentle(Policy):
    """Turns by where the first target is, far from the limits, and counts its decisions."""

    def start(self, observation):
        return jnp.zeros(())

    def __call__(self, observation, memory, key):
        return 0.5 * jnp.tanh(observation.mean[0] - observation.pose[:2] + 0.1 * memory), memory + 1


def test_refinement_without_ascent_equals_the_policy():
    suite = prepare(PROBLEM, PRESETS["paper"].scenario.scenes, [TWO], seed=3)
    refined = receding(replace(FEW, starts=1, iterations=0), Gentle())
    plain, same = (evaluate_traces(suite, policy, TRUE, chunk=1).action for policy in (Gentle(), refined))
    np.testing.assert_allclose(same, plain, atol=1e-12)


def changed_later(suite):
    """Other inputs and another truth from the second step on."""
    later = eqx.tree_at(
        lambda e: (e.inputs, e.truth.state),
        suite.episodes,
        (suite.episodes.inputs.at[:, 1:].add(0.7), suite.episodes.truth.state.at[:, 2:].add(1.3)),
    )
    return replace(suite, episodes=later, truth=later.truth)


@pytest.mark.slow
def test_online_planners_do_not_see_the_future():
    suite = prepare(PROBLEM, PRESETS["paper"].scenario.scenes, [TWO], seed=3)
    settings = replace(FEW, starts=3, iterations=10, keep=PAPER)
    here, there = (
        evaluate_traces(one, receding(settings, Gentle()), SURROGATE, chunk=1).action[0]
        for one in (suite, changed_later(suite))
    )
    np.testing.assert_array_equal(here[0], there[0])
    assert np.abs(here[1:] - there[1:]).max() > 1e-3, "what it sees later, it uses"


@pytest.mark.slow
def test_belief_about_later_inputs_is_their_mean_so_far():
    """The plan of the second step is the one for a future of the mean of two inputs."""
    observation = Observation(
        step=jnp.array(1),
        left=jnp.array(5),
        pose=jnp.zeros(3),
        mean=jnp.array([[1.0, 2.0]]),
        information=jnp.eye(2)[None],
        present=jnp.array([True]),
        known_input=jnp.array([[0.4, 0.0]]),
    )
    settings = replace(FEW, starts=1, iterations=2, keep=PAPER)
    policy = receding(settings)

    @jax.jit
    def both(observation):
        one_step = (jnp.array([[0.2, -0.2]]), jnp.array(1))
        memory = eqx.tree_at(lambda m: (m.total_input, m.steps), policy.start(observation), one_step)
        future = believed_future(PROBLEM, observation, jnp.array([[0.3, -0.1]]), TWO.horizon, jnp.array(5))
        expected = plan(PROBLEM, future, settings, jax.random.key(0), straight_ahead(PROBLEM, TWO.horizon)[None])
        return future, expected.action[0], policy(observation, memory, jax.random.key(0))

    future, expected, (action, memory) = both(observation)
    np.testing.assert_allclose(future.state[:3, 0], [[1.0, 2.0], [1.3, 1.9], [1.6, 1.8]], rtol=1e-12)
    assert int(future.horizon) == 5, "of the six steps of the window one is done"
    np.testing.assert_allclose(action, expected, rtol=1e-9)
    np.testing.assert_allclose(memory.total_input, [[0.6, -0.2]], rtol=1e-12)
