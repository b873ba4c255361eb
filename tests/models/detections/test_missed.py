"""Tracks that a scan missed, against the exact probabilities of a target at a point of a fine grid."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.models.detections import filter as pmb
from foveate.models.detections.missed import look_in_vain
from foveate.models.detections.records import Look, Scan, Tracks
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario

PROBLEM = Scenario(view=SectorView(depth_m=5.0, angle_deg=360.0)).problem()
POSE = jnp.zeros(3)


def look(tracks: Tracks, before: Look, **settings):
    model = DetectionSettings(low_m=(-9.0, -9.0), high_m=(9.0, 9.0), tracks=1, **settings).model(PROBLEM)
    return jax.jit(lambda tracks, before: look_in_vain(PROBLEM, model, tracks, before, POSE))(tracks, before)


def track(x: float, std: float = 1.0) -> Tracks:
    return Tracks(jnp.ones(1), jnp.array([[x, 0.0]]), std**2 * jnp.eye(2)[None], jnp.zeros(1, int))


FIRST_OF_16 = jnp.arange(16) < 1
FIRST = Look(POSE, jnp.zeros(1, bool), jnp.zeros(1))


def exact(x: float, probability: float, half_range_m: float = np.inf, looks: int = 1):
    """Probability of a detection after some looks in vain, and mean and variance along x: sums over a fine grid."""
    axis = np.linspace(-9, 9, 601)
    points = np.stack(np.meshgrid(axis + x, axis, indexing="ij"), axis=-1)
    density = np.exp(-0.5 * ((points - [x, 0.0]) ** 2).sum(axis=-1))
    range_m = np.linalg.norm(points, axis=-1)
    chance = np.where(range_m <= 5.0, probability * 2.0 ** -((range_m / half_range_m) ** 2), 0.0)
    for _ in range(looks):
        detection = (chance * density).sum() / density.sum()
        density = density * (1 - chance)
    along = points[..., 0]
    mean = (along * density).sum() / density.sum()
    return detection, mean, ((along - mean) ** 2 * density).sum() / density.sum()


@pytest.mark.parametrize(("x", "options"), [(5.3, {}), (4.5, {}), (0.0, {}), (4.0, {"half_range_m": 4.0}), (20.0, {})])
def test_a_look_in_vain_by_bayes(x, options):
    found, (detection, mean, variance) = look(track(x), FIRST, **options), exact(x, 0.9, **options)
    assert float(found.detection[0]) == pytest.approx(detection, abs=0.03)
    assert float(found.mean[0, 0]) == pytest.approx(mean, abs=0.06)
    assert float(found.covariance[0, 0, 0]) == pytest.approx(variance, abs=0.08)


@pytest.mark.parametrize("x", [4.5, 5.3])
def test_a_second_look_at_the_same_ground_takes_off_only_what_is_left_there(x):
    once = look(track(x), FIRST, probability=0.8)
    moved = Tracks(jnp.ones(1), once.mean, once.covariance, jnp.zeros(1, int))
    twice = look(moved, Look(POSE, jnp.ones(1, bool), once.excess), probability=0.8)
    assert float(twice.detection[0]) == pytest.approx(exact(x, 0.8, looks=2)[0], abs=0.03)
    naive = look(moved, FIRST, probability=0.8)
    assert float(naive.detection[0]) > float(twice.detection[0]) + 0.03
    np.testing.assert_array_equal(twice.covariance, moved.covariance)


@pytest.mark.parametrize("looks", [1, 2, 3])
def test_what_was_looked_for_in_vain_claims_few_detections_in_view(looks):
    """A detection at (3.5, 0), where a target of the track at (4.5, 0) is, by Bayes, rarer with every look in vain.

    In the filter: the existence after it is r w / (r w + clutter), where w is the density of the track's detection.
    """
    range_m = np.linspace(-9, 9, 601)
    x, y = np.meshgrid(range_m + 4.5, range_m, indexing="ij")
    density = np.exp(-0.5 * ((x - 4.5) ** 2 + y**2))
    chance = np.where(np.hypot(x, y) <= 5.0, 0.8, 0.0)
    model = DetectionSettings(low_m=(-9.0, -9.0), high_m=(9.0, 9.0), probability=0.8, clutter=4.0, tracks=1)
    model = model.model(PROBLEM)
    step = jax.jit(lambda population, scan: pmb.update(PROBLEM, model, population, POSE, scan))
    none, one = (
        Scan(jnp.zeros((16, 2)), jnp.zeros(16, bool)),
        Scan(jnp.full((16, 2), jnp.array([3.5, 0.0])), FIRST_OF_16),
    )
    existence = 0.9
    population = pmb.start(PROBLEM, model, POSE, replace(track(4.5), existence=jnp.array([existence])))
    for _ in range(looks):
        missed = (density * (1.0 - chance)).sum() / density.sum()
        density, existence = density * (1.0 - chance), existence * missed / (1.0 - existence + existence * missed)
        population = step(population, none)
    V = float(PROBLEM.sensor.V[0, 0])
    likelihood = np.exp(-0.5 * ((x - 3.5) ** 2 + y**2) / V) / (2 * np.pi * V)
    claim = existence * (density * chance * likelihood).sum() / density.sum()
    overlooked = existence * (density * (1.0 - chance)).sum() / density.sum()
    clutter = 4.0 / float(model.view_volume)
    # Of the two ways, that the track made the detection, or a false alarm did and the track is missed or not there.
    ways = np.array([claim, clutter * overlooked, clutter * (1.0 - existence)])
    found = step(population, one).tracks
    assert float(population.tracks.existence[0]) == pytest.approx(existence, abs=0.03)
    assert float(found.existence[0]) == pytest.approx(1.0 - ways[2] / ways.sum(), abs=0.06)


def test_a_belief_all_in_view_keeps_its_shape():
    found = look(track(0.0, std=0.3), FIRST)
    np.testing.assert_allclose(found.covariance[0], 0.09 * np.eye(2), atol=1e-12)
    assert float(found.detection[0]) == pytest.approx(0.9)


def test_a_wall_hides_tracks_and_cells():
    """A wall across x = 2: a belief behind it was not looked for, one before it was, and neither were cells behind."""
    wall = ShapeObstacles(boxes=((2.0, -6.0, 2.2, 6.0),))
    walled = Scenario(view=SectorView(depth_m=5.0, angle_deg=360.0), obstacles=wall).problem()
    model = DetectionSettings(low_m=(-9.0, -9.0), high_m=(9.0, 9.0), cells=(18, 18), tracks=1).model(walled)

    @jax.jit
    def detection(x):
        mean = jnp.stack([x, jnp.zeros_like(x)])[None]
        tracks = Tracks(jnp.array([0.8]), mean, 0.04 * jnp.eye(2)[None], jnp.zeros(1, int))
        population = replace(pmb.start(walled, model, POSE, tracks), undetected=jnp.ones((18, 18)))
        scan = Scan(jnp.zeros((16, 2)), jnp.zeros(16, bool))
        return look_in_vain(walled, model, tracks, FIRST, POSE), pmb.update(walled, model, population, POSE, scan)

    behind, after = detection(jnp.array(3.5))
    before, _ = detection(jnp.array(1.0))
    assert float(behind.detection[0]) == pytest.approx(0.0, abs=1e-6)
    assert float(before.detection[0]) == pytest.approx(0.9, abs=0.01)
    near, far = np.asarray(after.undetected)[[9, 12], 9]
    assert near == pytest.approx(0.1, abs=0.01)
    assert far == pytest.approx(1.0, abs=0.01)
    assert float(after.tracks.existence[0]) == pytest.approx(0.8)
