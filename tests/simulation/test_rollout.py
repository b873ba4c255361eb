"""A complete episode, simulated again in plain numpy: unicycle, triangle, covariance-form Kalman filter, loops."""

from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.special import erf

from foveate.geometry.fov_planar import triangle
from foveate.geometry.space import SPACES
from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.models.sensor import Sensor, Softness
from foveate.models.target import LinearGaussian
from foveate.policies.attention import AttentionSettings
from foveate.simulation.records import SURROGATE, TRUE, Arrivals, Episode, Policy, Protocol, Truth
from foveate.simulation.rollout import log_dets, rollout

MIXTURE = Protocol(levels=(Softness(1.0, 0.4), Softness(0.3, 0.25)))
DEPTH, ANGLE = 2.0, 2 * np.pi / 3
LOWER, UPPER = np.array([-0.5, -1.0]), np.array([2.0, 1.0])


class Feedback(Policy):
    """Depends on everything that a policy may see, smoothly: tanh of sums of sines over the present targets."""

    weights: Any

    def __call__(self, observation, memory, key):
        o = observation
        lower = o.information[:, *jnp.tril_indices(o.mean.shape[-1])]
        each = jnp.concatenate([o.mean, lower / 20, o.known_input], axis=-1)
        total = jnp.sum(jnp.where(o.present[:, None], jnp.sin(each), 0.0), axis=0)
        clock = 0.1 * jnp.asarray(o.step, o.mean.dtype) + memory
        features = jnp.concatenate([total, jnp.sin(o.pose), jnp.array([clock])])
        return jnp.tanh(self.weights @ features), memory + 0.01

    def start(self, observation):
        return jnp.sum(jnp.where(observation.present, observation.mean[:, 0], 0.0))


@dataclass(frozen=True)
class Case:
    """One problem and episode as numpy arrays, and the simulation that foveate's is compared with."""

    A: np.ndarray
    B: np.ndarray
    W: np.ndarray
    H: np.ndarray
    V: np.ndarray
    prior: np.ndarray
    pose: np.ndarray
    first_mean: np.ndarray  # K+1 n n_y; a belief that begins at k takes row k
    inputs: np.ndarray
    truth: np.ndarray | None
    noise: np.ndarray
    weights: np.ndarray
    present: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # K+1 n, or empty: always, all
    tau: float = 0.8
    frame: Any = "world"
    growth: float = 0.0

    @property
    def Z(self):
        return np.eye(2, len(self.A))

    def alive(self):
        shape = self.first_mean.shape[:2]
        return self.present if self.present.size else np.ones(shape, bool)

    def policy(self):
        return Feedback(jnp.asarray(self.weights))

    def problem(self):
        motion = LinearGaussian(*(jnp.asarray(x) for x in (self.A, self.B, self.W, self.Z)))
        view = triangle(DEPTH, ANGLE)
        sensor = Sensor(jnp.asarray(self.H), jnp.asarray(self.V), view, self.growth, self.frame)
        agent = Agent(SPACES["planar"], (0, 2), jnp.asarray(LOWER), jnp.asarray(UPPER))
        return Problem(agent, sensor, motion, jnp.asarray(self.tau), jnp.asarray(np.linalg.inv(self.prior)))

    def episode(self):
        alive = self.alive()
        truth = None if self.truth is None else Truth(jnp.asarray(self.truth), jnp.asarray(self.noise))
        arrivals = Arrivals(jnp.asarray(alive), jnp.asarray(self.first_mean)) if self.present.size else None
        return Episode(
            pose=jnp.asarray(self.pose),
            mean=jnp.asarray(self.first_mean[0]),
            present=jnp.asarray(alive[0]),
            inputs=jnp.asarray(self.inputs),
            horizon=jnp.asarray(len(self.inputs)),
            truth=truth,
            arrivals=arrivals,
        )

    def act(self, step, pose, means, informations, known_input, present, memory):
        """`Feedback` in numpy."""
        total = 0.0
        for j in np.flatnonzero(present):
            packed = [informations[j][a, b] for a in range(len(self.A)) for b in range(a + 1)]
            total = total + np.sin(np.concatenate([means[j], np.array(packed) / 20, known_input[j]]))
        features = np.concatenate([total, np.sin(pose), [0.1 * step + memory + 0.01 * step]])
        action = np.tanh(self.weights @ features)
        return action, LOWER + (action + 1) / 2 * (UPPER - LOWER)

    def covariance(self, yaw, point_body):
        R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        V = R @ self.V @ R.T if self.frame == "body" else self.V
        return V * (1 + self.growth * np.hypot(*point_body)) ** 2

    def simulate(self, levels, at_truth=False):
        """pose, action, mean, covariance (per level), visible, of every step; NaN where a target is not there."""
        K, n = self.inputs.shape[:2]
        alive, weights_of = self.alive(), [lambda d, c=level: soft_weight(d, *c) for level in levels]
        mean = [self.first_mean[0, j] for j in range(n)]
        P = [[self.prior] * n for _ in (levels or [None])]
        pose, poses, actions = self.pose, [self.pose], []
        means, covariances, looks = [np.array(mean)], [np.array(P)], []
        memory = sum((self.A @ mean[j] + self.B @ self.inputs[0, j])[0] for j in range(n) if alive[0, j])
        for k in range(K):
            predicted = [self.A @ mean[j] + self.B @ self.inputs[k, j] for j in range(n)]
            P = [[self.A @ Pj @ self.A.T + self.W for Pj in level] for level in P]
            informations = [np.linalg.inv(Pj) for Pj in P[-1]]
            action, (v, w) = self.act(k, pose, predicted, informations, self.inputs[k], alive[k], memory)
            pose = unicycle(pose, v, w, self.tau)
            look = np.zeros(n, bool)
            mean = list(predicted)
            for j in range(n):
                point = to_body(pose, predicted[j][:2])
                V = self.covariance(pose[2], point)
                if self.truth is not None and alive[k, j] and alive[k + 1, j]:
                    true_point = to_body(pose, self.truth[k + 1, j, :2])
                    look[j] = in_triangle(true_point)
                    if look[j]:
                        root = np.linalg.cholesky(self.covariance(pose[2], true_point))
                        z = self.H @ self.truth[k + 1, j] + root @ self.noise[k, j]
                        S = self.H @ P[-1][j] @ self.H.T + V
                        mean[j] = mean[j] + P[-1][j] @ self.H.T @ np.linalg.solve(S, z - self.H @ mean[j])
                where = to_body(pose, self.truth[k + 1, j, :2]) if at_truth else point
                weights = [f(triangle_distance(where)) for f in weights_of] if levels else [float(look[j])]
                for level, weight in zip(P, weights, strict=True):
                    if weight > 1e-300:  # a measurement whose noise is V / weight
                        gain = level[j] @ self.H.T @ np.linalg.inv(self.H @ level[j] @ self.H.T + V / weight)
                        level[j] = level[j] - gain @ self.H @ level[j]
                if alive[k + 1, j] and not alive[k, j]:
                    mean[j] = self.first_mean[k + 1, j]
                    for level in P:
                        level[j] = self.prior
            poses.append(pose)
            actions.append(action)
            means.append(np.array(mean))
            covariances.append(np.array(P))
            looks.append(look)
        return tuple(map(np.array, (poses, actions, means, covariances, looks)))


def unicycle(pose, v, w, tau):
    x, y, yaw = pose
    end = yaw + w * tau
    if abs(w) < 1e-9:
        return np.array([x + tau * v * np.cos(yaw), y + tau * v * np.sin(yaw), end])
    return np.array([x + v / w * (np.sin(end) - np.sin(yaw)), y - v / w * (np.cos(end) - np.cos(yaw)), end])


def to_body(pose, point):
    dx, dy = point - pose[:2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([c * dx + s * dy, c * dy - s * dx])


def in_triangle(point):
    return 0 <= point[0] <= DEPTH and abs(point[1]) <= point[0] * np.tan(ANGLE / 2)


def triangle_distance(point):
    half = DEPTH * np.tan(ANGLE / 2)
    corners = [np.zeros(2), np.array([DEPTH, -half]), np.array([DEPTH, half])]
    nearest = np.inf
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        along = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        nearest = min(nearest, np.linalg.norm(point - a - along * (b - a)))
    return -nearest if in_triangle(point) else nearest


def soft_weight(distance, offset, kappa):
    """1 - Phi as the paper prints Phi."""
    return 1 - 0.5 * (1 + erf(distance / (np.sqrt(2) * kappa) - offset))


def case_of(n_y=2, n=3, K=14, seed=8, **changes):
    """n_y = 2: the paper's kind of target. n_y = 4: full matrices, A singular, noise in the body frame that grows."""
    rng = np.random.default_rng([seed, n_y])
    A, B, W, H = np.eye(2), np.eye(2), 0.05**2 * np.eye(2), np.eye(2)
    V, prior = 0.2**2 * np.eye(2), 2.0 * np.eye(2)
    if n_y == 4:
        A = np.eye(4) + 0.3 * rng.normal(size=(4, 4))
        A[3] = A[2]
        A[:, 2:] *= 0.5
        A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
        B = rng.normal(size=(4, 3))
        root = 0.2 * rng.normal(size=(4, 4))
        W, H = root @ root.T + 0.01 * np.eye(4), np.eye(2, 4)
        V, prior = np.array([[0.05, 0.02], [0.02, 0.2]]), 2 * np.eye(4) + 0.3
        changes = {"frame": "body", "growth": 0.4, **changes}
    inputs = rng.uniform(-0.3, 0.3, (K, n, B.shape[1]))
    truth = [np.concatenate([rng.uniform(-1.5, 1.5, (n, 2)), rng.normal(size=(n, n_y - 2))], axis=1)]
    for xi in inputs:
        truth.append(truth[-1] @ A.T + xi @ B.T + rng.multivariate_normal(np.zeros(n_y), W, n))
    truth = np.array(truth)
    features = n_y + n_y * (n_y + 1) // 2 + B.shape[1] + 3 + 1
    return Case(
        *(A, B, W, H, V, prior),
        pose=np.array([0.2, -0.4, 2.0]),
        first_mean=truth + 0.3 * rng.normal(size=truth.shape),
        inputs=inputs,
        truth=truth,
        noise=rng.normal(size=(K, n, len(H))),
        weights=0.5 * rng.normal(size=(2, features)),
        **changes,
    )


@eqx.filter_jit
def run(problem, policy, episode, protocol):
    """One program for each structure that the tests meet."""
    return rollout(problem, policy, episode, protocol, jax.random.key(0))


@eqx.filter_jit
def mean_log_dets(problem, policy, episode, protocol):
    return log_dets(problem, policy, episode, protocol, jax.random.key(0))


def check(case, protocol):
    """The whole trace against the numpy simulation, where targets are present."""
    trace = run(case.problem(), case.policy(), case.episode(), protocol)
    levels = [tuple(level) for level in protocol.levels]
    pose, action, mean, covariance, visible = case.simulate(levels, protocol.at_truth)
    there = case.alive()
    tolerance = {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(trace.pose, pose, **tolerance)
    np.testing.assert_allclose(trace.action, action, **tolerance)
    np.testing.assert_allclose(np.asarray(trace.mean)[there], mean[there], **tolerance)
    information = np.linalg.inv(covariance[:, -1])
    np.testing.assert_allclose(np.asarray(trace.information)[there], information[there], **tolerance)
    np.testing.assert_array_equal(np.asarray(trace.visible)[there[1:]], visible[there[1:]])
    log_det = -np.linalg.slogdet(covariance[1:])[1]
    np.testing.assert_allclose(np.asarray(trace.log_det)[there[1:]], log_det[:, -1][there[1:]], **tolerance)
    np.testing.assert_array_equal(np.asarray(trace.present)[:, : there.shape[1]], there)
    return trace, visible


CASES = {"true": (2, TRUE), "true, full": (4, TRUE), "surrogate": (2, SURROGATE), "mixture, full": (4, MIXTURE)}
CASES["mixture at truth"] = (2, Protocol(MIXTURE.levels, at_truth=True))


@pytest.mark.parametrize(("n_y", "protocol"), CASES.values(), ids=CASES)
def test_an_episode_with_truth(n_y, protocol):
    case = case_of(n_y)
    trace, visible = check(case, protocol)
    assert 0.1 < visible.mean() < 0.9, "an episode in which all or nothing is seen shows too little"
    if len(protocol.levels) > 1:
        # Had the policy seen the first level, it would have acted otherwise.
        first = case.simulate([tuple(level) for level in protocol.levels[::-1]], protocol.at_truth)
        assert np.abs(trace.action - first[1]).max() > 1e-3


def test_training_differentiates_the_mean_log_det_over_levels():
    """Without truth, as in the paper's training: log dets, in the mean over the levels; nothing is really seen."""
    case = replace(case_of(2), truth=None)
    _, _, mean, covariance, visible = case.simulate([tuple(level) for level in MIXTURE.levels])
    assert not visible.any()
    np.testing.assert_allclose(mean[-1], case.first_mean[0] + case.inputs.sum(axis=0), atol=1e-12)
    levels = -np.linalg.slogdet(covariance[1:])[1]
    assert np.abs(levels[:, 0] - levels[:, 1]).max() > 0.1
    np.testing.assert_allclose(
        mean_log_dets(case.problem(), case.policy(), case.episode(), MIXTURE), levels.mean(axis=1), rtol=1e-9, atol=1e-9
    )


def test_the_mean_is_corrected_from_the_same_measurements_under_both_protocols():
    """With actions that do not depend on the belief, the truth is the same; only the gain differs."""
    case = case_of(2)
    case = replace(case, weights=case.weights * (np.arange(case.weights.shape[1]) >= 7))  # pose and time only
    for protocol in (TRUE, SURROGATE):
        check(case, protocol)


def ahead_of(pose):
    """Positions 1 m before the agent, in the middle of its view."""
    return pose[..., :2] + np.stack([np.cos(pose[..., 2]), np.sin(pose[..., 2])], axis=-1)


def test_padding_does_not_matter():
    case, wide = case_of(2), case_of(2, n=5, K=18, seed=9)
    K, n = case.inputs.shape[:2]
    rows, steps = (slice(0, n),), slice(0, K)
    first_mean, inputs = wide.first_mean.copy(), wide.inputs.copy()
    truth, noise = wide.truth.copy(), wide.noise.copy()
    first_mean[: K + 1, *rows], truth[: K + 1, *rows] = case.first_mean, case.truth
    inputs[steps, *rows], noise[steps, *rows] = case.inputs, case.noise
    padded = replace(case, first_mean=first_mean, inputs=inputs, truth=truth, noise=noise)
    trace = run(case.problem(), case.policy(), case.episode(), SURROGATE)
    truth[1 : K + 1, 4] = ahead_of(np.asarray(trace.pose)[1:])
    there = (jnp.arange(5) < n, jnp.asarray(K))
    episode = eqx.tree_at(lambda e: (e.present, e.horizon), padded.episode(), there)
    longer = run(case.problem(), case.policy(), episode, SURROGATE)
    for name in ("pose", "action", "mean", "information", "log_det", "visible"):
        real, also = np.asarray(getattr(trace, name)), np.asarray(getattr(longer, name))
        also = also[: len(real)] if name in ("pose", "action") else also[: len(real), :n]
        np.testing.assert_allclose(also, real, rtol=1e-12, atol=1e-12)
    assert not np.asarray(longer.visible)[:, n:].any(), "padding is never measured"
    assert np.isfinite(longer.log_det).all()


def test_targets_that_come_and_go():
    """Column 0 serves two targets in turn; 1 comes late; 2 leaves; 3 was always there; 4 comes for one instant."""
    case = case_of(2, n=5, K=14)
    present = np.zeros((15, 5), bool)
    for column, first, last in [(0, 0, 5), (0, 8, 14), (1, 3, 14), (2, 0, 6), (3, 0, 14), (4, 9, 9)]:
        present[first : last + 1, column] = True
    case = replace(case, present=present)
    # Where column 4 comes and column 2 is gone, both stand before the agent's eyes.
    pose = case.simulate([])[0]
    case.truth[9, 4], case.truth[7, 2] = ahead_of(pose[9]), ahead_of(pose[7])
    trace, _ = check(case, TRUE)
    looks = np.asarray(trace.visible)
    assert not looks[~(present[1:] & present[:-1])].any(), "measured before it came or after it went"
    assert looks[:, [0, 1, 2]].any(axis=0).all(), "each should be measured at some time"
    for column, first in [(0, 8), (1, 3), (4, 9)]:
        np.testing.assert_array_equal(trace.mean[first, column], case.first_mean[first, column])
        np.testing.assert_allclose(trace.information[first, column], np.linalg.inv(case.prior), atol=1e-15)


def test_float32_stays_float32_and_near():
    case = case_of(2)

    def single(tree):
        def narrow(x):
            return x.astype(jnp.float32) if eqx.is_array(x) and x.dtype == jnp.float64 else x

        return jax.tree.map(narrow, tree)

    parts = case.problem(), case.policy(), case.episode()
    trace, narrow = run(*parts, TRUE), run(*(single(x) for x in parts), TRUE)
    for name in ("pose", "action", "mean", "information", "log_det"):
        assert getattr(narrow, name).dtype == np.float32, name
    np.testing.assert_allclose(narrow.pose, trace.pose, atol=1e-3)
    np.testing.assert_allclose(narrow.log_det, trace.log_det, atol=1e-2)


STEP = 1e-6


def shifted(weights, places):
    """`weights` with each of the places moved ahead, then with each moved behind."""
    return np.array([weights + sign * STEP * one for sign in (1, -1) for one in np.eye(weights.size)[places]])


def check_gradient(function, weights, places):
    """A compiled value and gradient against central differences of the values."""
    gradient = np.asarray(function(weights)[1])
    values = np.array([function(other)[0] for other in shifted(weights, places)])
    expected = (values[: len(places)] - values[len(places) :]) / (2 * STEP)
    assert np.abs(expected).max() > 1e-2
    np.testing.assert_allclose(gradient[places], expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


@pytest.fixture(scope="module")
def noisy():
    """Total log det of a small episode with truth, as a function of the policy's weights, with its gradient."""
    case = case_of(2, n=2, K=6)
    problem, episode, key = case.problem(), case.episode(), jax.random.key(0)

    def total(weights):
        return jnp.sum(log_dets(problem, Feedback(weights.reshape(case.weights.shape)), episode, MIXTURE, key))

    return case, jax.jit(jax.value_and_grad(total))


@pytest.mark.slow
@pytest.mark.parametrize("straight", [False, True], ids=["turning", "yaw rate exactly 0"])
def test_gradient_of_log_dets(noisy, straight):
    case, function = noisy
    weights = np.zeros(case.weights.size) if straight else case.weights.ravel()
    if straight:
        standing = replace(case, weights=0 * case.weights)
        np.testing.assert_array_equal(standing.simulate([(1.0, 0.4)])[0][:, 2], case.pose[2])
    check_gradient(function, weights, [0, 3, 9, 11, 13, 18, 21])


@pytest.mark.slow
def test_gradient_through_the_papers_network():
    """Noise-free, as the paper trains it."""
    case = replace(case_of(2, n=2, K=6), truth=None)
    problem, episode, key = case.problem(), case.episode(), jax.random.key(0)
    settings = AttentionSettings(agent_widths=(4, 4), target_widths=(6, 4), out_widths=(5,), frame="world")
    shapes, rng = eqx.filter_eval_shape(lambda: settings.policy(problem, key)), np.random.default_rng(0)
    network = jax.tree.map(lambda x: jnp.asarray(rng.normal(0, 0.5, x.shape)), shapes)
    parameters, rest = eqx.partition(network, eqx.is_inexact_array)
    flat, unflatten = ravel_pytree(parameters)

    def total(flat):
        return jnp.sum(log_dets(problem, eqx.combine(unflatten(flat), rest), episode, SURROGATE, key)[-1])

    weights = np.array(flat)
    check_gradient(jax.jit(jax.value_and_grad(total)), weights, list(range(0, len(weights), 7)))
