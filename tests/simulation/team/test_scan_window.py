"""Teams without ids over a radio that loses messages: no scan counts twice, and what robots believe is honest."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scans import scan_of
from helpers.teams import known_measurements
from helpers.worlds_of_detections import HALL

from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.evaluation.gospa import pairs
from foveate.evaluation.metrics import chi_square_band, nees
from foveate.models.detections import filter as pmb
from foveate.planning.named import heuristic_in
from foveate.scenario.detections import BirthSettings, DetectionSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, TRUE
from foveate.simulation.rollout import rollout
from foveate.simulation.scans import begin
from foveate.simulation.suites import own_suite

M, K = 3, 4
SCENES = replace(HALL.scenes, steps=K)


@functools.lru_cache
def play(radio):
    scenario = replace(HALL, scenes=SCENES, team=TeamSettings(agents=M, radio=radio))
    problem, policy = scenario.problem(), heuristic_in(scenario, "uncertain")

    def run(key):
        episode = training_episode(problem, SCENES, key, noise=True)
        return episode, rollout(problem, policy, episode, TRUE, key)

    return problem, *jax.tree.map(np.asarray, jax.jit(run)(jax.random.key(1)))


@pytest.mark.slow
def test_a_lossy_radio_without_losses_is_a_perfect_one():
    """Robots take the scans of a step in the same order, so that all is equal but for rounding."""
    perfect, lossy = play(RadioSettings())[2], play(RadioSettings(range_m=1e6, memory_steps=2))[2]
    assert perfect.existence[-1].max() > 0.5
    for name in ("mean", "confirmed", "expected_number"):
        np.testing.assert_allclose(getattr(lossy.team, name), getattr(perfect.team, name), atol=1e-10)
    np.testing.assert_allclose(lossy.pose, perfect.pose, atol=1e-10)


@pytest.mark.slow
def test_lost_and_late_scans_are_those_of_a_filter_of_what_was_heard():
    """By gossip in numpy each robot knows some scans; a single robot's filter takes them by step and source."""
    radio = RadioSettings(loss=0.4, delay_steps=1, memory_steps=K)
    problem, episode, trace = play(radio)
    known = known_measurements(trace, radio.delay_steps)
    assert 0 < trace.team.heard.sum() < K * M * (M - 1)
    assert any(0 < len(own) < K * M for own in known[-1])
    model, nothing = problem.detections, jnp.zeros((problem.detections.tracks, problem.motion.input_size))
    predict = jax.jit(lambda population: pmb.predict(problem, model, population, nothing))
    update = jax.jit(lambda *rest: pmb.update(problem, model, *rest))
    for m in range(M):
        population = begin(problem, jax.tree.map(jnp.asarray, episode))
        for k in range(K):
            population = predict(population)
            for source in sorted(source for step, source in known[-1][m] if step == k):
                pose = trace.team.pose[k + 1, source]
                population = update(population, jnp.asarray(pose), scan_of(problem, episode, pose, k, source))
        np.testing.assert_allclose(trace.team.mean[-1, m], population.tracks.mean, atol=1e-8)
        np.testing.assert_allclose(trace.team.expected_number[-1, m], population.expected_number, atol=1e-9)


@pytest.fixture(scope="module")
def hundreds():
    """270 episodes of three robots that hear each other within 9 m, half of the time."""
    births = (BirthSettings(rate=0.1, low_m=(-9.0, -9.0), high_m=(9.0, 9.0)),)
    detections = DetectionSettings(
        low_m=(-12.0, -12.0), high_m=(12.0, 12.0), cells=(16, 16), probability=0.8, clutter=0.3, survival=0.98,
        known=False, births=births, tracks=14, detections=8,
    )  # fmt: skip
    scenes = replace(HALL.scenes, half_side_m=(9.0, 9.0), steps=20)
    radio = RadioSettings(range_m=9.0, loss=0.5, memory_steps=3)
    scenario = replace(HALL, detections=detections, scenes=scenes, team=TeamSettings(agents=3, radio=radio))
    problem = scenario.problem()
    suite = prepare(problem, scenario.scenes, own_suite(scenario.scenes, problem), episodes=3)
    return suite, evaluate_traces(suite, heuristic_in(scenario, "random"), PROTOCOLS["true"])


@pytest.mark.exhaustive
@pytest.mark.slow
def test_every_robot_expects_the_right_number_of_targets(hundreds):
    """Within three standard errors of the real number, the mean over robots, and of what one filter of all expects.

    After ten steps targets begin to leave the grid, which every filter here knows too late.
    """
    suite, trace = hundreds
    own, central = trace.team.expected_number.mean(axis=-1), (trace.existence.sum(axis=-1) + trace.undetected)[:, 1:]
    real = np.asarray(suite.episodes.scans.alive).sum(axis=-1)[:, 1:]
    for error in ((own - real)[:, :10], own - central):
        assert (np.abs(error.mean(axis=0)) <= 3 * error.std(axis=0, ddof=1) / np.sqrt(len(error))).all()
    assert np.abs(own - central).mean() > 0.1


@pytest.mark.exhaustive
@pytest.mark.slow
def test_confirmed_tracks_of_robots_are_not_surer_than_right(hundreds):
    """NEES of four numbers, each track against the target that GOSPA pairs with it: 4 is right, less is too careful.

    Where two targets have crossed, a track may be of the other one: NEES above 25, by chance 5 in 100,000.
    """
    suite, trace = hundreds
    truth, alive = np.asarray(suite.truth.state)[:, 1:], np.asarray(suite.episodes.scans.alive)[:, 1:]
    found = []
    for i, k, m in np.ndindex(len(truth), truth.shape[1], 3):
        if k not in (9, 19):
            continue
        tracks, targets = np.flatnonzero(trace.team.confirmed[i, k, m]), np.flatnonzero(alive[i, k])
        mean, state = trace.team.mean[i, k, m, tracks].astype(float), truth[i, k, targets]
        rows, columns = pairs(mean[:, :2], state[:, :2], 3.0)
        found += list(nees(mean[rows] - state[columns], trace.team.information[i, k, m, tracks[rows]].astype(float)))
    found = np.array(found)
    assert len(found) > 200
    assert np.mean(found > 25) < 0.03
    assert 2.0 < found[found <= 25].mean() < chi_square_band(4, len(found))[1]
