"""Replays with detections without ids, against geometry, the binomial distribution, and sums over all pairings."""

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.contract import faults
from helpers.recordings import ANGLE, DEPTH, TAU
from scipy.stats import binom

import foveate
from foveate.errors import InputError
from foveate.io.tables import text
from foveate.planning.named import heuristic_policy
from foveate.recordings.recording import resample
from foveate.recordings.replay import drive, prepare_replay
from foveate.recordings.scans import detecting, outside
from foveate.scenario.detections import BirthSettings, DetectionSettings

PROBABILITY, CLUTTER, CUTOFF = 0.7, 0.5, DEPTH / 2


@pytest.fixture(scope="module")
def result(scenario, recording):
    """A still robot in a scenario that knew ids: as `foveate replay --detection-probability 0.7 --clutter 0.5`."""
    still = heuristic_policy("still", scenario.problem(), DEPTH)
    options = {"detection_probability": PROBABILITY, "clutter": CLUTTER, "agent_start": [0.0, 0.0, 0.0]}
    return foveate.replay(still, recording, scenario=scenario, method="still", max_gap=2.0, progress=False, **options)


def test_targets_in_view_are_detected_with_their_probability(result):
    """In view by geometry; the number of detections is binomial."""
    ready, trace = result.traces["still"]
    x, y = np.moveaxis(ready.slots.positions_m[1:], -1, 0)
    inside = (np.hypot(x, y) <= DEPTH) & (np.abs(np.degrees(np.arctan2(y, x))) <= ANGLE / 2) & ready.slots.present[1:]
    assert not (trace.visible & ~inside).any()
    low, high = binom.interval(0.999, inside.sum(), PROBABILITY)
    assert inside.sum() > 50
    assert low <= trace.visible.sum() <= high
    index = ready.slots.track_index
    counted = (index[1:] >= 0) & (index[1:] == index[:-1])
    assert result.rows[0].seen_time_fraction == pytest.approx(trace.visible[counted].mean())


def test_gospa_is_that_of_all_pairings_of_confirmed_tracks(result):
    ready, trace = result.traces["still"]
    row, squares = result.rows[0], []
    for k in range(1, len(trace.mean)):
        tracks = trace.mean[k, trace.confirmed[k]]
        targets = ready.slots.positions_m[k, ready.slots.present[k]]
        few, many = sorted((tracks, targets), key=len)
        alone = CUTOFF**2 / 2
        best = min(
            sum(min(((a - many[j]) ** 2).sum(), 2 * alone) for a, j in zip(few, chosen, strict=True))
            for chosen in itertools.permutations(range(len(many)), len(few))
        )
        squares.append(best + alone * (len(many) - len(few)))
    assert row.gospa == pytest.approx(np.sqrt(squares).mean(), rel=1e-5)
    assert 0 < row.rmse_m < CUTOFF
    assert row.gospa_false > 0
    assert row.gospa_missed > 0


def test_confirmed_are_the_tracks_that_exist_and_are_located(result):
    _, trace = result.traces["still"]
    covariance = np.linalg.inv(np.asarray(trace.information, float))[..., :2, :2]
    q = np.trace(covariance, axis1=-2, axis2=-1) / CUTOFF**2
    value = np.asarray(trace.existence) * (1 - q * (1 - np.exp(-1 / q)))
    clear = abs(value - 0.5) > 1e-3
    np.testing.assert_array_equal(np.asarray(trace.confirmed)[clear], value[clear] > 0.5)
    assert 0 < trace.confirmed.sum() < (np.asarray(trace.existence) > 0.5).sum()


def test_false_alarms_are_poisson_and_the_noise_of_measurements_is_that_with_ids(result, scenario, recording):
    ready, _ = result.traces["still"]
    with_ids = prepare_replay(scenario, recording, [0.0, 0.0, 0.0], 2.0)
    np.testing.assert_array_equal(ready.episode.truth.measurement_noise, with_ids.episode.truth.measurement_noise)
    scans = ready.episode.scans
    mean, steps = np.asarray(scans.is_false).sum() / 40, 40
    assert abs(mean - CLUTTER) < 4 * math.sqrt(CLUTTER / steps)
    points = np.asarray(scans.clutter_body)[np.asarray(scans.is_false)]
    assert (np.hypot(*points.T) <= DEPTH + 1e-6).all()


def test_rates_are_those_of_the_recording(scenario, recording):
    """By hand: c and d appear within 20 s, c and d leave once each, a and b stay."""
    made = detecting(scenario, recording, 2.0, clutter=CLUTTER)
    settings, present = made.detections, resample(recording, TAU, 2.0).present
    assert (settings.probability, settings.known, settings.births[0].rate) == (0.9, False, pytest.approx(2.5 / 40))
    assert settings.survival == pytest.approx(1 - 2.5 / (present[:-1].sum() + 1))
    lower, upper = recording.extent
    np.testing.assert_allclose(settings.births[0].low_m, lower)
    np.testing.assert_allclose(settings.high_m, upper + DEPTH)
    assert float(made.problem().detections.first.sum()) == pytest.approx(round(present.sum(axis=1).mean()), rel=1e-5)


def test_settings_of_a_scenario_stay_but_for_the_two_numbers(scenario, recording):
    own = DetectionSettings(low_m=(-9.0, -9.0), high_m=(13.0, 9.0), probability=0.8, births=(BirthSettings(rate=0.1),))
    scenes = replace(scenario.scenes, birth_and_death=False)
    world = replace(scenario, scenes=scenes, detections=own)
    assert detecting(world, recording, 2.0) == world
    assert detecting(world, recording, 2.0, clutter=1.0).detections == replace(own, clutter=1.0)
    assert detecting(scenario, recording, 2.0) is scenario
    narrow = replace(world, detections=replace(own, high_m=(4.0, 9.0)))
    slots = resample(recording, TAU, 2.0)
    share = (slots.positions_m[slots.present][:, 0] > 4.0).mean()
    assert outside(world, slots) == []
    assert outside(narrow, slots)[0].startswith(f"{share:.0%} of the target time is outside")
    # Those of the first instant are known by default: a track each, before the first look.
    unknown = detecting(scenario, recording, 2.0, clutter=1.0)
    for each, known in ((world, 3), (unknown, 0)):
        assert int(prepare_replay(each, recording, [0.0, 0.0, 0.0], 2.0).episode.present.sum()) == known


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"probability": 0.0}, "detections.probability = 0.0: expected a probability above 0, up to 1"),
        ({"probability": 1.5}, "detections.probability = 1.5: expected a probability above 0, up to 1"),
        ({"probability": math.nan}, "detections.probability = nan: expected a finite number"),
        ({"clutter": -1.0}, "detections.clutter = -1.0: expected >= 0"),
        ({"clutter": 1e4}, "detections.detections = 16: expected more than clutter 10000, "),
        ({"clutter": 1.0, "gate": None}, "gate = None: expected a probability, with detections without ids"),
    ],
)
def test_wrong_numbers_are_named(scenario, recording, numbers, message):
    with pytest.raises(InputError, match="^" + re.escape(message)):
        detecting(scenario, recording, 2.0, **numbers)


def test_too_few_tracks_for_the_recording_are_named(scenario, recording):
    own = DetectionSettings(low_m=(-9.0, -9.0), high_m=(9.0, 9.0), tracks=3)
    with pytest.raises(InputError, match=r"^detections\.tracks = 3: expected at least 4, the most targets at once"):
        detecting(replace(scenario, detections=own), recording, 2.0)


def test_without_a_paired_track_errors_are_null_and_the_file_keeps_its_contract(result, scenario, recording, tmp_path):
    """A robot that looks away: no error is measured, and none is 0. `nees` of others is a number."""
    world = detecting(scenario, recording, 2.0, probability=PROBABILITY, clutter=CLUTTER)
    ready = prepare_replay(world, recording, [0.0, 60.0, 1.5], 2.0)
    row, _ = drive(ready, "still", heuristic_policy("still", ready.problem, DEPTH))
    assert (row.rmse_m, row.nees, row.nees_band, row.log_det_mean) == (None, None, None, None)
    assert row.lost == row.targets == 4
    replace(result, rows=(*result.rows, row)).to_json(tmp_path / "replay.json")
    assert faults("replay", tmp_path / "replay.json") == []
    assert "GOSPA [m]" in text(result.table)
