"""Detections at the border of the view, behind walls and beyond the grid, against sums over fine positions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.models.detections import filter as pmb
from foveate.models.detections.records import Scan, Tracks
from foveate.models.detections.visibility import cell_detection
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import SensorSettings

OPEN = Scenario(view=SectorView(depth_m=5.0, angle_deg=360.0), sensor=SensorSettings(std_m=0.3))
WALLED = Scenario(view=OPEN.view, sensor=OPEN.sensor, obstacles=ShapeObstacles(boxes=((2.0, -6.0, 2.3, 6.0),)))
BOX = {"low_m": (-9.0, -9.0), "high_m": (9.0, 9.0), "cells": (18, 18), "tracks": 3, "detections": 2}


def existence(scenario: Scenario, at: tuple[float, float], pose=(0.0, 0.0, 0.0), tracks=None, **settings) -> np.ndarray:
    """Of the tracks after one detection."""
    problem = scenario.problem()
    model = DetectionSettings(**BOX, **settings).model(problem)
    scan = Scan(jnp.array([at, at]), jnp.array([True, False]))

    @jax.jit
    def after(pose):
        return pmb.update(problem, model, pmb.start(problem, model, pose, tracks), pose, scan).tracks.existence

    return np.asarray(after(jnp.asarray(pose)))


@pytest.mark.parametrize(("x", "z", "less"), [(3.0, 3.5, 0.0), (4.5, 4.4, 0.0), (4.5, 5.3, 0.1), (4.8, 5.6, 0.35)])
def test_a_detection_is_of_a_known_target_by_bayes_and_beyond_the_border_with_caution(x, z, less):
    """A position known to 0.1 m, existence 0.9, one false alarm expected in the view."""
    axis = np.linspace(-0.6, 0.6, 401)
    points = np.stack(np.meshgrid(x + axis, axis, indexing="ij"), axis=-1)
    prior = np.exp(-0.5 * ((points - [x, 0.0]) ** 2).sum(axis=-1) / 0.01)
    prior /= prior.sum()
    chance = np.where(np.linalg.norm(points, axis=-1) <= 5.0, 0.9, 0.0)
    likelihood = np.exp(-0.5 * ((points - [z, 0.0]) ** 2).sum(axis=-1) / 0.09) / (2 * np.pi * 0.09)
    clutter, there = 1.0 / (np.pi * 25.0), 0.9
    claim, overlooked = there * (prior * chance * likelihood).sum(), there * (prior * (1 - chance)).sum()
    exact = 1.0 - clutter * (1 - there) / (claim + clutter * (overlooked + 1 - there))
    track = Tracks(jnp.array([there]), jnp.array([[x, 0.0]]), 0.01 * jnp.eye(2)[None], jnp.zeros(1, int))
    found = existence(OPEN, (z, 0.0), tracks=track, clutter=1.0, probability=0.9)
    assert exact - less - 0.02 < found[0] < exact + 0.02


def test_a_false_alarm_behind_a_wall_begins_no_track():
    """No look could end it. One that noise has put just into the wall is of a target before it."""
    settings = {"clutter": 0.2, "undetected": 3.0}
    behind, into, front = (existence(WALLED, at, **settings).max() for at in ((3.5, 0.0), (2.15, 0.0), (1.0, 0.0)))
    assert behind == 0.0
    assert front > 0.1
    assert into == pytest.approx(front, rel=0.2)
    assert existence(OPEN, (3.5, 0.0), **settings).max() == pytest.approx(front, rel=0.05)


def test_beyond_the_grid_only_what_cannot_be_a_false_alarm_begins_a_track():
    far = {"at": (41.0, 0.0), "pose": (40.0, 0.0, 0.0), "undetected": 3.0}
    assert existence(OPEN, clutter=1.0, **far).max() < 1e-9
    assert existence(OPEN, clutter=0.0, **far).max() == pytest.approx(1.0)


def test_cells_are_seen_by_their_share_in_the_view():
    problem = OPEN.problem()
    model = DetectionSettings(**BOX, probability=0.8).model(problem)
    found = np.asarray(jax.jit(lambda pose: cell_detection(problem, model, pose))(jnp.zeros(3)))
    assert found[9, 9] == pytest.approx(0.8)
    assert found[0, 0] == 0.0
    assert found.sum() == pytest.approx(0.8 * np.pi * 25.0, rel=0.02)
