"""Proposition 1 against reverse-mode differentiation of the simulation and against central differences of it."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode
from jax.flatten_util import ravel_pytree

from foveate.experiment.presets import QUADROTOR
from foveate.geometry import fov, fov_planar, fov_spatial, lie
from foveate.geometry.space import SPACES
from foveate.learning.sensitivity import policy_gradient
from foveate.models.agent import Agent
from foveate.models.problem import Problem, Schedule
from foveate.models.sensor import PAPER_SOFTNESS, Sensor, Softness
from foveate.models.target import LinearGaussian
from foveate.policies.attention import AttentionSettings
from foveate.policies.heuristics import Lawnmower
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import SensorSettings
from foveate.simulation.planar_in_space import EmbeddedPolicy, embedded_episode, embedded_problem
from foveate.simulation.records import Episode, Protocol
from foveate.simulation.rollout import log_dets

VIEWS = {
    "frustum": fov_spatial.frustum(0.2, 4.0, 1.6, 1.1),
    "cone": fov_spatial.cone(0.1, 3.0, 1.9),
    "ball": fov.ball([1.0, 0.2, -0.1], 2.0),
    "prism": fov_spatial.prism(fov_planar.triangle(2.0, 2.0)),
}
SMALL = AttentionSettings(agent_widths=(5, 4), target_widths=(6, 4), out_widths=(5,), length_m=2.0)
LARGER = AttentionSettings(agent_widths=(9,), target_widths=(7, 9), out_widths=(8, 6), alpha=2.0)
CASES = {
    # view, n_y, singular A, noise frame, growth with range, actuated axes, policy, frame of its inputs, targets
    "velocity, frustum": ("frustum", 6, False, "body", 0.3, (0, 1, 2, 5), SMALL, "body", 3),
    "six axes, cone": ("cone", 3, False, "world", 0.0, (0, 1, 2, 3, 4, 5), LARGER, "world", 2),
    "singular A, ball": ("ball", 4, True, "world", 0.2, (0, 3, 4), SMALL, "world", 4),
    "body noise, prism": ("prism", 3, False, "body", 0.0, (0, 5), LARGER, "body", 1),
}


def spd(rng: np.random.Generator, size: int, scale: float) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return scale * (root @ root.T / size + 0.3 * np.eye(size))


def made(name: str, seed: int = 0, steps: int = 5):
    """Problem, policy and padded episode of a case, all matrices full and correlated."""
    view, n_y, singular, frame, growth, axes, settings, inputs, n = CASES[name]
    rng = np.random.default_rng([seed, len(name)])
    A = np.eye(n_y) + 0.2 * rng.normal(size=(n_y, n_y))
    if singular:
        A[:, -1] = A[:, 0]
    Z = np.eye(3, n_y) if inputs == "body" else rng.normal(size=(3, n_y)) / np.sqrt(n_y) + np.eye(3, n_y)
    motion = LinearGaussian(
        A=jnp.asarray(A), B=jnp.asarray(rng.normal(size=(n_y, 2))), W=jnp.asarray(spd(rng, n_y, 0.05)), Z=jnp.asarray(Z)
    )
    stacked = jax.tree.map(lambda x: jnp.stack([x, x]), motion)
    period = Schedule(
        tau=jnp.array([0.7, 0.4]),
        motion=eqx.tree_at(lambda m: m.W, stacked, jnp.stack([motion.W, 2 * motion.W])),
        V=jnp.asarray(np.stack([spd(rng, 3, 0.1), spd(rng, 3, 0.2)])),
    )
    limits = jnp.linspace(0.8, 1.5, len(axes))
    problem = Problem(
        agent=Agent(SPACES["spatial"], axes, -0.5 * limits, limits),
        sensor=Sensor(jnp.asarray(Z), period.V[0], VIEWS[view], growth, frame),
        motion=motion,
        tau=jnp.array(0.7),
        prior_information=jnp.asarray(spd(rng, n_y, 0.8)),
        schedule=period,
    )
    policy = replace(settings, frame=inputs).policy(problem, jax.random.key(seed))
    episode = Episode(
        pose=lie.exp_se3(jnp.asarray(0.7 * rng.normal(size=6))),
        mean=jnp.asarray(1.5 * rng.normal(size=(n + 1, n_y))),
        present=jnp.arange(n + 1) < n,
        inputs=jnp.asarray(0.3 * rng.normal(size=(steps + 2, n + 1, 2))),
        horizon=jnp.asarray(steps),
    )
    return problem, policy, episode


def objective(problem, policy, episode, softness=PAPER_SOFTNESS):
    values = log_dets(problem, policy, episode, Protocol(levels=(softness,)), jax.random.key(0))
    return jnp.sum(jnp.where(episode.present, values[episode.horizon - 1], 0.0))


def flat(tree):
    return np.asarray(ravel_pytree(eqx.filter(tree, eqx.is_inexact_array))[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_equals_reverse_mode_and_central_differences(name):
    problem, policy, episode = made(name)
    softness = Softness(0.7, 0.6)
    score, gradient = eqx.filter_jit(policy_gradient)(problem, policy, episode, softness)
    run = eqx.filter_jit(eqx.filter_value_and_grad(lambda p: objective(problem, p, episode, softness)))
    value, reverse = run(policy)
    np.testing.assert_allclose(score, value, rtol=1e-12)
    ours, theirs = flat(gradient), flat(reverse)
    assert np.linalg.norm(theirs) > 1e-3
    assert np.linalg.norm(ours - theirs) < 1e-9 * np.linalg.norm(theirs)
    parameters, rest = eqx.partition(policy, eqx.is_inexact_array)
    theta, restore = ravel_pytree(parameters)
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(6, theta.size)) / np.sqrt(theta.size)
    for direction in directions:
        ahead, behind = (run(eqx.combine(restore(theta + h * direction), rest))[0] for h in (1e-5, -1e-5))
        difference = (ahead - behind) / 2e-5
        np.testing.assert_allclose(
            direction @ ours, difference, rtol=1e-5, atol=1e-5 * np.linalg.norm(ours) / np.sqrt(theta.size)
        )


@pytest.mark.slow
def test_the_paper_s_planar_policy_through_the_lift():
    """Its gradient in the plane, by reverse mode, is Proposition 1's in the plane z = 0 of space."""
    problem = Scenario().problem()
    policy = SMALL.policy(problem, jax.random.key(3))
    rng = np.random.default_rng(5)
    episode = Episode(
        pose=jnp.array([0.4, -0.3, 2.9]),
        mean=jnp.asarray(rng.uniform(-3, 3, (3, 2))),
        present=jnp.ones(3, bool),
        inputs=jnp.asarray(rng.normal(size=(4, 3, 2))),
        horizon=jnp.asarray(4),
    )
    lifted = (embedded_problem(problem), EmbeddedPolicy(policy), embedded_episode(episode))
    score, gradient = eqx.filter_jit(policy_gradient)(*lifted)
    value, reverse = eqx.filter_jit(eqx.filter_value_and_grad(lambda p: objective(problem, p, episode)))(policy)
    np.testing.assert_allclose(score, value, rtol=1e-12)
    np.testing.assert_allclose(flat(gradient), flat(reverse), rtol=0, atol=1e-9 * np.linalg.norm(flat(reverse)))


@pytest.mark.slow
def test_a_sensor_of_angles_and_ranges():
    """What a measurement is worth then depends on the pose through its own coordinates."""
    sensor = SensorSettings(
        measures="azimuth-elevation-range", std_range_m=0.2, std_bearing_rad=0.05, std_elevation_rad=0.05
    )
    scenes = replace(QUADROTOR.scenes, initial_error="consistent", targets_min=2, targets_max=2, steps=3)
    problem = replace(QUADROTOR, sensor=sensor, scenes=scenes).problem()
    policy = SMALL.policy(problem, jax.random.key(0))
    episode = training_episode(problem, scenes, jax.random.key(1), noise=False)
    softness = Softness(5.0, 0.6)  # far targets count, too
    score, gradient = eqx.filter_jit(policy_gradient)(problem, policy, episode, softness)
    run = eqx.filter_jit(eqx.filter_value_and_grad(lambda p: objective(problem, p, episode, softness)))
    value, reverse = run(policy)
    np.testing.assert_allclose(score, value, rtol=1e-12)
    assert np.linalg.norm(flat(reverse)) > 1e-3
    np.testing.assert_allclose(flat(gradient), flat(reverse), rtol=0, atol=1e-9 * np.linalg.norm(flat(reverse)))


@pytest.mark.slow
def test_the_printed_form_is_partial():
    """Without the way of theta through the policy's inputs the first step is right, and only that."""
    problem, policy, episode = made("six axes, cone", steps=3)
    one = eqx.tree_at(lambda e: e.horizon, episode, jnp.asarray(1))
    run = eqx.filter_jit(policy_gradient)
    alone, whole_one = (flat(run(problem, policy, one, total=total)[1]) for total in (False, True))
    np.testing.assert_allclose(alone, whole_one, atol=1e-13)
    printed, whole = (flat(run(problem, policy, episode, total=total)[1]) for total in (False, True))
    assert np.linalg.norm(printed - whole) > 1e-3 * np.linalg.norm(whole)


def test_unsupported_problems_are_rejected():
    problem, policy, episode = made("velocity, frustum")
    with pytest.raises(ValueError, match="embed a planar problem"):
        policy_gradient(Scenario().problem(), policy, episode)
    with pytest.raises(ValueError, match="free motion"):
        policy_gradient(replace(problem, keep_off_m=jnp.asarray(1.0)), policy, episode)
    walled = replace(QUADROTOR, obstacles=ShapeObstacles(boxes=((0.0, 0.0, 0.0, 1.0, 1.0, 1.0),))).problem()
    with pytest.raises(ValueError, match="nor obstacles"):
        policy_gradient(walled, policy, episode)
    with pytest.raises(ValueError, match="without memory"):
        policy_gradient(problem, Lawnmower(problem, 0.5), episode)
    with pytest.raises(ValueError, match="noise-free"):
        policy_gradient(problem, policy, eqx.tree_at(lambda e: e.truth, episode, 1.0, is_leaf=lambda x: x is None))
