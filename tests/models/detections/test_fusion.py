"""Fusion of the populations of two robots: who is who, and neither surer than it may be."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.crowds import draw
from helpers.worlds_of_detections import HALL
from scipy.stats import multivariate_normal

from foveate.models.detections import filter as pmb
from foveate.models.detections.fusion import fused, partners
from foveate.models.detections.records import Scan, Tracks
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.field_of_view import BallView

SETTINGS = DetectionSettings(
    low_m=(-10.0, -10.0), high_m=(10.0, 10.0), cells=(8, 8), probability=0.9, clutter=0.2, undetected=4.0, tracks=4,
    detections=4,
)  # fmt: skip
PROBLEM = replace(HALL, detections=None).problem()
MODEL = SETTINGS.model(PROBLEM)
ORIGIN = jnp.zeros(3)
UNSEEN = MODEL.first


def population(rows, undetected=UNSEEN):
    """Tracks of (x [m], y [m], variance [m^2], existence), in these slots; None leaves a slot empty."""
    n = MODEL.tracks
    existence, mean, covariance = np.zeros(n), np.zeros((n, 4)), np.tile(np.eye(4), (n, 1, 1))
    for i, row in enumerate(rows):
        if row is not None:
            mean[i, :2], covariance[i], existence[i] = row[:2], np.diag([row[2], row[2], 0.1, 0.1]), row[3]
    identity = np.where(existence > 0, np.arange(n), -1)
    tracks = Tracks(*map(jnp.asarray, (existence, mean, covariance, identity)))
    made = replace(pmb.start(PROBLEM, MODEL, ORIGIN), tracks=tracks, born=jnp.asarray(n))
    return replace(made, undetected=jnp.asarray(undetected))


@pytest.fixture(scope="module")
def fuse():
    return jax.jit(lambda own, other: fused(PROBLEM, MODEL, own, other, UNSEEN))


@pytest.fixture(scope="module")
def match():
    return jax.jit(lambda own, other: partners(PROBLEM, MODEL, own, other, UNSEEN))


FOUR = [(-5.0, 0.0, 0.1, 0.9), (5.0, 0.0, 0.2, 0.8), (0.0, 5.0, 0.1, 0.95), (0.0, -5.0, 0.3, 0.7)]


def test_equal_populations_stay_as_they_are(fuse):
    own = population(FOUR, 0.3 * UNSEEN)
    jax.tree.map(np.testing.assert_array_equal, fuse(own, own), own)


def test_swapped_slots_are_matched(fuse, match):
    order = [2, 0, 3, 1]
    own, other = population(FOUR), population([FOUR[i] for i in order])
    np.testing.assert_array_equal(np.asarray(order)[match(own, other)], np.arange(4))
    after = fuse(own, other)
    np.testing.assert_allclose(after.tracks.mean, own.tracks.mean, atol=1e-12)
    np.testing.assert_allclose(after.tracks.existence, own.tracks.existence, atol=1e-12)
    np.testing.assert_array_equal(after.tracks.identity, own.tracks.identity)


def test_a_pair_is_of_one_target_where_that_is_likelier_than_two(match):
    """Two standard deviations apart, by numpy: N(x_i - x_j; 0, P_i + P_j) against u_i(x_j) u_j(x_i) / u0."""
    density = float(UNSEEN.sum()) / 400.0  # per m^2, where neither robot has looked
    for variance, is_one in ((0.5, True), (8.0, False)):
        apart = 2.0 * np.sqrt(2.0 * variance)
        one = multivariate_normal.pdf([apart, 0.0], cov=2.0 * variance * np.eye(2))
        assert (one > density) == is_one
        pair = population([(-0.5 * apart, 0.0, variance, 0.9)]), population([None, (0.5 * apart, 0.0, variance, 0.9)])
        assert match(*pair)[0] == (1 if is_one else -1)
    # Where each robot would have seen the other's track, they are of one target.
    looked = population([(-0.5 * apart, 0.0, 8.0, 0.9)], 0.05 * UNSEEN)
    assert match(looked, replace(pair[1], undetected=0.05 * UNSEEN))[0] == 1
    far = population([(5.0, 0.0, 0.1, 0.9)]), population([(-5.0, 0.0, 0.1, 0.9)])
    assert match(*far)[0] == -1


def test_a_pair_is_fused_by_covariance_intersection(fuse):
    """Y = (1 - w) Y_1 + w Y_2 for some w, the mean by the same, and log odds of existence that w averages."""
    own, other = population([(0.0, 0.0, 0.1, 0.6)]), population([(0.3, 0.0, 0.4, 0.9)])
    velocity = jnp.diag(jnp.array([0.4, 0.4, 0.01, 0.01]))
    other = replace(other, tracks=replace(other.tracks, covariance=other.tracks.covariance.at[0].set(velocity)))
    after = fuse(own, other)
    (P, Q, R), (r, s, t) = (
        [np.asarray(getattr(each.tracks, name)[0]) for each in (own, other, after)]
        for name in ("covariance", "existence")
    )
    Y, Z = np.linalg.inv(P), np.linalg.inv(Q)
    weights = np.linspace(0.0, 1.0, 17)
    best = max(weights, key=lambda w: np.linalg.slogdet((1 - w) * Y + w * Z)[1])
    assert 0 < best < 1
    np.testing.assert_allclose(np.linalg.inv(R), (1 - best) * Y + best * Z, rtol=1e-9)
    step = R @ (best * Z @ np.asarray(other.tracks.mean[0] - own.tracks.mean[0]))
    np.testing.assert_allclose(after.tracks.mean[0] - own.tracks.mean[0], step, atol=1e-12)
    odds = [np.log(p / (1 - p)) for p in (r, s, t)]
    np.testing.assert_allclose(odds[2], (1 - best) * odds[0] + best * odds[1], rtol=1e-9)
    assert np.count_nonzero(after.tracks.existence) == 1


def test_a_track_of_the_other_enters_as_far_as_the_own_looks_allow(fuse):
    """Bayes: 0.8 is 4 to 1; where the own looks miss a target with probability 1/4, 1 to 1 is left."""
    other = population([(5.0, 0.0, 0.1, 0.8)], 0.1 * UNSEEN)
    for share, existence in ((1.0, 0.8), (0.25, 0.5), (1e-4, 0.0)):
        after = fuse(population([(-5.0, 0.0, 0.1, 0.9)], share * UNSEEN), other)
        np.testing.assert_allclose(after.tracks.existence[:2], [0.9, existence], atol=1e-9)
        assert after.tracks.identity[1] == (4 if existence else -1)
        assert after.overflow == 0
    np.testing.assert_allclose(after.undetected, 1e-4 * UNSEEN)
    np.testing.assert_allclose(fuse(population([], UNSEEN), other).undetected, 0.1 * UNSEEN)


def test_what_does_not_fit_returns_to_the_intensity_and_is_counted(fuse):
    after = fuse(population(FOUR), population([(8.0, 8.0, 0.1, 0.75)]))
    assert after.overflow == 1
    np.testing.assert_allclose(sorted(after.tracks.existence), [0.75, 0.8, 0.9, 0.95])
    np.testing.assert_allclose(after.undetected.sum(), UNSEEN.sum() + 0.7, rtol=1e-6)


def test_two_robots_that_each_tracked_one_target_alone_have_one_track_when_they_meet(fuse):
    """Forty runs of fifteen steps, each robot with its own scans: one track, no surer than either, and no worse."""
    settings = replace(SETTINGS, undetected=1.0, clutter=0.0, probability=0.95)
    scenario = replace(HALL, view=BallView(radius_m=30.0, center_m=(0.0, 0.0)), detections=None)
    problem, steps, runs = scenario.problem(), 15, 40
    model, poses = settings.model(problem), np.zeros((steps, 3))
    crowd = draw(problem, replace(settings, low_m=(-6.0, -6.0), high_m=(6.0, 6.0)), poses, runs, seed=3, slots=3)
    alone = crowd.alive.sum(axis=-1)[:, -1] == 1
    H, V = np.asarray(problem.sensor.H), np.asarray(problem.sensor.V)
    rng = np.random.default_rng(0)
    own_noise = rng.multivariate_normal(np.zeros(2), V, (2, *crowd.alive.shape))
    found = crowd.alive & (rng.uniform(size=(2, *crowd.alive.shape)) < settings.probability)
    z = np.pad(crowd.state @ H.T + own_noise, ((0, 0),) * 3 + ((0, 1), (0, 0)))
    valid = np.pad(found, ((0, 0),) * 3 + ((0, 1),))

    @jax.jit
    def run(z, valid):
        def step(own, scan):
            own = pmb.predict(problem, model, own, jnp.zeros((model.tracks, problem.motion.input_size)))
            return pmb.update(problem, model, own, ORIGIN, Scan(*scan)), None

        robots = jax.vmap(lambda *scans: jax.lax.scan(step, pmb.start(problem, model, ORIGIN), scans)[0])(z, valid)
        first, second = (jax.tree.map(lambda x, m=m: x[m], robots) for m in range(2))
        return first, second, fused(problem, model, first, second, model.first)

    first, second, both = jax.tree.map(np.asarray, jax.vmap(run, (1, 1))(jnp.asarray(z), jnp.asarray(valid)))
    assert alone.sum() >= 10
    numbers = (both.tracks.existence > 0.5).sum(axis=-1)
    np.testing.assert_array_equal(numbers[alone], 1)
    P, Q, R = (np.linalg.slogdet(each.tracks.covariance[alone, 0])[1] for each in (first, second, both))
    assert (np.minimum(P, Q) + 1e-9 >= R).all()
    best = np.max(
        [
            np.linalg.slogdet(
                np.linalg.inv(first.tracks.covariance[alone, 0]) * (1 - w)
                + w * np.linalg.inv(second.tracks.covariance[alone, 0])
            )[1]
            for w in np.linspace(0, 1, 17)
        ],
        axis=0,
    )
    np.testing.assert_allclose(-R, best, rtol=1e-6)
