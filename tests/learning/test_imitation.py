"""Lessons: what is ascended is the likeness that a loop over steps finds, with the states held, and it is learned."""

import json
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from foveate.episodes import training_episode
from foveate.learning.imitation import likeness
from foveate.learning.training import train
from foveate.policies.attention import AttentionSettings
from foveate.policies.handmade import handmade
from foveate.problem import Episode
from foveate.rollout import SURROGATE, observe, predict, rollout, start
from foveate.scenario import Scenario
from foveate.settings import Experiment, TrainingSettings

PROBLEM, KEY = Scenario().problem(), jax.random.key(0)
SETTINGS = TrainingSettings()
PUPIL = AttentionSettings(agent_widths=(6,), target_widths=(6,), out_widths=(5,)).policy(PROBLEM, jax.random.key(4))


def episode() -> Episode:
    drawn = training_episode(PROBLEM, Scenario().scenes, jax.random.key(7), noise=False)
    return eqx.tree_at(lambda e: e.horizon, drawn, jnp.asarray(6))


def observations(policy, run):
    """What the policy saw in each of its steps, one after the other."""
    trace = rollout(PROBLEM, policy, run, SURROGATE, KEY)
    state, seen = start(PROBLEM, run, SURROGATE), []
    for k in range(6):
        places = (trace.pose[k], trace.mean[k], trace.information[k][None], jnp.asarray(k))
        state = eqx.tree_at(lambda s: (s.pose, s.mean, s.information, s.step), state, places)
        seen.append(observe(predict(PROBLEM, state, run.inputs[k]), run.inputs[k], run.horizon))
    return seen


def difference(policy, teacher, seen):
    memory, total = teacher.start(seen[0]), 0.0
    for observation in seen:
        wanted, memory = teacher(observation, memory, KEY)
        total += jnp.sum((policy(observation, (), KEY)[0] - wanted) ** 2)
    return total / len(seen)


def test_likeness_is_that_of_a_loop_and_its_derivative_holds_the_states():
    run = episode()
    for name in ("uncertain", "lawnmower"):  # the latter remembers where it was
        teacher, seen = handmade(name, PROBLEM, 2.0), observations(PUPIL, run)
        ours = eqx.filter_value_and_grad(lambda p, t=teacher: likeness(PROBLEM, p, t, run, SETTINGS, KEY))
        value, slope = eqx.filter_jit(ours)(PUPIL)
        np.testing.assert_allclose(value, -difference(PUPIL, teacher, seen), rtol=1e-10)
        theta, restore = ravel_pytree(eqx.filter(PUPIL, eqx.is_inexact_array))
        rest, rng = eqx.filter(PUPIL, eqx.is_inexact_array, inverse=True), np.random.default_rng(0)
        for direction in rng.normal(size=(3, theta.size)):
            ahead, behind = (
                difference(eqx.combine(restore(theta + h * direction), rest), teacher, seen) for h in (1e-6, -1e-6)
            )
            along = float(ravel_pytree(slope)[0] @ direction)
            np.testing.assert_allclose(along, -(ahead - behind) / 2e-6, rtol=1e-5, atol=1e-7)


def test_lessons_come_first_and_are_learned(tmp_path):
    training = TrainingSettings(
        epochs=100, episodes=32, learning_rate=3e-3, lessons=0.8, teacher="nearest", held_out=4, check_every=40
    )
    train(replace(Experiment(), training=training), tmp_path / "run")
    checks = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert [check["epoch"] for check in checks] == [40, 80, 100], "a check does not straddle the end of the lessons"
    first, second, ascent = (check["objective"] for check in checks)
    assert first < second - 0.1 < -0.1, "minus the squared difference to the teacher"
    assert ascent < -1.0 or ascent > 0.0, "log det now"
