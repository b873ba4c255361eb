"""The box of all starts holds every start that is drawn, and no more than it needs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.starts import start_box
from foveate.simulation.episodes import draw, draw_size


@pytest.mark.parametrize(
    "scenes",
    [
        SceneSettings(),
        SceneSettings(target_ring_m=(3.0, 6.0), agent_centre_m=(4.0, 0.0), agent_half_side_m=(1.0, 2.0)),
        SceneSettings(half_side_m=(3.0, 9.0), half_side_per_target_m=0.0, agent_spread=0.5, centre_m=(1.0, 2.0)),
    ],
)
def test_it_holds_all_starts_tightly(scenes):
    scenes = replace(scenes, targets_min=scenes.targets_max)
    problem = Scenario().problem()
    numbers = jax.random.uniform(jax.random.key(0), (2000, draw_size(scenes, problem)), minval=-1.0)
    drawn = jax.vmap(lambda x: draw(scenes, problem, x))(numbers)
    points = jnp.concatenate([drawn.position.reshape(-1, 2), drawn.pose[:, :2]])
    low, high = np.array(start_box(scenes, None))
    assert (points >= low).all()
    assert (points <= high).all()
    np.testing.assert_allclose(points.min(axis=0), low, atol=0.03 * np.max(high - low))
    np.testing.assert_allclose(points.max(axis=0), high, atol=0.03 * np.max(high - low))


def test_it_is_the_region_that_the_agent_keeps():
    region = RegionSettings(low_m=(-5.0, -4.0), high_m=(5.0, 4.0))
    assert start_box(SceneSettings(), region) == (region.low_m, region.high_m)
    assert start_box(SceneSettings(), replace(region, agent="free")) == start_box(SceneSettings(), None)
