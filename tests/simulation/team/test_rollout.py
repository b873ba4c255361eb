"""Robots of a team against Kalman filters in numpy, each given the measurements that its robot has heard."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.teams import kalman, known_measurements, measurement
from scipy.stats import chi2

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
from foveate.simulation.records import SURROGATE, TRUE, Arrivals
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


STEPS, JUMP = 14, 3
GATED = TRUE._replace(gate=float(chi2.ppf(0.9999, 2)))


@functools.lru_cache
def play_a_jump(radio):
    """Robots that see all around: target 0 jumps away, target 1 is away for some steps and begins again."""
    scenes = replace(SCENARIO.scenes, steps=STEPS)
    view = SectorView(depth_m=20.0, angle_deg=360.0)
    scenario = team_of(radio, sensor=PLAIN, scenes=scenes, view=view)
    problem = scenario.problem()
    policy = heuristic_policy("still", problem, 6.0)

    def run(key):
        episode = training_episode(problem, scenario.scenes, key, noise=True)
        state = episode.truth.state.at[JUMP:, 0, :2].add(8.0)
        present = jnp.ones((STEPS + 1, N), bool).at[4:7, 1].set(False)
        mean = state + jax.random.normal(jax.random.fold_in(key, 1), state.shape)
        episode = replace(
            episode, truth=replace(episode.truth, state=state), arrivals=Arrivals(present, mean), present=present[0]
        )
        return episode, rollout(problem, policy, episode, GATED, key)

    return problem, *jax.tree.map(np.asarray, jax.jit(run)(jax.random.key(2)))


def gated_filters(problem, episode, trace):
    """Means, covariances (K, M, N, ..) and restarts of robots that gate their own measurements, in plain numpy."""
    A, W, H = (np.asarray(x) for x in (problem.motion.A, problem.motion.W, problem.sensor.H))
    prior = np.linalg.inv(problem.prior_information)
    events, known, rejections, found, restarts = {}, [set() for _ in range(M)], np.zeros((M, N), int), [], []

    def believed(measured, last, target):
        """The filter of the events (step, source) up to a step: (mean, P)."""
        mean, P = episode.mean[target], prior
        for k in range(last + 1):
            mean, P = A @ mean, A @ P @ A.T + W
            if episode.arrivals.present[k + 1, target] and not episode.arrivals.present[k, target]:
                mean, P = episode.arrivals.mean[k + 1, target], prior
            mine = [events[k, m, target] for m in range(M) if (k, m) in measured and (k, m, target) in events]
            mean, P = next((begun for kind, begun in mine if kind == "restart"), (mean, P))
            for z, V in [given for kind, given in mine if kind == "measured"]:
                gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
                mean, P = mean + gain @ (z - H @ mean), P - gain @ H @ P
        return mean, P

    for k in range(STEPS):
        for target in range(N):
            for m in range(M):
                if not episode.arrivals.present[k : k + 2, target].all():
                    rejections[m, target] *= not episode.arrivals.present[k + 1, target]
                    continue
                mean, P = believed(known[m], k - 1, target)
                mean, P = A @ mean, A @ P @ A.T + W
                z, V = measurement(problem, episode, trace, k, m, target)
                error = z - H @ mean
                if error @ np.linalg.solve(H @ P @ H.T + V, error) <= GATED.gate:
                    events[k, m, target], rejections[m, target] = ("measured", (z, V)), 0
                elif rejections[m, target] == 4:
                    velocity = np.diag([0.0, 0.0, 1.0, 1.0])
                    fresh = np.concatenate([z, [0.0, 0.0]]), H.T @ V @ H + velocity @ prior @ velocity
                    events[k, m, target], rejections[m, target] = ("restart", fresh), 0
                    restarts.append((k, m, target))
                else:
                    rejections[m, target] += 1
        known = [own | {(k, m)} for m, own in enumerate(known)]
        known = [known[i].union(*(known[j] for j in range(M) if trace.team.heard[k, i, j])) for i in range(M)]
        found.append([[believed(known[m], k, target) for target in range(N)] for m in range(M)])
        np.testing.assert_array_equal(trace.team.rejections[k], rejections)
    return found, restarts


@pytest.mark.parametrize("name", ["always", "lossy", "never"])
def test_targets_that_appear_and_beliefs_that_restart_are_told(name):
    radio = replace(RADIOS[name], range_m=20.0, memory_steps=STEPS) if name == "lossy" else RADIOS[name]
    problem, episode, trace = play_a_jump(radio)
    found, restarts = gated_filters(problem, episode, trace)
    assert {target for _, _, target in restarts} == {0}
    np.testing.assert_array_equal(trace.present, episode.arrivals.present)
    for k, m, target in np.ndindex(STEPS, M, N):
        if not episode.arrivals.present[k + 1, target]:
            continue
        mean, P = found[k][m][target]
        error = mean - episode.truth.state[k + 1, target]
        np.testing.assert_allclose(trace.team.log_det[k, m, target], -np.linalg.slogdet(P)[1], atol=1e-8)
        np.testing.assert_allclose(
            trace.team.nees[k, m, target], error @ np.linalg.solve(P, error), rtol=1e-6, atol=1e-6
        )
    np.testing.assert_allclose(trace.information[7, 1], problem.prior_information)
    np.testing.assert_allclose(trace.mean[7, 1], episode.arrivals.mean[7, 1])


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
