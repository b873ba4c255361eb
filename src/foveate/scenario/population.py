"""Detections of a simulation: the sources of its targets, and what the filter expects of its scenes."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from foveate.io.validate import require
from foveate.models.detections.records import DetectionModel, Sources
from foveate.models.problem import Problem
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.scenes import SceneSettings

SPARE_STD = 5.0
"""Room for targets beyond their expected number, in standard deviations of a Poisson variable."""
RAREST = 1e-9
"""Probability that more births or false alarms are drawn than there is room for."""


def detection_model(settings: DetectionSettings, problem: Problem, scenes: SceneSettings) -> DetectionModel:
    """The model of the filter and of a simulation's targets and scans.

    Raises InputError where the settings do not fit the scenes.
    """
    _check(settings, problem, scenes)
    model = settings.model(problem)
    first = model.first if settings.known else model.first + _in_scenes(model, scenes)
    return replace(model, first=first, sources=_sources(settings, scenes))


def expected_others(settings: DetectionSettings, steps: int) -> float:
    """Largest expected number of targets beside those of the scene, at any time in an episode."""
    first = settings.undetected + sum(birth.first for birth in settings.births)
    rate, kept = sum(birth.rate for birth in settings.births), settings.survival**steps
    born = rate * steps if settings.survival == 1.0 else rate * (1.0 - kept) / (1.0 - settings.survival)
    return max(first, kept * first + born)


def _sources(settings: DetectionSettings, scenes: SceneSettings) -> Sources:
    boxes = [settings.box(birth) for birth in settings.births]
    rates = np.array([birth.rate for birth in settings.births], float)
    d = len(settings.low_m)
    low, high = (np.array([box[side] for box in boxes], float).reshape(-1, d) for side in (0, 1))
    expected = expected_others(settings, scenes.horizon(scenes.targets_max))
    scattered = most_of(settings.undetected)
    beginners = scattered + sum(birth.first for birth in settings.births)
    return Sources(
        rate=jnp.asarray(rates, float),
        low=jnp.asarray(low, float),
        high=jnp.asarray(high, float),
        undetected=jnp.asarray(settings.undetected, float),
        first=tuple(birth.first for birth in settings.births),
        scattered=scattered,
        births=most_of(float(rates.sum())),
        others=max(beginners, math.ceil(expected + SPARE_STD * math.sqrt(expected))),
        clutter=most_of(settings.clutter),
    )


def most_of(mean: float) -> int:
    """The number that a Poisson variable exceeds with a probability of at most RAREST."""
    count, term = 0, math.exp(-mean)
    beyond = 1.0 - term
    while beyond > RAREST and count < mean + 40.0 * math.sqrt(mean + 1.0):
        count += 1
        term *= mean / count
        beyond -= term
    return count


def _in_scenes(model: DetectionModel, scenes: SceneSettings) -> jnp.ndarray:
    """Expected number of a scene's targets in each cell."""
    counts = range(scenes.targets_min, scenes.targets_max + 1)
    centre = np.array(scenes.centre_m)
    total = jnp.zeros(model.grid.shape)
    for n in counts:
        half = _half_side(scenes, n)
        low, high = (jnp.asarray(corner, float) for corner in (centre - half, centre + half))
        total += n / len(counts) * model.grid.overlap(low, high)
    return total


def _half_side(scenes: SceneSettings, targets: int) -> np.ndarray:
    return np.array(scenes.half_side_m) + scenes.half_side_per_target_m * targets


def _check(settings: DetectionSettings, problem: Problem, scenes: SceneSettings) -> None:
    motion = problem.motion
    moved = any(scenes.drift_m_s) or scenes.jitter_m_s > 0
    driven = motion.state_size == motion.dimension == motion.input_size and moved
    right = "expected false, or no drift and jitter: inputs of targets without ids are not known"
    require(not (driven and scenes.known_drift), "scenes.known_drift", True, right)
    right = "expected false: detections.births and detections.survival say which targets come and go"
    require(not scenes.birth_and_death, "scenes.birth_and_death", True, right)
    expected = scenes.targets_max + expected_others(settings, scenes.horizon(scenes.targets_max))
    right = f"expected at least {expected:.4g}, the expected number of targets"
    require(settings.tracks >= expected, "detections.tracks", settings.tracks, right)
    if settings.known:
        return
    right = "expected none with detections.known = false: the filter expects targets in the scenes' box"
    require(scenes.target_ring_m is None, "scenes.target_ring_m", scenes.target_ring_m, right)
    centre, half = np.array(scenes.centre_m), _half_side(scenes, scenes.targets_max)
    inside = np.all(centre - half >= np.array(settings.low_m) - 1e-9)
    inside = inside and np.all(centre + half <= np.array(settings.high_m) + 1e-9)
    right = f"expected a box within {settings.low_m} .. {settings.high_m}, that of the detections"
    require(bool(inside), "scenes.half_side_m", half.tolist(), right)
    right = "expected > 0 with detections.known = false"
    require(bool(np.all(_half_side(scenes, scenes.targets_min) > 0)), "scenes.half_side_m", scenes.half_side_m, right)
