"""Distributions of scenes and noise by statistical tests at fixed seeds, and invariance of the numbers."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.distributions import uniform
from helpers.episodes import training_episode
from scipy.stats import chisquare, kstest

from foveate.experiment.presets import QUADROTOR
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import AccelerationTarget, DriftTarget, LinearTarget, VelocityTarget
from foveate.simulation.environment import Environment, reset
from foveate.simulation.episodes import Drawn, Noise, draw, draw_noise, draw_size, episode_of
from foveate.simulation.records import TRUE
from foveate.simulation.suites import own_suite, scene_episodes, scene_noise

PAPER = Scenario()
COUNT = 3000
W = np.array([[0.09, 0.03], [0.03, 0.04]])
V = np.array([[0.05, -0.02], [-0.02, 0.03]])
JERK = Scenario(target=AccelerationTarget(kind="constant_acceleration", jerk_m2_s5=0.02))
TWO_EQUAL_AXES = Scenario(
    target=LinearTarget(
        A=((1.0, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        B=((0.0,), (0.0,), (0.0,), (0.0,)),
        W=((0.1, 0.0, 0.05, 0.0), (0.0, 0.1, 0.0, 0.05), (0.05, 0.0, 0.1, 0.0), (0.0, 0.05, 0.0, 0.1)),
        Z=((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)),
        prior=((4.0, 0.0, 1.0, 0.0), (0.0, 4.0, 0.0, 1.0), (1.0, 0.0, 4.0, 0.0), (0.0, 1.0, 0.0, 4.0)),
    )
)


def drawn(settings, test=False, scenario=PAPER):
    """Many scenes, as numpy arrays."""
    problem = scenario.problem()
    uniform = jax.random.uniform(jax.random.key(5), (COUNT, draw_size(settings, problem)), minval=-1.0)
    scenes = jax.jit(jax.vmap(lambda numbers: draw(settings, problem, numbers, test)))(uniform)
    return jax.tree.map(np.asarray, scenes)


@pytest.mark.parametrize("test", [False, True], ids=["training", "test"])
def test_scenes_of_the_paper(test):
    scenes = drawn(SceneSettings(), test)
    n = scenes.present.sum(axis=1)
    assert chisquare(np.bincount(n, minlength=9)[3:9]).pvalue > 1e-3
    assert n.min() == 3
    assert n.max() == 8
    assert (np.diff(scenes.present.astype(int), axis=1) <= 0).all(), "the real targets come first"
    np.testing.assert_array_equal(scenes.horizon, 3 * n)
    side = 2.0 * n[:, None]
    assert uniform((scenes.position / side[:, None])[scenes.present], -1, 1)
    assert uniform(scenes.pose[:, 2], -np.pi, np.pi)
    agent = scenes.pose[:, :2]
    assert uniform(agent, -2, 2) if test else uniform(agent / (1.25 * side), -1, 1)
    assert uniform(scenes.drift[:, 0], -0.8, 0.8)
    np.testing.assert_array_equal(scenes.drift, scenes.drift[:, :1] * np.ones((1, 8, 1)))
    for axis in range(2):  # all are independent
        several = [scenes.pose[:, axis], scenes.position[:, 0, axis] / side[:, 0], scenes.drift[:, 0, axis], n]
        correlation = np.corrcoef([*several, scenes.position[:, 1, 0] / side[:, 0], scenes.pose[:, 2]])
        assert np.abs(correlation - np.eye(6)).max() < 0.08


def test_scenes_of_other_settings():
    settings = SceneSettings(
        targets_min=2,
        targets_max=4,
        centre_m=(10.0, -5.0),
        half_side_m=(3.0, 1.0),
        half_side_per_target_m=0.5,
        drift_m_s=(0.3, 0.3),
        shared_drift=False,
        steps=17,
    )
    scenes = drawn(settings)
    n = scenes.present.sum(axis=1)
    side = np.array([3.0, 1.0]) + 0.5 * n[:, None]
    centred = (scenes.position - settings.centre_m) / side[:, None]
    for axis in range(2):
        assert uniform(centred[..., axis], -1, 1)
        assert uniform((scenes.pose[:, axis] - settings.centre_m[axis]) / (1.25 * side[:, axis]), -1, 1)
    assert (scenes.horizon == 17).all()
    assert uniform(scenes.drift, -0.3, 0.3)
    assert abs(np.corrcoef(scenes.drift[:, 0, 0], scenes.drift[:, 1, 0])[0, 1]) < 0.08


@pytest.mark.parametrize("test", [False, True], ids=["training", "test"])
def test_targets_on_a_ring_about_an_agent_with_a_box_of_its_own(test):
    settings = SceneSettings(target_ring_m=(5.0, 10.0), agent_centre_m=(30.0, -4.0), agent_half_side_m=(3.0, 0.5))
    scenes = drawn(settings, test)
    agent = scenes.pose[:, :2] - settings.agent_centre_m
    assert uniform(agent[:, 0], -3, 3)
    assert uniform(agent[:, 1], -0.5, 0.5)
    offset = scenes.position - scenes.pose[:, None, :2]
    radius, angle = np.linalg.norm(offset, axis=-1), np.arctan2(offset[..., 1], offset[..., 0])
    assert uniform(radius.clip(5, 10), 5, 10)
    np.testing.assert_allclose(radius.clip(5, 10), radius, atol=1e-9)
    assert uniform(angle, -np.pi, np.pi)
    several = [*agent.T, scenes.pose[:, 2], radius[:, 0], radius[:, 1], angle[:, 0], angle[:, 1]]
    assert np.abs(np.corrcoef(several) - np.eye(7)).max() < 0.08, "all are independent"


@pytest.mark.parametrize("test", [False, True], ids=["training", "test"])
def test_an_agent_apart_from_the_targets_and_one_with_a_ring_only(test):
    """Where only one of the keys is given, the rest is as in training, also in test scenes."""
    box = {"half_side_m": (3.0, 1.0), "half_side_per_target_m": 0.0, "agent_spread": 0.5}
    apart = drawn(SceneSettings(**box, agent_centre_m=(10.0, 0.0)), test)
    ring = drawn(SceneSettings(**box, target_ring_m=(2.0, 2.0)), test)
    for axis, side in enumerate((3.0, 1.0)):
        assert uniform(apart.pose[:, axis], (10.0, 0.0)[axis] - side / 2, (10.0, 0.0)[axis] + side / 2)
        assert uniform(ring.pose[:, axis], -side / 2, side / 2)
        assert uniform(apart.position[..., axis], -side, side)
    np.testing.assert_allclose(np.linalg.norm(ring.position - ring.pose[:, None, :2], axis=-1), 2.0, rtol=1e-12)


def test_a_ring_in_space_is_horizontal():
    settings = replace(QUADROTOR.scenes, target_ring_m=(2.0, 6.0))
    scenes = drawn(settings, scenario=QUADROTOR)
    agent = scenes.pose[:, :3, 3]
    assert uniform(np.linalg.norm((scenes.position - agent[:, None])[..., :2], axis=-1).clip(2, 6), 2, 6)
    assert uniform(scenes.position[..., 2], 1.5, 4.5)
    assert uniform(agent[:, 2], 1.5, 4.5)
    assert abs(np.corrcoef(scenes.position[:, 0, 2], agent[:, 2])[0, 1]) < 0.08


def test_noise_of_training():
    """Standard normals and uniform jitter, none of them twice."""
    keys = jax.random.split(jax.random.key(2), COUNT)
    noise = jax.jit(jax.vmap(lambda key: draw_noise(PAPER.problem(), key, 4, 3)))(keys)
    parts = [np.asarray(x).reshape(COUNT, -1) for x in (noise.process, noise.measurement, noise.first)]
    assert [part.shape[1] for part in parts] == [24, 24, 6]
    normal = np.concatenate(parts, axis=1)
    assert kstest(normal.ravel(), "norm").pvalue > 1e-3
    assert uniform(noise.jitter, -1, 1)
    everything = np.concatenate([normal, np.asarray(noise.jitter).reshape(COUNT, -1)], axis=1)
    assert np.abs(np.corrcoef(everything.T) - np.eye(78)).max() < 0.1


def episodes(scenario, targets=3, steps=4):
    """Many episodes with truth, and the scenes and noise, from numpy, that they are made of."""
    problem, rng, box = scenario.problem(), np.random.default_rng(7), (COUNT, targets, 2)
    size = problem.motion.state_size
    scene = {
        "pose": rng.normal(size=(COUNT, 3)),
        "position": rng.uniform(-6, 6, box),
        "drift": rng.uniform(-0.8, 0.8, box),
        "present": np.ones((COUNT, targets), bool),
        "horizon": np.full(COUNT, steps),
    }
    noise = {
        "jitter": rng.uniform(-1, 1, (COUNT, steps, targets, 2)),
        "process": rng.normal(size=(COUNT, steps, targets, size)),
        "measurement": rng.normal(size=(COUNT, steps, targets, 2)),
        "first": rng.normal(size=(COUNT, targets, size)),
    }

    def one(scene, noise):
        return episode_of(problem, scenario.scenes, Drawn(**scene), Noise(**noise))

    made = jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(scene, noise))
    return SimpleNamespace(**scene), SimpleNamespace(**noise), made


def covariance_of(samples):
    flat = samples.reshape(-1, samples.shape[-1])
    assert np.abs(flat.mean(axis=0)).max() < 5 * flat.std() / np.sqrt(len(flat))
    return flat.T @ flat / len(flat)


FIXED = SceneSettings(targets_min=3, targets_max=3)
DRIFTING = Scenario(
    tau_s=0.5, target=DriftTarget(W=tuple(map(tuple, W))), sensor=SensorSettings(V=tuple(map(tuple, V))), scenes=FIXED
)


def test_truth_of_drifting_targets():
    scene, noise, episode = episodes(DRIFTING)
    truth = episode.truth.state
    np.testing.assert_allclose(truth[:, 0], scene.position, atol=1e-12)
    jitter = episode.inputs / 0.5 - scene.drift[:, None]
    assert uniform(jitter, -0.5, 0.5)
    assert abs(np.corrcoef(jitter[:, 0, 0, 0], jitter[:, 1, 0, 0])[0, 1]) < 0.08, "resampled at each step"
    assert abs(np.corrcoef(jitter[:, 0, 0, 0], jitter[:, 0, 1, 0])[0, 1]) < 0.08, "each target its own"
    np.testing.assert_allclose(covariance_of(truth[:, 1:] - truth[:, :-1] - episode.inputs), W, atol=2e-3)
    np.testing.assert_allclose(covariance_of(episode.mean - truth[:, 0]), V, atol=2e-3)
    np.testing.assert_array_equal(episode.truth.measurement_noise, noise.measurement)


def test_consistent_first_error_unknown_drift_and_no_process_noise():
    changes = {"initial_error": "consistent", "known_drift": False, "process_noise": False}
    scene, noise, episode = episodes(replace(DRIFTING, scenes=replace(FIXED, **changes)))
    truth = episode.truth.state
    np.testing.assert_array_equal(episode.inputs, 0)
    moved = 0.5 * (scene.drift[:, None] + 0.5 * noise.jitter)
    np.testing.assert_allclose(truth[:, 1:] - truth[:, :-1], moved, atol=1e-12)
    np.testing.assert_allclose(covariance_of(episode.mean - truth[:, 0]), 2 * np.eye(2), atol=0.15)


STD = (2.0, 0.0, 0.5)
JERKY = Scenario(target=AccelerationTarget(kind="constant_acceleration"), scenes=replace(FIXED, first_error_std=STD))


def of_a_suite():
    scenes = own_suite(JERKY.scenes, JERKY.problem())
    episode = scene_episodes(JERKY.problem(), JERKY.scenes, scenes, 1, 100)
    return episode.mean - episode.truth.state[:, 0]


def of_an_environment():
    environment = Environment(JERKY.problem(), JERKY.scenes, TRUE, noise=True)
    episode = jax.jit(jax.vmap(lambda key: reset(environment, key).episode))(jax.random.split(jax.random.key(3), COUNT))
    return episode.mean - episode.truth.state[:, 0]


@pytest.mark.parametrize("errors", [of_a_suite, of_an_environment])
def test_first_errors_have_a_deviation_for_each_block(errors):
    """In the scenes of an evaluation, and in the episodes of training and Gymnasium; P_0 claims 2, 1 and 0.25."""
    blocks = np.split(np.asarray(errors()), 3, axis=-1)
    for block, std in zip(blocks, STD, strict=True):
        if std == 0.0:
            np.testing.assert_allclose(block, 0, atol=1e-12)
        else:
            assert kstest(block.ravel() / std, "norm").pvalue > 1e-3
            assert abs(np.corrcoef(block[..., 0].ravel(), block[..., 1].ravel())[0, 1]) < 0.05


def test_targets_at_rest_that_the_belief_does_not_know_to_be_at_rest():
    """First and mean velocity are 0 to the bit, and P_0 = 30 I: also in a step without process noise."""
    target = VelocityTarget(
        kind="constant_velocity",
        acceleration_m2_s3=0.0,
        initial_variance_m2=30.0,
        initial_velocity_variance_m2_s2=30.0,
    )
    scenes = SceneSettings(drift_m_s=(0.0, 0.0), first_error_std=(2.0, 0.0), target_ring_m=(5.0, 10.0), steps=3)
    problem = Scenario(target=target, scenes=scenes).problem()
    episode = training_episode(problem, scenes, jax.random.key(0), noise=True)
    np.testing.assert_array_equal(episode.truth.state[..., 2:], 0)
    np.testing.assert_array_equal(episode.mean[:, 2:], 0)
    np.testing.assert_allclose(problem.prior_information, np.eye(4) / 30.0, rtol=1e-12)
    assert np.abs(episode.mean[:, :2] - episode.truth.state[0, :, :2]).max() > 0.1


STREET = SceneSettings(
    targets_min=4,
    targets_max=4,
    half_side_m=(1.0, 1.0),
    half_side_per_target_m=0.0,
    steps=6,
    birth_and_death=True,
    shared_drift=False,
    initial_error="consistent",
)


@pytest.mark.parametrize(
    ("choice", "at_start", "of_newcomers"), [(None, True, False), ("zero", False, False), ("truth", True, True)]
)
def test_mean_velocities_of_first_beliefs_and_of_newcomers(choice, at_start, of_newcomers):
    """With an error of the truth the mean differs from it by N(0, P_0); else it is 0. Positions err in each case."""
    target = VelocityTarget(kind="constant_velocity", initial_velocity_variance_m2_s2=0.25)
    settings = replace(STREET, first_mean_velocity=choice)
    problem = Scenario(target=target, scenes=settings).problem()
    keys = jax.random.split(jax.random.key(8), 500)
    episode = jax.jit(jax.vmap(lambda key: training_episode(problem, settings, key, noise=True)))(keys)
    truth, arrivals = np.asarray(episode.truth.state), episode.arrivals
    begins = np.asarray(arrivals.present[:, 1:] & ~arrivals.present[:, :-1])
    assert begins.sum() > 500
    starts = (np.asarray(episode.mean), truth[:, 0]), (np.asarray(arrivals.mean)[:, 1:][begins], truth[:, 1:][begins])
    for (mean, state), errs in zip(starts, (at_start, of_newcomers), strict=True):
        error = (mean - state).reshape(-1, 4)
        if errs:
            np.testing.assert_allclose(np.mean(error[:, 2:] ** 2), 0.25, rtol=0.15)
        else:
            np.testing.assert_array_equal(mean[..., 2:], 0)
        np.testing.assert_allclose(np.mean(error[:, :2] ** 2), 2.0, rtol=0.15)


EYE, NONE = np.eye(2), np.zeros((2, 2))
A4 = np.block([[EYE, 0.5 * EYE], [NONE, 0.9 * EYE]])
W4 = 0.1 * np.array([[2.0, 0.5, 0.3, 0], [0.5, 1, 0, 0.2], [0.3, 0, 1, 0], [0, 0.2, 0, 1]])


B4, Z4 = np.eye(4, 2), np.eye(2, 4)


def moving(A=A4, W=W4, B=B4, Z=Z4):
    prior = np.diag([2.0, 2.0, 0.5, 0.5])
    parts = {name: tuple(map(tuple, m.tolist())) for name, m in zip("ABWZ", (A, B, W, Z), strict=True)}
    return LinearTarget(kind="linear", prior=tuple(map(tuple, prior.tolist())), **parts)


def test_truth_of_moving_targets():
    """With velocities in the state the drift is the initial velocity, and nothing is driven from outside."""
    scenario = replace(PAPER, target=moving(), scenes=replace(FIXED, initial_error="consistent"))
    scene, _, episode = episodes(scenario)
    truth = episode.truth.state
    np.testing.assert_allclose(truth[:, 0], np.concatenate([scene.position, scene.drift], axis=-1), atol=1e-12)
    np.testing.assert_array_equal(episode.inputs, 0)
    np.testing.assert_allclose(covariance_of(truth[:, 1:] - truth[:, :-1] @ A4.T), W4, atol=6e-3)
    np.testing.assert_allclose(covariance_of(episode.mean - truth[:, 0]), np.diag([2, 2, 0.5, 0.5]), atol=0.15)


def test_a_state_in_another_order_has_its_position_from_the_scene_and_no_place_for_a_drift():
    """State [x, v_x, y, v_y]: which of its numbers are the velocity, Z does not say."""
    order = np.eye(4)[[0, 2, 1, 3]]  # interleaved = order @ stacked
    target = moving(order @ A4 @ order.T, order @ W4 @ order.T, order[:, :2], order.T[:2])
    with pytest.raises(ValueError, match=r"scenes\.drift_m_s = \(0\.8, 0\.8\): expected 0"):
        replace(PAPER, target=target)
    scenario = replace(PAPER, target=target, scenes=replace(PAPER.scenes, drift_m_s=(0.0, 0.0)))
    problem = scenario.problem()
    still = Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((1.0, 2.0),), drift=((0.0, 0.0),), horizon=2)
    episode = scene_episodes(problem, scenario.scenes, [still], 0, 1)
    np.testing.assert_allclose(problem.motion.position(episode.truth.state[0, 0]), [[1.0, 2.0]], atol=1e-12)
    with pytest.raises(ValueError, match="scene 'a': drift: expected 0"):
        scene_episodes(problem, scenario.scenes, [replace(still, drift=((0.5, -0.25),))], 0, 1)


SMALL = Scene(id="small", agent=(0.5, 1.0, 2.0), targets=((1.0, 2.0), (3.0, -1.0)), drift=((0.1, 0.0),) * 2, horizon=4)
LARGE = Scene(id="large", agent=(0.0, 0.0, 0.0), targets=((0.0, 2.0),) * 4, drift=((0.0, 0.0),) * 4, horizon=7)


def test_noise_of_an_episode_depends_on_its_key_alone():
    """Neither on the padding, nor on the order, nor on the other scenes, nor on how many episodes there are."""
    problem, settings = PAPER.problem(), PAPER.scenes
    alone = scene_episodes(problem, settings, [SMALL], 3, 2)
    among = scene_episodes(problem, settings, [LARGE, SMALL], 3, 3)
    assert among.mean.shape == (6, 4, 2)
    assert among.inputs.shape == (6, 7, 4, 2)
    np.testing.assert_array_equal(among.horizon, [7, 7, 7, 4, 4, 4])
    np.testing.assert_array_equal(among.present.sum(axis=1), [4, 4, 4, 2, 2, 2])
    for k in range(2):
        here, there = (jax.tree.map(lambda x, i=i: np.asarray(x[i]), e) for e, i in ((alone, k), (among, 3 + k)))
        for mine, other in [
            (here.mean, there.mean[:2]),
            (here.inputs, there.inputs[:4, :2]),
            (here.truth.state, there.truth.state[:5, :2]),
            (here.truth.measurement_noise, there.truth.measurement_noise[:4, :2]),
            (here.pose, there.pose),
        ]:
            np.testing.assert_array_equal(mine, other)
        np.testing.assert_allclose(here.truth.state[0], SMALL.targets, atol=1e-12)
    assert not np.array_equal(alone.mean[0], alone.mean[1])


def test_noise_differs_by_seed_scene_and_episode():
    problem = PAPER.problem()
    cases = [(SMALL, 0, 0), (SMALL, 0, 1), (SMALL, 1, 0), (replace(SMALL, id="other"), 0, 0)]
    firsts = [scene_noise(problem, *case)["process"][0, 0, 0] for case in cases]
    assert len(set(firsts)) == 4
    everything = [scene_noise(problem, replace(SMALL, horizon=2000), 0, k) for k in range(2)]
    assert kstest(everything[0]["measurement"].ravel(), "norm").pvalue > 1e-3
    assert uniform(everything[0]["jitter"], -1, 1)
    both = [np.ravel(e["process"]) for e in everything]
    assert abs(np.corrcoef(both)[0, 1]) < 0.06


@pytest.mark.parametrize("error", ["paper", "consistent"])
@pytest.mark.parametrize("scenario", [QUADROTOR, TWO_EQUAL_AXES, JERK], ids=["quadrotor", "linear", "acceleration"])
def test_draws_are_the_same_in_single_precision(scenario, error):
    """The same random numbers give the same truth: no root follows rounding, not even where eigenvalues are equal."""
    scenario = replace(scenario, scenes=replace(scenario.scenes, initial_error=error, steps=8))
    scenes, key = scenario.scenes, jax.random.key(4)
    numbers = jax.random.uniform(key, (draw_size(scenes, scenario.problem()),), minval=-1.0)
    made = draw(scenes, scenario.problem(), numbers), draw_noise(scenario.problem(), key, 8, scenes.targets_max)

    def states(x64):
        with jax.enable_x64(x64):
            problem, (scene, noise) = scenario.problem(), jax.tree.map(jnp.array, jax.tree.map(np.asarray, made))
            episode = jax.jit(lambda s, n: episode_of(problem, scenes, s, n))(scene, noise)
        return episode.truth.state, episode.mean

    for found, expected in zip(states(False), states(True), strict=True):
        assert (found.dtype, expected.dtype) == (np.float32, np.float64)
        np.testing.assert_allclose(found, expected, atol=1e-3)
