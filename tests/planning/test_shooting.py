"""Plans against brute force and closed forms; the settings of the ascent and the limits that it keeps."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.plans import FEW, PROBLEM, future_of

from foveate.planning.shooting import Plan, PlanSettings, ascend, better, level_at, plan
from foveate.planning.tours import straight_ahead
from foveate.simulation.information import score


@pytest.mark.slow
def test_plans_are_as_good_as_brute_force():
    """All sequences of 3 steps over a grid of 5 speeds and 7 turn rates; the ascent may not end below their best."""
    state = np.array([[[3.0, 2.5], [-1.0, -2.0]]] * 3) + 0.3 * np.arange(3)[:, None, None]
    future = future_of(PROBLEM, [0, 0, 0], state)
    grid = np.array(list(itertools.product(np.linspace(-1, 1, 5), np.linspace(-1, 1, 7))))
    sequences = jnp.asarray([np.stack(rows) for rows in itertools.product(grid, repeat=3)])
    values = jax.jit(lambda a: jax.lax.map(lambda one: score(PROBLEM, future, one, None), a, batch_size=5000))(
        sequences
    )
    settings = PlanSettings(starts=32, iterations=100)
    best = jax.jit(lambda f: plan(PROBLEM, f, settings, jax.random.key(1)))(future)
    assert float(best.score) >= float(values.max()) - 1e-9


def test_levels_move_from_first_to_last():
    settings = PlanSettings(iterations=100, first=(3.0, 0.6), last=(0.5, 0.2), annealed=0.5)
    for iteration, expected in ((0, (3.0, 0.6)), (25, (1.75, 0.4)), (50, (0.5, 0.2)), (99, (0.5, 0.2))):
        np.testing.assert_allclose(level_at(settings, jnp.array(iteration)), expected, rtol=1e-6)


def test_settings_are_checked():
    for name, value in (("starts", 0), ("iterations", -1), ("learning_rate", 0.0), ("annealed", -0.1)):
        with pytest.raises(ValueError, match=f"{name} = {value}"):
            PlanSettings(**{name: value})
    with pytest.raises(ValueError, match="last"):
        PlanSettings(last=(0.3, 0.0))


def test_a_target_straight_ahead_is_always_seen():
    """Closed form, one number per axis: variance p' = p + W, Y' = 1 / p' + 1 / V at every step."""
    steps = 5
    future = future_of(PROBLEM, [0, 0, 0], np.full((steps, 1, 2), [4.0, 0.0]))
    best = jax.jit(lambda f: plan(PROBLEM, f, FEW, jax.random.key(0)))(future)
    reached = [0.5 + 1 / 0.2**2]
    for _ in range(steps - 1):
        reached.append(1 / (1 / reached[-1] + 0.05**2) + 1 / 0.2**2)
    # One step of up to 4 m brings the target into the view of 2 m.
    np.testing.assert_allclose(best.score, 2 * np.log(reached[-1]), rtol=1e-9)


@pytest.fixture(scope="module")
def climb():
    """Ascent over 3 steps in the real view, compiled."""
    future = future_of(PROBLEM, [0, 0, 0], np.full((3, 1, 2), [3.0, 1.0]))
    return lambda raw, settings: jax.jit(lambda raw: ascend(PROBLEM, future, raw, settings))(raw), future


def test_limits_hold_exactly_even_far_up_the_tanh(climb):
    ascent, future = climb
    best = ascent(jnp.full((3, 2), 50.0), replace(FEW, learning_rate=5.0))
    control = np.asarray(jax.vmap(PROBLEM.agent.control)(best.action))
    assert (control >= np.asarray(PROBLEM.agent.lower)).all()
    assert (control <= np.asarray(PROBLEM.agent.upper)).all()
    assert (control[:, 0] == 4.0).all()
    again = jax.jit(lambda f: score(PROBLEM, f, best.action, None))(future)
    np.testing.assert_allclose(best.score, again, rtol=1e-9)


def test_the_best_plan_of_the_ascent_is_kept(climb):
    worse, best, broken = (Plan(jnp.zeros((1, 2)) + i, jnp.array(v)) for i, v in enumerate((1.0, 2.0, np.nan)))
    assert float(better(worse, best).score) == float(better(best, worse).score) == 2.0
    assert float(better(best, broken).score) == 2.0
    ascent, future = climb
    start = straight_ahead(PROBLEM, 3) + 0.1
    found = ascent(start, replace(FEW, learning_rate=30.0))  # throws every control to a limit at once
    assert float(found.score) >= float(jax.jit(lambda f: score(PROBLEM, f, jnp.tanh(start), None))(future))
