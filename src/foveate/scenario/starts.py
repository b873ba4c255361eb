"""The box that holds the starts of agent and targets, for which maps are made."""

import numpy as np

from foveate.geometry.distance_grid import Box
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenes import SceneSettings


def start_box(scenes: SceneSettings, region: RegionSettings | None) -> Box:
    """Low and high corner [m] of the region, if the agent keeps its borders, or else of all starts of random scenes."""
    if region is not None and region.agent != "free":
        return region.low_m, region.high_m
    centre = np.array(scenes.centre_m)
    half = np.array(scenes.half_side_m) + scenes.half_side_per_target_m * scenes.targets_max
    agent_centre = centre if scenes.agent_centre_m is None else np.array(scenes.agent_centre_m)
    agent_half = scenes.agent_spread * half if scenes.agent_half_side_m is None else np.array(scenes.agent_half_side_m)
    low, high = centre - half, centre + half
    if scenes.target_ring_m is not None:
        reach = agent_half + scenes.target_ring_m[1]
        low[:2], high[:2] = (agent_centre - reach)[:2], (agent_centre + reach)[:2]
    low, high = np.minimum(low, agent_centre - agent_half), np.maximum(high, agent_centre + agent_half)
    return tuple(low.tolist()), tuple(high.tolist())
