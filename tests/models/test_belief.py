"""The information filter against a textbook covariance filter, filterpy's, and scipy's Gaussian."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.stats import multivariate_normal

from foveate.models.belief import Belief, correct_mean, entropy, predict_information, update_information
from foveate.models.target import LinearGaussian
from foveate.scenario.target import integrators

SHAPES = [(1, 1, 1), (2, 1, 2), (3, 3, 1), (4, 2, 2), (5, 4, 3), (6, 3, 1)]
"""n_y, n_z, m_y."""


def covariance(rng, size, scale=1.0):
    root = rng.normal(size=(size, size))
    return scale * (root @ root.T + 0.2 * np.eye(size))


class System:
    """Random full matrices; A has spectral radius about 0.95, so that 50 steps stay in range.

    `kind` "reversible": A is upper triangular, and one axis has no process noise.
    """

    def __init__(self, n_y, n_z, m_y, kind="full"):
        rng = np.random.default_rng([n_y, n_z, m_y])
        A = rng.normal(size=(n_y, n_y))
        self.A = A * 0.95 / np.abs(np.linalg.eigvals(A)).max()
        if kind == "reversible":
            self.A = np.triu(0.3 * A, 1) + np.diag(rng.uniform(0.5, 1.0, n_y))
        if kind == "singular":
            left, values, right = np.linalg.svd(self.A)
            values[-1] = 0.0
            self.A = (left * values) @ right
        self.B, self.H = rng.normal(size=(n_y, m_y)), rng.normal(size=(n_z, n_y))
        self.W, self.V, self.prior = covariance(rng, n_y, 0.1), covariance(rng, n_z, 0.5), covariance(rng, n_y, 2.0)
        if kind == "reversible":
            self.W[-1] = self.W[:, -1] = 0.0
        self.mean = rng.normal(size=n_y)
        self.inputs = rng.normal(size=(50, m_y))
        self.measurements = rng.normal(size=(50, n_z)) * 3
        self.visible = rng.random(50) < 0.4

    @property
    def motion(self):
        return LinearGaussian.of(self.A, self.B, self.W, np.eye(1, len(self.A)))

    def information_filter(self):
        """Means and covariances by foveate after each of 50 steps."""
        motion, H, V = self.motion, jnp.asarray(self.H), jnp.asarray(self.V)
        gain = jnp.asarray(self.H.T @ np.linalg.solve(self.V, self.H))

        def step(belief, now):
            known_input, measurement, visible = now
            predicted = Belief(
                motion.advance(belief.mean, known_input), predict_information(belief.information, motion)
            )
            mean = jnp.where(visible, correct_mean(predicted, measurement, H, V), predicted.mean)
            information = update_information(predicted.information, gain, visible.astype(float))
            after = Belief(mean, information)
            return after, after

        first = Belief(jnp.asarray(self.mean), jnp.asarray(np.linalg.inv(self.prior)))
        now = (jnp.asarray(self.inputs), jnp.asarray(self.measurements), jnp.asarray(self.visible))
        beliefs = jax.jit(lambda: jax.lax.scan(step, first, now)[1])()
        return np.asarray(beliefs.mean), np.linalg.inv(beliefs.information)

    def textbook(self):
        """Kalman (1960) in covariance form with Joseph's update."""
        mean, P, means, covariances = self.mean, self.prior, [], []
        for xi, z, visible in zip(self.inputs, self.measurements, self.visible, strict=True):
            mean, P = self.A @ mean + self.B @ xi, self.A @ P @ self.A.T + self.W
            if visible:
                K = P @ self.H.T @ np.linalg.inv(self.H @ P @ self.H.T + self.V)
                rest = np.eye(len(P)) - K @ self.H
                mean, P = mean + K @ (z - self.H @ mean), rest @ P @ rest.T + K @ self.V @ K.T
            means.append(mean)
            covariances.append(P)
        return np.array(means), np.array(covariances)

    def filterpy(self):
        other = KalmanFilter(dim_x=len(self.A), dim_z=len(self.H), dim_u=self.B.shape[1])
        other.x, other.P = self.mean[:, None].copy(), self.prior.copy()
        other.F, other.B, other.H, other.Q, other.R = self.A, self.B, self.H, self.W, self.V
        means, covariances = [], []
        for xi, z, visible in zip(self.inputs, self.measurements, self.visible, strict=True):
            other.predict(u=xi[:, None])
            if visible:
                other.update(z[:, None])
            means.append(other.x[:, 0].copy())
            covariances.append(other.P.copy())
        return np.array(means), np.array(covariances)


@pytest.mark.parametrize("kind", ["full", "reversible"])
@pytest.mark.parametrize("shape", [*SHAPES, (9, 3, 3)])
def test_equals_covariance_form_filters(shape, kind):
    system = System(*shape, kind)
    assert system.motion.is_reversible == (kind == "reversible" and shape[0] > 1)
    assert 5 < system.visible.sum() < 45
    means, covariances = system.information_filter()
    for oracle in (system.textbook, system.filterpy):
        expected_means, expected_covariances = oracle()
        np.testing.assert_allclose(means, expected_means, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(covariances, expected_covariances, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("shape", [(2, 1, 2), (4, 2, 2)])
def test_singular_motion(shape):
    """The paper's printed form needs A^-1; W makes up for what A loses."""
    system = System(*shape, "singular")
    assert np.linalg.matrix_rank(system.A) == shape[0] - 1
    means, covariances = system.information_filter()
    expected_means, expected_covariances = system.textbook()
    np.testing.assert_allclose(means, expected_means, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(covariances, expected_covariances, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("kind", ["full", "reversible"])
@pytest.mark.parametrize("part", ["information", "A", "W"])
def test_derivatives_of_the_prediction_by_central_differences(kind, part):
    system, rng = System(4, 2, 2, kind), np.random.default_rng(0)
    information, motion, h = jnp.linalg.inv(jnp.asarray(system.prior)), system.motion, 1e-6
    motion = replace(motion, W=motion.W + 0.1 * jnp.eye(4))
    direction = np.triu(rng.normal(size=(4, 4)))
    direction = direction if part == "A" else direction + direction.T

    def predicted(x):
        if part == "information":
            return predict_information(information + x * direction, motion)
        return predict_information(information, replace(motion, **{part: getattr(motion, part) + x * direction}))

    found = jax.jit(lambda x: jax.jvp(predicted, (x,), (1.0,))[1])(0.0)
    values = jax.jit(predicted)
    np.testing.assert_allclose(found, (values(h) - values(-h)) / (2 * h), rtol=1e-6, atol=1e-8)


def long_run(motion, gain, prior, pattern):
    """Information matrices after 10,000 steps of each pattern, in float32; also the worst asymmetry on the way."""

    def step(information, visible):
        ahead = jax.vmap(predict_information, (0, None))(information, motion)
        after = jax.vmap(update_information, (0, None, 0))(ahead, gain, visible)
        worst = jnp.max(jnp.abs(after - jnp.swapaxes(after, 1, 2)) / jnp.abs(after).max())
        return after, (worst, jnp.linalg.eigvalsh(after)[:, 0])

    first = jnp.broadcast_to(prior, (pattern.shape[1], *prior.shape))
    return jax.jit(lambda: jax.lax.scan(step, first, pattern))()


@pytest.mark.parametrize("n_y", [2, 4, 6, 9])
def test_ten_thousand_steps_in_float32(n_y):
    """Never seen, always seen, seen at random: symmetric and positive definite all along, and the right values.

    n_y = 2: the paper's numbers. Else positions with velocities (4 in the plane, 6 in space) and accelerations (9),
    which couple, in steps of 0.1 s; velocities fade by 1 % a step, accelerations by 10 %, to stay in range.
    """
    d, order = (2, n_y // 2) if n_y <= 4 else (3, n_y // 3)
    eye = np.eye(d)
    A, W = (eye, 0.05**2 * eye)
    if order > 1:
        fading = np.array([1.0, 0.99, 0.9])[:order]
        a, _, w, _ = integrators(order, 0.1, 0.3 * np.eye(1))
        A, W = np.kron(a * fading[:, None], eye), np.kron(w, eye)
    H = np.eye(d, n_y)
    gain, prior = H.T @ H / 0.2**2, 0.5 * np.eye(n_y)
    seen = np.random.default_rng(0).random(10_000) < 0.1
    pattern = np.stack([np.zeros(10_000), np.ones(10_000), seen], axis=1)

    gain32, prior32, pattern32 = (jnp.asarray(x, jnp.float32) for x in (gain, prior, pattern))
    motion = jax.tree.map(lambda x: x.astype(jnp.float32), LinearGaussian.of(A, np.zeros((n_y, 1)), W, H))
    last, (asymmetry, smallest) = long_run(motion, gain32, prior32, pattern32)
    assert last.dtype == np.float32
    assert asymmetry.max() < 1e-6
    assert (np.asarray(smallest) > 0).all()

    for k in range(3):  # the same in covariance form and float64
        P = np.linalg.inv(prior)
        for visible in pattern[:, k]:
            P = A @ P @ A.T + W
            if visible:
                P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + 0.2**2 * eye, H @ P)
        np.testing.assert_allclose(np.linalg.inv(np.asarray(last[k], float)), P, rtol=5e-3, atol=1e-4 * P.max())


@pytest.mark.parametrize("n_y", [1, 2, 5])
def test_entropy(n_y):
    rng = np.random.default_rng(n_y)
    P = covariance(rng, n_y)
    log_det = -np.linalg.slogdet(P)[1]
    expected = multivariate_normal(np.zeros(n_y), P).entropy()
    assert entropy(log_det, n_y) == pytest.approx(expected, abs=1e-10)
