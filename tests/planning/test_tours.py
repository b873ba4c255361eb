"""First plans: tours through every target, straight ahead, and how far away to look from."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers.plans import PROBLEM, SPATIAL, future_of

from foveate.geometry.fov import ball
from foveate.geometry.fov_spatial import prism
from foveate.planning.tours import best_range, tours
from foveate.simulation.information import final_log_det


def test_best_range_is_the_deepest_point_ahead():
    # Triangle of depth 2 and 120 deg: as far from the end as from the sides, 2 - x = x sin 60.
    np.testing.assert_allclose(best_range(PROBLEM.sensor.view), 2 / (1 + np.sin(np.pi / 3)), atol=0.03)
    np.testing.assert_allclose(best_range(ball([1.0, 0.0], 1.0)), 1.0, atol=0.03)
    assert best_range(SPATIAL.sensor.view) > 1
    np.testing.assert_array_equal(best_range(prism(PROBLEM.sensor.view)), best_range(PROBLEM.sensor.view))


def test_tours_see_every_target():
    position = np.array([[3.0, 3.0], [-3.0, 2.0], [0.0, -4.0]])
    future = future_of(PROBLEM, [0, 0, 0], np.broadcast_to(position, (15, 3, 2)))
    raw = jax.jit(lambda f: tours(PROBLEM, f, 16, jax.random.key(0)))(future)
    assert raw.shape == (16, 15, 2)
    assert len(np.unique(np.asarray(raw)[:, 0, 1])) == 16
    seen = jax.jit(jax.vmap(lambda one: final_log_det(PROBLEM, future, jnp.tanh(one), None)))(raw)
    assert (np.asarray(seen) > 3).mean() > 0.5, "most targets are seen by most tours, before any ascent"
