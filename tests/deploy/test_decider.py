"""Decisions one after another: steps, keys and memory as in a rollout, whatever the number of targets."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from helpers.decisions import seen

from foveate.deploy.decider import Decider
from foveate.policies.heuristics import Random
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Policy

PROBLEM = Scenario().problem()
AGENT = PROBLEM.agent


class Counting(Policy):
    """Drives at a tenth of the range for every decision in its memory, which is a number, or one for each target."""

    per_target: bool

    def start(self, observation):
        return jnp.zeros(len(observation.present) if self.per_target else ())

    def __call__(self, observation, memory, key):
        fast = -1.0 + 0.1 * jnp.max(memory) + 0.0 * observation.mean[0, 0]
        return jnp.stack([fast, 0.01 * observation.step.astype(float)]), memory + 1


def beliefs(count, first=0.0):
    return seen([0, 0, 0], np.full((count, 2), first), np.zeros(count), np.ones(count, bool))


def decisions(commands):
    """Decisions in the memory, and the number of the step, of each command of `Counting`."""
    actions = np.asarray(jax.vmap(AGENT.action)(jnp.asarray(commands)))
    return [(round(10 * (fast + 1)), round(100 * turn)) for fast, turn in actions]


def test_a_memory_lasts_until_reset():
    decider = Decider(Counting(False), AGENT)
    assert decisions([decider.command(beliefs(3)) for _ in range(3)]) == [(0, 0), (1, 1), (2, 2)]
    decider.reset()
    assert decisions([decider.command(beliefs(3)) for _ in range(2)]) == [(0, 0), (1, 1)]


def test_only_a_memory_of_each_target_begins_again_with_another_number():
    for per_target, expected in ((False, [(0, 0), (1, 1), (2, 2)]), (True, [(0, 0), (1, 1), (0, 2)])):
        decider = Decider(Counting(per_target), AGENT)
        assert decisions([decider.command(beliefs(count)) for count in (3, 3, 5)]) == expected


def test_a_command_that_is_not_finite_leaves_no_trace():
    decider = Decider(Counting(False), AGENT)
    decider.command(beliefs(3))
    assert not np.isfinite(decider.command(beliefs(3, np.inf))).all()
    assert decisions([decider.command(beliefs(3))]) == [(1, 1)]


def test_random_numbers_are_those_of_a_rollout():
    decider, random = Decider(Random(PROBLEM), AGENT, seed=5), Random(PROBLEM)
    for step in range(3):
        key = jax.random.fold_in(jax.random.key(5), step)
        expected = AGENT.control(random(beliefs(1), (), key)[0])
        np.testing.assert_allclose(decider.command(replace(beliefs(1), step=jnp.asarray(77))), expected, rtol=1e-12)
