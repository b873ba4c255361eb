"""Replay against brute force: a plain loop over instants, tracks and geometry."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.recordings import ANGLE, DEPTH, TAU
from scipy.stats import chi2

from foveate.planning.named import heuristic_policy
from foveate.recordings.formats import load_recording
from foveate.recordings.replay import drive, prepare_replay
from foveate.recordings.starts import default_agent_start, random_agent_starts
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import LinearTarget, VelocityTarget


def inside(x: float, y: float) -> bool:
    """In the sector ahead of an agent at the origin that looks along x."""
    return math.hypot(x, y) <= DEPTH and abs(math.degrees(math.atan2(y, x))) <= ANGLE / 2


def test_a_still_agent_sees_the_targets_in_its_view(scenario, recording):
    # Without the gate: `a` walks straight on, as this scenario does not expect.
    ready = prepare_replay(scenario, recording, [0.0, 0.0, 0.0], 2.0, gate=None)
    row, trace = drive(ready, "still", heuristic_policy("still", ready.problem, DEPTH))

    position = {
        "a": lambda t: (-8 + t, 1.1),
        "b": lambda t: (-4.0, 0.0),
        "c": lambda t: (3.0, 3 - 0.2 * t),
        "d": lambda t: (5.0, -1.0 + 0.05 * t),
    }
    there = {"a": [(0, 20)], "b": [(0, 20)], "c": [(5, 12.5)], "d": [(0, 5), (10, 20)]}
    looks, seen, longest = [], 0, 0
    for name, spans in there.items():
        mine = []
        for first, last in spans:
            # A step counts where the target was there before it and after it.
            times = [TAU * k for k in range(1, 41) if first <= TAU * (k - 1) and TAU * k <= last]
            mine.append([inside(*position[name](t)) for t in times])
        run = 0
        for look in [look for span in mine for look in span]:
            run = 0 if look else run + 1
            longest = max(longest, run)
        looks += [look for span in mine for look in span]
        seen += any(look for span in mine for look in span)
    assert row.targets == 4
    assert row.seen_time_fraction == pytest.approx(np.mean(looks))
    assert row.seen_fraction == seen / 4
    assert row.longest_unseen_s == pytest.approx(TAU * longest)

    # Who was ever seen, and the errors of these and of the others, from what the trace and the recording say.
    slots, truth = ready.slots, ready.truth
    ids = [slots.track_ids[i] if i >= 0 else "" for i in slots.track_index.ravel()]
    names = np.array(ids).reshape(slots.track_index.shape)
    ever = {name for name in there if any(inside(*position[name](TAU * k)) for first, last in there[name]
            for k in range(1, 41) if first <= TAU * (k - 1) and TAU * k <= last)}  # fmt: skip
    squares, errors, steps = {True: [], False: []}, {True: [], False: []}, dict.fromkeys(there, 0)
    for k, column in zip(*np.nonzero(names[1:] != ""), strict=True):
        name = names[k + 1, column]
        if names[k, column] == name:
            error = trace.mean[k + 1, column] - truth[k + 1, column]
            squares[name in ever].append(error @ error)
            errors[name in ever].append(error @ trace.information[k + 1, column] @ error)
            steps[name] += 1
    assert row.rmse_seen_m == pytest.approx(math.sqrt(np.mean(squares[True])))
    assert row.rmse_unseen_m == pytest.approx(math.sqrt(np.mean(squares[False])))
    assert row.nees_seen == pytest.approx(np.mean(errors[True]))
    assert row.nees_unseen == pytest.approx(np.mean(errors[False]))
    weights = np.array(list(steps.values())) / sum(steps.values())
    count = 1 / np.sum(weights**2)
    np.testing.assert_allclose(row.nees_band, np.array(chi2.interval(0.95, 2 * count)) / count, rtol=0.05)


def test_a_target_that_walks_away_unseen_is_lost(scenario, recording):
    ready = prepare_replay(scenario, recording, [0.0, -50.0, -1.5], 2.0)
    row, trace = drive(ready, "still", heuristic_policy("still", ready.problem, DEPTH))
    assert row.seen_time_fraction == 0.0
    # Only a moves further than the depth of the view from where it was first believed to be.
    assert row.lost == 1
    assert row.longest_unseen_s == 20.0
    # Nothing seen: log det falls as that of a random walk with the prior's variance at its start.
    first = np.flatnonzero(ready.slots.track_ids == np.array("a"))[0]
    column = int(np.argmax(ready.slots.track_index[0] == first))
    variance = 2.0 + 0.25 * np.arange(1, 41)
    np.testing.assert_allclose(trace.log_det[:, column], -2 * np.log(variance), rtol=1e-9)


def test_a_belief_restarts_when_its_target_appears(scenario, recording):
    errors = []
    for seed in range(25):
        ready = prepare_replay(scenario, recording, [0.0, -50.0, -1.5], 2.0, seed=seed)
        _, trace = drive(ready, "still", heuristic_policy("still", ready.problem, DEPTH))
        index = ready.slots.track_index
        begins = (index[1:] >= 0) & (index[1:] != index[:-1])
        assert begins.sum() >= 2  # c, and d after its gap
        np.testing.assert_allclose(trace.information[1:][begins], np.eye(2) / 2.0 * np.ones((begins.sum(), 1, 1)))
        errors.append(trace.mean[1:][begins] - ready.truth[1:][begins])
    # The prior's standard deviation is sqrt(2): the mean square of n errors over 2 is chi-square(n) / n.
    squares = np.square(errors).ravel() / 2.0
    low, high = np.array(chi2.interval(0.999, len(squares))) / len(squares)
    assert low < squares.mean() < high


@pytest.mark.parametrize("choice", [None, "zero", "truth"])
def test_a_belief_begins_at_rest_unless_the_truth_is_asked_for(scenario, recording, choice):
    """Also that of a target which is there from the start: nobody has seen it move."""
    target = VelocityTarget(kind="constant_velocity", initial_velocity_variance_m2_s2=0.04)
    scenes = replace(scenario.scenes, first_mean_velocity=choice)
    moving = replace(scenario, target=target, scenes=scenes)
    errors = []
    for seed in range(25):
        ready = prepare_replay(moving, recording, [0.0, -50.0, -1.5], 2.0, seed=seed)
        index, arrivals = ready.slots.track_index, ready.episode.arrivals
        np.testing.assert_array_equal(ready.episode.mean, arrivals.mean[0])
        begins = (index >= 0) & (np.concatenate([np.full_like(index[:1], -1), index[:-1]]) != index)
        mean = np.asarray(arrivals.mean)[begins]
        errors.append(mean[:, 2:] - ready.truth[begins][:, 2:])
        if choice != "truth":
            np.testing.assert_array_equal(mean[:, 2:], 0)
    if choice == "truth":
        squares = np.square(errors).ravel() / 0.04
        low, high = np.array(chi2.interval(0.999, len(squares))) / len(squares)
        assert low < squares.mean() < high


def test_methods_get_the_same_noise_and_seeds_differ(scenario, recording):
    one = prepare_replay(scenario, recording, [0.0, 0.0, 0.0], 2.0, seed=1)
    same = prepare_replay(scenario, recording, [0.0, 0.0, 0.0], 2.0, seed=1)
    other = prepare_replay(scenario, recording, [0.0, 0.0, 0.0], 2.0, seed=2)
    assert jnp.array_equal(one.episode.truth.measurement_noise, same.episode.truth.measurement_noise)
    assert not jnp.array_equal(one.episode.truth.measurement_noise, other.episode.truth.measurement_noise)


def test_starts(scenario, recording):
    np.testing.assert_allclose(default_agent_start(recording, scenario), [2.0, 1.0, 0.0], atol=0.6)
    lower, upper = recording.extent
    starts = np.array(random_agent_starts(recording, scenario, 50, seed=3))
    assert ((starts[:, :2] >= lower) & (starts[:, :2] <= upper)).all()
    assert np.ptp(starts[:, 2]) > 5.0


def test_states_must_begin_with_the_position(scenario, tmp_path):
    """Recorded positions would be taken for the velocities of a state that has them first."""
    path = tmp_path / "walk.csv"
    path.write_text("time_s,track_id,x_m,y_m\n0,a,1,2\n1,a,3,4\n")
    eye, nothing = np.eye(2), np.zeros((2, 2))
    backwards = LinearTarget(
        kind="linear",
        A=tuple(map(tuple, np.block([[eye, nothing], [0.5 * eye, eye]]).tolist())),
        B=tuple(map(tuple, np.eye(4, 2).tolist())),
        W=tuple(map(tuple, (0.1 * np.eye(4)).tolist())),
        Z=tuple(map(tuple, np.eye(4)[2:].tolist())),
        prior=tuple(map(tuple, np.eye(4).tolist())),
    )
    scenes = replace(scenario.scenes, drift_m_s=(0.0, 0.0))
    with pytest.raises(ValueError, match=r"Z = \[I 0\]"):
        prepare_replay(replace(scenario, target=backwards, scenes=scenes), load_recording(path), [0.0, 0.0, 0.0])


def test_dimensions_must_agree(scenario, tmp_path):
    path = tmp_path / "space.csv"
    path.write_text("time_s,track_id,x_m,y_m,z_m\n0,a,0,0,0\n1,a,0,0,1\n")
    with pytest.raises(ValueError, match="positions have 3 numbers"):
        prepare_replay(scenario, load_recording(path), [0.0, 0.0, 0.0])


def test_a_sensor_of_ranges_and_bearings_sees_the_same_and_errs_as_it_measures(scenario, recording):
    """By geometry: right after a look, range and bearing of the estimate are within 5 deviations of the truth's."""
    own = SensorSettings(measures="range-bearing", std_range_m=0.05, std_bearing_rad=0.01)
    ready = [
        prepare_replay(replace(scenario, sensor=sensor), recording, [0.0, 0.0, 0.0], 2.0, gate=None)
        for sensor in (scenario.sensor, own)
    ]
    still = [heuristic_policy("still", each.problem, DEPTH) for each in ready]
    (_, expected), (row, trace) = (drive(each, "still", policy) for each, policy in zip(ready, still, strict=True))
    np.testing.assert_array_equal(trace.visible, expected.visible)
    seen = np.asarray(trace.visible)
    assert seen.sum() > 20
    estimate, truth = (np.asarray(x)[1:][seen][:, :2] for x in (trace.mean, ready[1].truth))
    ranges, bearings = (np.stack([f(x) for x in (estimate, truth)]) for f in (norms, angles))
    assert np.abs(np.diff(ranges, axis=0)).max() < 5 * 0.05
    assert np.abs(np.diff(bearings, axis=0)).max() < 5 * 0.01
    assert row.nees_seen < 6


def norms(places: np.ndarray) -> np.ndarray:
    return np.hypot(*places.T)


def angles(places: np.ndarray) -> np.ndarray:
    return np.arctan2(places[:, 1], places[:, 0])
