"""Numbers over the whole range of use: scales, counts, badly conditioned matrices, other frames, padding, float32.

One compiled program of 64 slots serves every example; hypothesis chooses how many are taken, and by what.
"""

import functools
import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from foveate.models.problem import Problem
from foveate.models.sensor import Softness
from foveate.policies.attention import AttentionSettings
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import TriangleView
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import DriftTarget
from foveate.simulation.records import Episode, Policy, Protocol, per_target
from foveate.simulation.rollout import rollout

SLOTS, STEPS = 64, 6
SCALES = st.floats(-3, 5).map(lambda power: 10.0**power)
COUNTS = st.integers(0, SLOTS)
SEEDS = st.integers(0, 2**32 - 1)
EXAMPLES = settings(max_examples=60, deadline=None)
NETWORK = AttentionSettings(agent_widths=(8,), target_widths=(8, 8), out_widths=(8,), information="asinh")


class Played(Policy):
    """Plays actions, whatever it sees."""

    action: jax.Array

    def __call__(self, observation, memory, key):
        return self.action[observation.step], memory


class Outcome(NamedTuple):
    """The score, its slopes, and the beliefs."""

    score: jax.Array
    slopes: list
    mean: jax.Array
    information: jax.Array
    action: jax.Array


@functools.cache
def program(kind):
    """(problem, arrays of a policy, episode, kappa) -> Outcome, under the paper's softness."""
    static = eqx.partition(network() if kind == "network" else Played(jnp.zeros((STEPS, 2))), eqx.is_inexact_array)[1]

    def run(arrays, problem, episode, kappa):
        protocol = Protocol(levels=(Softness(2.0, kappa),))
        trace = rollout(problem, eqx.combine(arrays, static), episode, protocol, jax.random.key(0))
        return per_target(trace.log_det[-1], episode.present), trace

    def outcome(arrays, problem, episode, kappa):
        (score, trace), slopes = jax.value_and_grad(run, has_aux=True)(arrays, problem, episode, kappa)
        return Outcome(score, jax.tree.leaves(slopes), trace.mean, trace.information, trace.action)

    return eqx.filter_jit(outcome)


@functools.cache
def network():
    return NETWORK.policy(PAPER, jax.random.key(5))


PAPER = Scenario().problem()


def weights():
    return eqx.filter(network(), eqx.is_inexact_array)


def scenario_of(scale):
    """The paper's, in other units of length."""
    return Scenario(
        agent=DifferentialDrive(v_max_m_s=4.0 * scale),
        view=TriangleView(depth_m=2.0 * scale),
        sensor=SensorSettings(std_m=0.2 * scale),
        target=DriftTarget(process_std_m=0.05 * scale, initial_variance_m2=2.0 * scale**2),
    ).problem()


def episode_of(seed, count, scale=1.0):
    """Targets around an agent, at a distance where some are seen."""
    rng = np.random.default_rng(seed)
    return Episode(
        pose=jnp.asarray([*rng.normal(0, 3, 2) * scale, rng.uniform(-np.pi, np.pi)]),
        mean=jnp.asarray(rng.normal(0, 3, (SLOTS, 2)) * scale),
        present=jnp.arange(SLOTS) < count,
        inputs=jnp.asarray(rng.normal(0, 0.3, (STEPS, SLOTS, 2)) * scale),
        horizon=jnp.asarray(STEPS),
    )


def actions(seed):
    return jnp.asarray(np.random.default_rng([seed, 1]).uniform(-1, 1, (STEPS, 2)))


def sane(found):
    """Finite slopes and actions; beliefs symmetric and positive definite."""
    for slope in found.slopes:
        assert np.isfinite(slope).all()
    assert np.isfinite(found.action).all()
    Y = np.asarray(found.information, float)
    size = np.abs(Y).max(axis=(-1, -2), keepdims=True)
    assert (np.abs(Y - Y.swapaxes(-1, -2)) <= 1e-12 * size).all()
    # Of the correlations: what units the axes have says nothing of a matrix.
    root = np.sqrt(np.diagonal(Y, axis1=-2, axis2=-1))
    assert (root > 0).all()
    assert np.linalg.eigvalsh(Y / (root[..., None] * root[..., None, :])).min() > 0


@pytest.mark.slow
@settings(EXAMPLES, max_examples=6)
@given(scale=SCALES, count=COUNTS, seed=SEEDS)
def test_in_other_units_of_length_the_score_is_the_same_but_for_the_units(scale, count, seed):
    """From a millimetre to 100 km; log det of s^-2 Y is log det Y - 2 n_y log s."""
    played = eqx.filter(Played(actions(seed)), eqx.is_inexact_array)
    one = program("played")(played, PAPER, episode_of(seed, count), 0.4)
    other = program("played")(played, scenario_of(scale), episode_of(seed, count, scale), 0.4 * scale)
    sane(other)
    expected = float(one.score) - 4 * np.log(scale) * (count > 0)
    np.testing.assert_allclose(other.score, expected, rtol=0, atol=1e-7)
    for a, b in zip(one.slopes, other.slopes, strict=True):
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-6 * (1 + np.abs(a).max()))
    assert count or float(other.score) == 0.0


@pytest.mark.slow
@EXAMPLES
@given(count=COUNTS, seed=SEEDS)
def test_a_policy_in_the_body_frame_ignores_origin_order_and_padding(count, seed):
    found = program("network")(weights(), PAPER, episode := episode_of(seed, count), 0.4)
    sane(found)
    rng = np.random.default_rng([seed, 2])

    turn, shift = rng.uniform(-np.pi, np.pi), rng.normal(0, 100, 2)
    R = Rotation.from_euler("z", turn).as_matrix()[:2, :2]
    moved = eqx.tree_at(
        lambda e: (e.pose, e.mean, e.inputs),
        episode,
        (
            jnp.asarray([*(R @ episode.pose[:2] + shift), episode.pose[2] + turn]),
            episode.mean @ R.T + shift,
            episode.inputs @ R.T,
        ),
    )
    order = np.concatenate([rng.permutation(count), np.arange(count, SLOTS)]).astype(int)
    shuffled = eqx.tree_at(lambda e: (e.mean, e.inputs), episode, (episode.mean[order], episode.inputs[:, order]))
    junk = np.where(np.arange(SLOTS) < count, 0.0, 10.0 ** rng.uniform(-9, 9))[:, None]
    padded = eqx.tree_at(lambda e: (e.mean, e.inputs), episode, (episode.mean + junk, episode.inputs - junk))
    for name, other in [("frame", moved), ("order", shuffled), ("padding", padded)]:
        again = program("network")(weights(), PAPER, other, 0.4)
        np.testing.assert_allclose(again.score, found.score, rtol=0, atol=1e-8, err_msg=name)
        np.testing.assert_allclose(again.action, found.action, rtol=0, atol=1e-8, err_msg=name)
        for a, b in zip(found.slopes, again.slopes, strict=True):
            np.testing.assert_allclose(b, a, rtol=0, atol=1e-6 * (1 + np.abs(a).max()), err_msg=name)


def bad(rng, power, condition):
    """A covariance of any size, up to 10^`condition` times longer than wide."""
    R = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()[:2, :2]
    return jnp.asarray(R @ np.diag(10.0 ** (power + np.array([0.0, rng.uniform(0, condition)]))) @ R.T)


@EXAMPLES
@given(powers=st.tuples(*[st.floats(-8, 6)] * 3), condition=st.sampled_from([0.0, 4.0, 8.0]), count=COUNTS, seed=SEEDS)
def test_nearly_singular_and_badly_scaled_matrices_stay_valid(powers, condition, count, seed):
    """W, V and Y_0 from 1e-8 to 1e6 m^2, with axes that differ by up to 10^4 in length."""
    rng = np.random.default_rng(seed)
    W, V, prior = (bad(rng, power, condition) for power in powers)
    problem = with_matrices(PAPER, W, V, jnp.linalg.inv(prior))
    found = program("network")(weights(), problem, episode_of(seed, count), 0.4)
    for slope in found.slopes:
        assert np.isfinite(slope).all()
    Y = np.asarray(found.information)
    assert (np.abs(Y - Y.swapaxes(-1, -2)) <= 1e-12 * np.abs(Y).max(axis=(-1, -2), keepdims=True)).all()
    # float64 tells eigenvalues 1e-14 of the largest from zero; filters of these conditions keep 1e-8 and less apart.
    values = np.linalg.eigvalsh(Y)
    assert (values[..., 0] > -1e-14 * values[..., 1]).all()
    assert np.isfinite(found.score)


def with_matrices(problem: Problem, W, V, information):
    return eqx.tree_at(lambda p: (p.motion.W, p.sensor.V, p.prior_information), problem, (W, V, information))


@EXAMPLES
@given(count=st.integers(1, SLOTS), seed=SEEDS, more=st.floats(1e-6, 10), direction=st.floats(0, np.pi))
def test_added_information_does_not_lower_the_score(count, seed, more, direction):
    """A better first belief, a better sensor, targets that wander less: log det is monotone in all."""
    played = eqx.filter(Played(actions(seed)), eqx.is_inexact_array)
    run = functools.partial(program("played"), played, episode=episode_of(seed, count), kappa=0.4)
    axis = np.array([np.cos(direction), np.sin(direction)])
    less = jnp.asarray(np.linalg.inv(np.eye(2) + more * np.outer(axis, axis)))
    W, V, Y = PAPER.motion.W, PAPER.sensor.V, PAPER.prior_information
    before = float(run(problem=PAPER).score)
    assert float(run(problem=with_matrices(PAPER, W, V, Y + more * jnp.outer(axis, axis))).score) >= before - 1e-12
    assert float(run(problem=with_matrices(PAPER, W, 0.04 * less, Y)).score) >= before - 1e-12
    assert float(run(problem=with_matrices(PAPER, 0.0025 * less, V, Y)).score) >= before - 1e-12


@pytest.mark.slow
def test_float32_is_float64_within_bounds():
    """Score within 1e-3 nat, slopes within 1e-3 of the largest, from a millimetre to 100 km; 15 episodes each."""
    exact, rounded = [], []
    for kept, x64 in ((exact, True), (rounded, False)):
        with jax.enable_x64(x64):
            run = program("played") if x64 else program.__wrapped__("played")
            for seed, scale in itertools.product(range(15), (1e-3, 1.0, 1e5)):
                played = eqx.filter(Played(actions(seed)), eqx.is_inexact_array)
                episode = episode_of(seed, seed % 9, scale)
                kept.append(run(played, cached_scenario(scale, x64), episode, jnp.asarray(0.4 * scale)))
    for one, other in zip(exact, rounded, strict=True):
        assert other.score.dtype == np.float32
        np.testing.assert_allclose(other.score, one.score, rtol=0, atol=1e-3)
        for a, b in zip(one.slopes, other.slopes, strict=True):
            np.testing.assert_allclose(b, a, rtol=0, atol=1e-3 * (1 + np.abs(a).max()))


@functools.cache
def cached_scenario(scale, x64):
    assert x64 == jax.config.read("jax_enable_x64")
    return scenario_of(scale)
