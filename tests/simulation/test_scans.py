"""Scans without ids and their filter: Kalman's where ids do not matter, honest numbers where they do."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.worlds_of_detections import HALL

from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.planning.named import heuristic_policy
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.field_of_view import BallView
from foveate.scenario.scenes import Scene
from foveate.simulation.records import PROTOCOLS, TRUE
from foveate.simulation.step import instants, stages
from foveate.simulation.suites import own_suite, scene_episodes

BALL = BallView(radius_m=1000.0, center_m=(0.0, 0.0))


def traces(scenario, scenes, method="uncertain", episodes=1):
    suite = prepare(scenario.problem(), scenario.scenes, scenes, episodes=episodes)
    policy = heuristic_policy(method, suite.problem, 8.0)
    return suite, evaluate_traces(suite, policy, PROTOCOLS["true"])


def test_known_targets_always_seen_are_those_with_ids():
    """p_D = 1, no clutter, targets far apart in a view of everything: belief and way are those of the Kalman filter."""
    box = {"low_m": (-50.0, -50.0), "high_m": (50.0, 50.0), "cells": (4, 4)}
    certain = DetectionSettings(**box, probability=1.0, tracks=5, detections=4, cutoff_m=4.0)
    plain = replace(HALL, view=BALL, detections=None)
    targets = ((-40.0, -40.0), (0.0, 40.0), (40.0, -10.0))
    scenes = [Scene(id="far", agent=(0.0, 0.0, 0.0), targets=targets, drift=((0.1, 0.0),) * 3, horizon=12)]
    _, mine = traces(replace(plain, detections=certain), scenes)
    _, theirs = traces(plain, scenes)
    np.testing.assert_allclose(mine.pose, theirs.pose, atol=1e-6)
    np.testing.assert_allclose(mine.mean[:, :, :3], theirs.mean, atol=1e-6)
    np.testing.assert_allclose(mine.information[:, :, :3], theirs.information, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(mine.visible, theirs.visible)
    np.testing.assert_allclose(mine.existence[:, :, :3], 1.0, atol=1e-9)
    np.testing.assert_array_equal(mine.present[:, :, :3], True)
    assert not mine.present[:, :, 3:].any()
    assert (mine.dropped == 0).all()


@pytest.fixture(scope="module")
def hall():
    suite, trace = traces(HALL, own_suite(HALL.scenes, HALL.problem()), "random", episodes=4)
    return suite, trace


def test_the_number_of_targets_is_honest(hall):
    """Expected less real number is 0 in the mean over 360 episodes, within four standard errors, at every step."""
    suite, trace = hall
    error = trace.existence.sum(axis=-1) + trace.undetected - np.asarray(suite.episodes.scans.alive).sum(axis=-1)
    assert (np.abs(error.mean(axis=0)) <= 4 * error.std(axis=0, ddof=1) / np.sqrt(len(error))).all()
    assert trace.existence[:, -1].sum(axis=-1).mean() > 0.5


def test_detections_are_of_live_targets_in_view_with_their_probability(hall):
    suite, trace = hall
    alive, state = np.asarray(suite.episodes.scans.alive)[:, 1:], np.asarray(suite.truth.state)[:, 1:, :, :2]
    pose = trace.pose[:, 1:, None]
    away = state - pose[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - pose[..., 2]
    bearing = np.abs((bearing + np.pi) % (2 * np.pi) - np.pi)
    in_view = alive & (np.hypot(away[..., 0], away[..., 1]) < 8.0) & (bearing < np.pi / 3)
    assert not (trace.visible & ~in_view).any()
    share = trace.visible[in_view].mean()
    assert abs(share - 0.8) < 4 * np.sqrt(0.8 * 0.2 / in_view.sum())


@pytest.mark.slow
def test_what_has_no_room_is_counted():
    crowded = replace(HALL, view=BALL, detections=replace(HALL.detections, clutter=0.0, detections=1, cutoff_m=4.0))
    scenes = own_suite(HALL.scenes, crowded.problem())[-1:]
    suite, trace = traces(crowded, scenes)
    detected = np.asarray(suite.episodes.scans.alive)[0, 1:] & (np.asarray(suite.episodes.scans.detection)[0] < 0.8)
    lost = np.cumsum(np.maximum(detected.sum(axis=-1) - 1, 0))
    np.testing.assert_array_equal(trace.dropped[0], lost)
    np.testing.assert_array_equal(trace.visible[0].sum(axis=-1), np.minimum(detected.sum(axis=-1), 1))


def test_a_scenario_with_ids_has_no_stage_of_these():
    plain = replace(HALL, detections=None)
    problem = plain.problem()
    episodes = scene_episodes(problem, plain.scenes, own_suite(plain.scenes, problem)[:1], 0, 1)
    names = [stage.__name__ for stage in stages(problem, TRUE, instants(episodes))]
    assert names == ["move", "expect_noise", "sense", "correct_means", "weigh_measured", "update_information"]
    problem = HALL.problem()
    episodes = scene_episodes(problem, HALL.scenes, own_suite(HALL.scenes, problem)[:1], 0, 1)
    assert [stage.__name__ for stage in stages(problem, TRUE, instants(episodes))] == [
        "move",
        "scan",
        "update_population",
    ]
