"""Robots of a team against Kalman filters in numpy, each given the measurements that its robot has heard."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.errors import InputError
from foveate.evaluation.metrics import chi_square_band
from foveate.planning.named import heuristic_policy
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import VelocityTarget
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import SURROGATE, TRUE
from foveate.simulation.rollout import log_dets, rollout

M, K, N = 3, 8, 2
SCENARIO = Scenario(
    tau_s=0.5,
    view=SectorView(depth_m=6.0, angle_deg=120.0),
    sensor=SensorSettings(std_m=0.3, range_growth_per_m=0.2, frame="body"),
    target=VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.1, initial_velocity_variance_m2_s2=0.2),
    scenes=SceneSettings(
        targets_min=N, targets_max=N, half_side_m=(5.0, 5.0), half_side_per_target_m=0.0, drift_m_s=(0.3, 0.3),
        steps=K, initial_error="consistent",
    ),
)  # fmt: skip


PLAIN = replace(SCENARIO.sensor, range_growth_per_m=0.0, frame="world")


def team_of(radio, **changes):
    return replace(SCENARIO, team=TeamSettings(agents=M, radio=radio), **changes)


@functools.lru_cache
def play(scenario, protocol=TRUE, seed=0):
    problem = scenario.problem()
    policy = heuristic_policy("nearest", problem, 6.0)

    def run(key):
        episode = training_episode(problem, scenario.scenes, key, noise=True)
        return episode, rollout(problem, policy, episode, protocol, key)

    episode, trace = jax.jit(run)(jax.random.key(seed))
    return problem, *jax.tree.map(np.asarray, (episode, trace))


def known_measurements(trace, delay):
    """Sets of (step, source) that each robot has heard of after each step, by gossip."""
    known, sent, after = [set() for _ in range(M)], [], []
    for k in range(K):
        known = [own | {(k, m)} for m, own in enumerate(known)]
        nobody = np.zeros((M, M), bool), known
        heard, senders = (trace.team.heard[k], known) if delay == 0 else sent[k - delay] if k >= delay else nobody
        known = [known[i].union(*(senders[j] for j in range(M) if heard[i, j])) for i in range(M)]
        sent.append((trace.team.heard[k], list(known)))
        after.append(list(known))
    return after


def kalman(problem, episode, trace, measured, last, target):
    """Textbook filter of one target, of the measurements (step, source) up to a step: mean and covariance."""
    A, W, H = (np.asarray(x) for x in (problem.motion.A, problem.motion.W, problem.sensor.H))
    mean, P = np.asarray(episode.mean[target]), np.linalg.inv(problem.prior_information)
    for k in range(last + 1):
        mean, P = A @ mean, A @ P @ A.T + W
        for m in sorted(source for step, source in measured if step == k):
            if not trace.team.visible[k, m, target]:
                continue
            z, V = measurement(problem, episode, trace, k, m, target)
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
            mean, P = mean + gain @ (z - H @ mean), P - gain @ H @ P
    return mean, P


def measurement(problem, episode, trace, k, m, target):
    """What robot m measures in step k, and its covariance."""
    state = episode.truth.state[k + 1, target]
    own = episode.truth.measurement_noise[k, target] if m == 0 else episode.team.measurement_noise[k, m - 1, target]
    V = np.asarray(problem.sensor.V)
    return problem.sensor.H @ state + np.linalg.cholesky(V) @ own, V


SILENT = RadioSettings(loss=1.0)
RADIOS = {
    "always": RadioSettings(),
    "lossy": RadioSettings(range_m=6.0, loss=0.3, memory_steps=K),
    "lossy and late": RadioSettings(loss=0.6, delay_steps=1, memory_steps=K),
    "never": SILENT,
}


@pytest.mark.parametrize("name", RADIOS)
def test_every_robot_is_the_kalman_filter_of_what_it_has_heard(name):
    radio = RADIOS[name]
    problem, episode, trace = play(team_of(radio, sensor=PLAIN))
    assert trace.team.visible.sum() > 5
    known = known_measurements(trace, radio.delay_steps)
    everything = {(k, m) for k in range(K) for m in range(M)}
    for k in range(K):
        for target in range(N):
            mean, P = kalman(problem, episode, trace, everything, k, target)
            np.testing.assert_allclose(trace.mean[k + 1, target], mean, atol=1e-8)
            np.testing.assert_allclose(trace.log_det[k, target], -np.linalg.slogdet(P)[1], atol=1e-8)
            for m in range(M):
                mean, P = kalman(problem, episode, trace, known[k][m], k, target)
                error = mean - episode.truth.state[k + 1, target]
                np.testing.assert_allclose(trace.team.log_det[k, m, target], -np.linalg.slogdet(P)[1], atol=1e-8)
                np.testing.assert_allclose(trace.team.nees[k, m, target], error @ np.linalg.solve(P, error), atol=1e-6)


def test_who_is_heard_follows_range_and_loss():
    _, episode, trace = play(team_of(RADIOS["lossy"], sensor=PLAIN))
    position = trace.team.pose[1:, :, :2]
    distance = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    expected = (distance <= 6.0) & (episode.team.radio >= 0.3) & ~np.eye(M, dtype=bool)
    np.testing.assert_array_equal(trace.team.heard, expected)
    assert 0 < expected.sum() < K * M * (M - 1)


def test_without_a_radio_each_robot_is_alone():
    """Robot 1 of a silent team sees and believes what it would as a single robot with its start and its noise."""
    problem, episode, trace = play(team_of(SILENT, sensor=PLAIN))
    episode, alone = jax.tree.map(jnp.asarray, episode), replace(problem, team=None)
    truth = replace(episode.truth, measurement_noise=episode.team.measurement_noise[:, 0])
    own = replace(episode, pose=episode.team.poses[0], truth=truth, team=None)
    single = jax.jit(lambda own, key: rollout(alone, heuristic_policy("nearest", alone, 6.0), own, TRUE, key))(
        own, jax.random.key(0)
    )
    np.testing.assert_array_equal(trace.team.visible[:, 1], single.visible)
    np.testing.assert_allclose(trace.team.log_det[:, 1], single.log_det, atol=1e-12)
    np.testing.assert_allclose(trace.team.pose[:, 1], single.pose, atol=1e-12)


def test_a_single_robot_compiles_to_the_program_without_a_team():
    def program(scenario):
        problem = scenario.problem()
        policy = heuristic_policy("nearest", problem, 6.0)

        def run(key):
            episode = training_episode(problem, scenario.scenes, key, noise=True)
            return rollout(problem, policy, episode, TRUE, key)

        return str(jax.make_jaxpr(run)(jax.random.key(0)))

    assert program(replace(SCENARIO, team=TeamSettings(agents=1))) == program(SCENARIO)


def test_robots_keep_off_each_other():
    """Two robots that start beside each other do not come nearer than they keep off."""
    scenes = replace(SCENARIO.scenes, agent_half_side_m=(1.5, 1.5), agent_centre_m=(0.0, 0.0))
    for keep_off, least in ((1.0, 0.0), (None, None)):
        _, _, trace = play(team_of(RadioSettings(), scenes=scenes, keep_off_m=keep_off), seed=3)
        position = trace.team.pose[:, :, :2]
        distance = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)[:, *np.triu_indices(M, 1)]
        approached = np.minimum.accumulate(distance)[1:].min() < min(1.0, distance[0].min()) - 0.2
        assert approached == (least is None)


def test_soft_views_add_up():
    """Under the paper's protocol every robot gives its share of a measurement: more robots, more information."""
    _, _, trace = play(team_of(RadioSettings()), SURROGATE)
    _, _, silent = play(team_of(SILENT), SURROGATE)
    np.testing.assert_allclose(trace.team.log_det, np.repeat(trace.log_det[:, None], M, axis=1), atol=1e-9)
    assert np.all(silent.log_det[:, None] >= silent.team.log_det - 1e-9)


def test_what_a_team_lacks_is_rejected():
    scenario = team_of(RadioSettings())
    problem = scenario.problem()
    policy, key = heuristic_policy("nearest", problem, 6.0), jax.random.key(0)
    episode = training_episode(problem, scenario.scenes, key, noise=True)
    with pytest.raises(InputError, match="noise = False"):
        rollout(problem, policy, replace(episode, truth=None), TRUE, key)
    with pytest.raises(InputError, match=r"scenario\.team"):
        log_dets(problem, policy, episode, TRUE, key)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_fused_beliefs_are_never_overconfident():
    """NEES of 1,000 episodes where messages are lost and late, and older than the memory: 4 is right, 0 too careful."""
    radio = RadioSettings(range_m=6.0, loss=0.6, delay_steps=1, memory_steps=2)
    scenario = team_of(radio, sensor=PLAIN, scenes=replace(SCENARIO.scenes, steps=20))
    problem = scenario.problem()
    policy = heuristic_policy("nearest", problem, 6.0)

    def run(key):
        return rollout(
            problem, policy, training_episode(problem, scenario.scenes, key, noise=True), TRUE, key
        ).team.nees

    nees = np.asarray(jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(5), 1000)))
    # Robots that have heard each other share their errors: a target of an episode counts as one.
    _, high = chi_square_band(4, 1000 * N)
    assert nees[:, -1].mean() < high + 0.1
    assert nees.mean() < high
    assert nees[:, -1].mean() > 2.0
