"""Teams whose detections have no ids: the filters of single robots, fed the scans that each robot hears."""

import functools
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scans import scan_of
from helpers.teams import kalman
from helpers.worlds_of_detections import HALL

from foveate.evaluation.evaluate import evaluate, evaluate_traces, prepare
from foveate.evaluation.gospa import mean_gospa
from foveate.models.detections import filter as pmb
from foveate.planning.named import heuristic_in
from foveate.plotting.track_data import intensities
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.detections import BirthSettings, DetectionSettings
from foveate.scenario.field_of_view import BallView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenes import Scene
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, TRUE, Truth
from foveate.simulation.rollout import rollout
from foveate.simulation.scans import begin
from foveate.simulation.step import instants, stages
from foveate.simulation.suites import own_suite, scene_episodes
from foveate.simulation.team.rollout import without_room
from foveate.simulation.team.step import start

M, K = 3, 6
SILENT = RadioSettings(loss=1.0)
SCENES = replace(HALL.scenes, steps=K)
OTHER = RobotSettings(agent=DifferentialDrive(v_max_m_s=3.0), sensor=SensorSettings(std_m=0.4))
TEAM = replace(HALL, scenes=SCENES, team=TeamSettings(agents=M, robots=(RobotSettings(), OTHER)))
ALIKE = replace(HALL, scenes=SCENES, team=TeamSettings(agents=M))


def silent(scenario):
    return replace(scenario, team=replace(scenario.team, radio=SILENT))


@functools.lru_cache
def play(scenario, method="uncertain", seed=1):
    problem, policy = scenario.problem(), heuristic_in(scenario, method)

    def run(key):
        episode = training_episode(problem, scenario.scenes, key, noise=True)
        return episode, rollout(problem, policy, episode, TRUE, key)

    return problem, *jax.tree.map(np.asarray, jax.jit(run)(jax.random.key(seed)))


def test_robots_that_hear_each_other_are_one_filter_of_their_scans_in_turn():
    """Robots of two kinds; numpy makes the scans, the filter of a single robot takes one after another."""
    problem, episode, trace = play(TEAM)
    model, nothing = problem.detections, jnp.zeros((problem.detections.tracks, problem.motion.input_size))
    predict = jax.jit(lambda population: pmb.predict(problem, model, population, nothing))
    update = jax.jit(lambda robot, *rest: pmb.update(problem.of_robot(robot), model, *rest))
    population = begin(problem, jax.tree.map(jnp.asarray, episode))
    for k in range(K):
        population = predict(population)
        for m in range(M):
            pose = trace.team.pose[k + 1, m]
            scan = scan_of(problem.of_robot(m), episode, pose, k, m)
            population = update(jnp.asarray(m), population, jnp.asarray(pose), scan)
        tracks = population.tracks
        np.testing.assert_allclose(trace.existence[k + 1], tracks.existence, atol=1e-9)
        np.testing.assert_allclose(trace.undetected[k + 1], jnp.sum(population.undetected), atol=1e-9)
        np.testing.assert_allclose(trace.mean[k + 1], tracks.mean, atol=1e-8)
        for m in range(M):
            np.testing.assert_allclose(trace.team.mean[k, m], tracks.mean, atol=1e-8)
            covariance = np.linalg.inv(trace.team.information[k, m])
            np.testing.assert_allclose(covariance, tracks.covariance, atol=1e-8)
            np.testing.assert_array_equal(trace.team.confirmed[k, m], trace.confirmed[k + 1])
    assert trace.existence[-1].max() > 0.9
    assert trace.team.visible.any(axis=(0, 2)).sum() > 1


def test_certain_detections_of_all_robots_are_those_of_a_kalman_filter():
    """p_D = 1, no clutter, targets far apart in a view of everything: the textbook filter of all measurements."""
    box = {"low_m": (-50.0, -50.0), "high_m": (50.0, 50.0), "cells": (4, 4)}
    certain = DetectionSettings(**box, probability=1.0, tracks=5, detections=4, cutoff_m=4.0)
    view = BallView(radius_m=1000.0, center_m=(0.0, 0.0))
    scenario = replace(HALL, view=view, detections=certain, team=TeamSettings(agents=2))
    problem, policy = scenario.problem(), heuristic_in(scenario, "still")
    targets = ((-40.0, -40.0), (0.0, 40.0), (40.0, -10.0))
    ways = {"agent": (0.0, 0.0, 0.0), "others": ((1.0, 0.0, 0.0),), "drift": ((0.1, 0.0),) * 3}
    episodes = scene_episodes(problem, SCENES, [Scene(id="far", targets=targets, horizon=K, **ways)], 0, 1)
    episode = jax.tree.map(lambda x: x[0], episodes)
    played = jax.jit(lambda episode: rollout(problem, policy, episode, TRUE, jax.random.key(0)))(episode)
    trace = jax.tree.map(np.asarray, played)
    everything = {(k, m) for k in range(K) for m in range(2)}
    for k, target in np.ndindex(K, 3):
        mean, P = kalman(problem, episode, trace, everything, k, target)
        np.testing.assert_allclose(trace.mean[k + 1, target], mean, atol=1e-8)
        np.testing.assert_allclose(np.linalg.inv(trace.information[k + 1, target]), P, atol=1e-8)


@pytest.mark.parametrize("method", ["uncertain", "lookahead"])
def test_without_a_radio_each_robot_is_alone(method):
    scenario = silent(ALIKE)
    _, episode, trace = play(scenario, method)
    episode, alone = jax.tree.map(jnp.asarray, episode), replace(scenario, team=None)
    single, policy = alone.problem(), heuristic_in(alone, method)
    run = jax.jit(lambda own: rollout(single, policy, own, TRUE, jax.random.key(0)))
    for m in range(M):
        own = replace(episode, team=None)
        if m > 0:
            draws = episode.team
            truth = Truth(episode.truth.state, draws.measurement_noise[:, m - 1])
            names = ("detection", "clutter_body", "is_false", "order")
            scans = {name: getattr(draws.scans, name)[:, m - 1] for name in names}
            own = replace(own, pose=draws.poses[m - 1], truth=truth, scans=replace(episode.scans, **scans))
        found = run(own)
        np.testing.assert_allclose(trace.team.pose[:, m], found.pose, atol=1e-9)
        np.testing.assert_array_equal(trace.team.visible[:, m], found.visible)
        np.testing.assert_allclose(trace.team.mean[:, m], found.mean[1:], atol=1e-8)
        np.testing.assert_array_equal(trace.team.confirmed[:, m], found.confirmed[1:])


def test_tracks_dropped_from_the_filter_of_any_robot_are_counted():
    """Three, with four from the filter of all scans and a detection; where that is every robot's filter, five."""
    for scenario, count in ((silent(ALIKE), 8), (ALIKE, 5)):
        problem = scenario.problem()
        state = start(problem, training_episode(problem, SCENES, jax.random.key(0), noise=True), TRUE)
        counters = jnp.array([0, 2, 1]), jnp.array(4), jnp.array(1)
        state = eqx.tree_at(
            lambda s: (s.robots.population.overflow, s.central.population.overflow, s.central.dropped), state, counters
        )
        assert without_room(problem, state) == count


def test_a_team_changes_no_random_number_of_the_first_robot():
    """Poses, targets, noise and scans, in training and in suites; those of the others are their own."""
    scene = Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((1.0, 1.0),), drift=((0.1, 0.0),), horizon=K)
    found = {}
    for name, own, others in (("team", ALIKE, ((1.0, 0.0, 0.0),) * 2), ("single", replace(ALIKE, team=None), ())):
        problem = own.problem()
        trained = jax.jit(lambda key, problem=problem: training_episode(problem, SCENES, key, noise=True))
        of_suite = scene_episodes(problem, SCENES, [replace(scene, others=others)], 0, 1)
        found[name] = trained(jax.random.key(3)), jax.tree.map(lambda x: x[0], of_suite)
    for team, single in zip(found["team"], found["single"], strict=True):
        jax.tree.map(np.testing.assert_array_equal, replace(team, team=None), single)
        rows = np.concatenate([team.scans.detection[:, None], team.team.scans.detection], axis=1)
        assert len(np.unique(rows)) == rows.size


def test_a_single_robot_compiles_to_the_program_without_a_team():
    def program(scenario):
        problem, policy = scenario.problem(), heuristic_in(scenario, "lookahead")

        def run(key):
            return rollout(problem, policy, training_episode(problem, SCENES, key, noise=True), TRUE, key)

        return str(jax.make_jaxpr(run)(jax.random.key(0)))

    assert program(replace(ALIKE, team=TeamSettings(agents=1))) == program(replace(ALIKE, team=None))


def test_only_robots_alone_update_by_their_own_scan():
    for scenario, names in ((ALIKE, ["move", "scan"]), (silent(ALIKE), ["move", "scan", "update_population"])):
        problem = scenario.problem()
        episode = training_episode(problem, SCENES, jax.random.key(0), noise=True)
        assert [stage.__name__ for stage in stages(problem, TRUE, instants(episode))] == names


@pytest.fixture(scope="module")
def hundreds():
    """360 episodes of a team in a world whose targets stay within the grid."""
    births = (BirthSettings(rate=0.15, low_m=(-9.0, -9.0), high_m=(9.0, 9.0)),)
    detections = DetectionSettings(
        low_m=(-12.0, -12.0), high_m=(12.0, 12.0), cells=(16, 16), probability=0.8, clutter=0.5, survival=0.97,
        known=False, births=births, tracks=20, detections=10,
    )  # fmt: skip
    scenes = replace(HALL.scenes, half_side_m=(9.0, 9.0))
    scenario = replace(HALL, detections=detections, scenes=scenes, team=TeamSettings(agents=M))
    problem = scenario.problem()
    suite = prepare(problem, scenario.scenes, own_suite(scenario.scenes, problem), episodes=4)
    return suite, evaluate_traces(suite, heuristic_in(scenario, "random"), PROTOCOLS["true"])


def test_the_number_of_targets_is_honest(hundreds):
    """Expected less real number is 0 in the mean, within three standard errors, at every step."""
    suite, trace = hundreds
    error = trace.existence.sum(axis=-1) + trace.undetected - np.asarray(suite.episodes.scans.alive).sum(axis=-1)
    assert (np.abs(error.mean(axis=0)) <= 3 * error.std(axis=0, ddof=1) / np.sqrt(len(error))).all()
    assert trace.existence[:, -1].sum(axis=-1).mean() > 0.5


def test_rows_have_the_worst_robot_and_pictures_the_undetected_targets():
    problem = silent(ALIKE).problem()
    suite = prepare(problem, SCENES, own_suite(SCENES, problem)[:2])
    policy = heuristic_in(silent(ALIKE), "still")
    rows = evaluate(suite, "still", policy, ["true"])
    trace = evaluate_traces(suite, policy, TRUE)
    own, cutoff_m = trace.team, float(problem.detections.cutoff)
    for i, row in enumerate(rows):
        real = np.asarray(suite.truth.state[i])[1:, :, :2], np.asarray(suite.episodes.scans.alive[i])[1:]
        robots = [mean_gospa(own.mean[i, :, m, :, :2], own.confirmed[i, :, m], *real, cutoff_m) for m in range(M)]
        assert row.agents == M
        np.testing.assert_allclose(row.worst_score, -max(found.gospa for found in robots), rtol=1e-9)
    first = jax.tree.map(lambda x: x[0], (suite.episodes, trace))
    found = intensities(problem, *first)
    np.testing.assert_allclose(found.sum(axis=(1, 2)), trace.undetected[0], rtol=1e-5)
