"""Slots: the likeliest tracks stay, the others return to the intensity, and what does not fit is counted."""

import jax
import jax.numpy as jnp
import numpy as np

from foveate.models.detections import filter as pmb
from foveate.models.detections.records import Tracks
from foveate.models.detections.slots import merged
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.scenario import Scenario

PROBLEM = Scenario().problem()
MODEL = DetectionSettings(low_m=(0.0, 0.0), high_m=(8.0, 8.0), cells=(8, 8), tracks=3, recycle=0.1).model(PROBLEM)


def tracks(existence, x) -> Tracks:
    n = len(existence)
    mean = jnp.stack([jnp.asarray(x, float), jnp.full(n, 0.5)], axis=-1)
    return Tracks(jnp.asarray(existence, float), mean, 0.01 * jnp.broadcast_to(jnp.eye(2), (n, 2, 2)), jnp.arange(n))


def run(old, new):
    population = pmb.start(PROBLEM, MODEL, jnp.zeros(3), old)
    return jax.jit(lambda p, a, b: merged(PROBLEM, MODEL, p, a, b))(population, old, new)


def test_new_tracks_take_the_slots_of_the_weakest():
    found = run(tracks([0.9, 0.05, 0.5], [0.5, 1.5, 2.5]), tracks([0.3, 0.02], [3.5, 4.5]))
    np.testing.assert_allclose(found.tracks.existence, [0.9, 0.3, 0.5])
    np.testing.assert_array_equal(found.tracks.identity, [0, 3, 2])
    np.testing.assert_allclose(found.tracks.mean[:, 0], [0.5, 3.5, 2.5])
    assert (int(found.born), int(found.overflow)) == (4, 0)
    np.testing.assert_allclose(found.undetected[:, 0], [0, 0.05, 0, 0, 0.02, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(found.expected_number, 1.77)


def test_what_does_not_fit_is_counted_and_returns():
    found = run(tracks([0.9, 0.4, 0.5], [0.5, 1.5, 2.5]), tracks([0.45, 0.2], [3.5, 4.5]))
    np.testing.assert_allclose(found.tracks.existence, [0.9, 0.45, 0.5])
    assert int(found.overflow) == 2
    np.testing.assert_allclose(found.expected_number, 2.45)


def test_an_empty_slot_has_no_identity():
    found = run(tracks([0.05, 0.0, 0.5], [0.5, 1.5, 2.5]), tracks([0.0], [3.5]))
    np.testing.assert_array_equal(found.tracks.identity, [-1, -1, 2])
    np.testing.assert_array_equal(found.tracks.existence > 0, [False, False, True])
