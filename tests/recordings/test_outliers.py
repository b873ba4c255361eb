"""Recordings with wrong fixes, switched ids, long gaps: nothing of it fools the fit, and all of it is said."""

import numpy as np
import pytest
from helpers.recordings import recording, track, walk
from scipy.signal import lfilter

from foveate.recordings.fit import fit
from foveate.recordings.motion import fit_statistics
from foveate.recordings.outliers import clean, lines_of


def apart():
    """Two walkers whose ids are switched once, 25 m apart, at 10 s."""
    times = 0.25 * np.arange(81)
    a = np.stack([times - 20.0, 0 * times], axis=1)
    b = np.stack([20.0 - 0.4 * times, 0 * times + 12.0], axis=1)
    late = (times >= 10.0)[:, None]
    return recording(track(times, np.where(late, b, a), "a"), track(times, np.where(late, a, b), "b"))


def test_a_switch_of_ids_is_a_target_that_leaves_and_one_that_comes():
    made = apart()
    cleaned = clean(made)
    assert [piece.track_id for piece in cleaned.recording.tracks] == ["a", "a (2)", "b", "b (2)"]
    assert [len(piece.times_s) for piece in cleaned.recording.tracks] == [40, 41, 40, 41]
    assert all("at 10 s" in finding.text and "--max-speed" in finding.text for finding in cleaned.findings)
    fitted = fit(made)
    statistics = fitted.statistics
    assert 0.4 <= statistics.speed_median_m_s <= 1.0
    assert np.sqrt(np.trace(statistics.walk_covariance_m2)) < 0.5  # 3.6 m a step without the cut
    assert repr(fitted).count("jumps by") == 2
    kept = clean(made, 1.01 * 30 / 0.25)
    assert (len(kept.recording.tracks), kept.findings) == (2, ())


def test_a_switch_of_walkers_that_cross_is_found():
    times = 0.25 * np.arange(81)
    a = np.stack([0.5 * times - 5.0, 0 * times + 0.3], axis=1)
    late = (times >= 10.0)[:, None]
    made = recording(track(times, np.where(late, -a, a), "a"), track(times, np.where(late, a, -a), "b"))
    statistics = fit_statistics(made, 0.5)
    assert len([finding for finding in statistics.findings if finding.kind == "jump"]) == 2
    assert statistics.speed_median_m_s == pytest.approx(0.5)
    assert np.sqrt(statistics.walk_covariance_m2[1, 1]) < 0.01


def test_wrong_fixes_are_left_out_also_two_in_a_row():
    rng = np.random.default_rng(0)
    times = 0.2 * np.arange(300)
    positions = np.stack([times, np.sin(0.1 * times)], axis=1) + 0.02 * rng.normal(size=(300, 2))
    wrong = np.array([20, 90, 91, 200, 299])
    noisy = positions.copy()
    noisy[wrong] += [[8.0, 0], [0, 30.0], [-20.0, 5], [3.0, 3.0], [9.0, 0]]
    cleaned = clean(recording(track(times, noisy)))
    (piece,) = cleaned.recording.tracks
    np.testing.assert_array_equal(piece.times_s, np.delete(times, wrong))
    assert cleaned.spikes == 5
    assert (
        "5 fixes are out and back (the first at 4 s): left out; --max-speed inf keeps them" in cleaned.findings[0].text
    )
    whole = clean(recording(track(times, noisy)), np.inf)
    np.testing.assert_array_equal(whole.recording.tracks[0].positions_m, noisy)


def test_real_motion_is_not_taken_for_jumps():
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 4000.0)
    sprints = np.cumsum(np.where((times % 400) < 8, 5.0, 0.0))  # stands still, runs for 8 s
    hops = np.cumsum((rng.random(4000) < 0.05) * rng.uniform(10, 30, 4000))  # from perch to perch within a second
    irregular = np.sort(rng.uniform(0, 4000, 4000))
    made = [
        track(times, np.stack([sprints, 0 * times], axis=1), "sprinter"),
        track(times, walk(rng, times, np.eye(2)), "walk"),
        track(times, walk(rng, times, np.eye(1))[:, [0, 0]], "line"),
        track(irregular, walk(rng, irregular, np.eye(2)), "irregular"),
        track(times, np.round(0.05 * times)[:, None] * [1.0, 0.0], "rounded"),
    ]
    for each in made:
        cleaned = clean(recording(each))
        assert (cleaned.spikes, cleaned.findings) == (0, ()), each.track_id
        assert cleaned.recording.tracks == (each,)
    hopping = clean(recording(track(times, np.stack([hops, 0 * hops], axis=1))))
    assert len(hopping.recording.tracks) == 1
    assert "taken for motion, as they are many; --max-speed" in hopping.findings[0].text


def test_what_says_nothing_is_named_with_what_would_keep_it():
    fast, slow = 0.1 * np.arange(600), 5.0 * np.arange(13)
    made = recording(
        track(fast, np.stack([np.sin(0.2 * fast), 0.2 * fast], axis=1), "drone"),
        track(slow, np.stack([0.06 * slow, -0.04 * slow], axis=1), "collar"),
        track(fast, np.tile([3.0, 3.0], (600, 1)), "post"),
        track(fast, np.round(np.stack([0.3 * fast, 0 * fast], axis=1)), "rounded"),
        track([7.0], [[1.0, 2.0]], "once"),
    )
    said = {finding.track_id: finding for finding in fit_statistics(made, 0.5).findings}
    assert (said["collar"].kind, said["post"].kind, said["rounded"].kind) == ("gap", "still", "rounded")
    assert said["collar"].text.endswith("absent for 100% of its time, as --max-gap is 2 s; --max-gap 5.05 keeps it")
    assert "steps of 1 m" in said["rounded"].text
    assert "single fix at 7 s" in said["once"].text
    kept = fit_statistics(made, 0.5, max_gap_s=5.05).findings
    assert "collar" not in [finding.track_id for finding in kept]
    many = recording(*(track([float(i)], [[0.0, 0.0]], str(i)) for i in range(9)), made.tracks[0])
    assert "and 4 more of this kind" in lines_of(fit_statistics(many, 0.5).findings)[-1]


def test_a_fast_clock_does_not_set_the_moments_of_all():
    """Two targets for ten minutes each, at 10 Hz and at 0.2 Hz, that move at 0.5 and at 1.5 m/s."""
    fast, slow = 0.1 * np.arange(6001), 5.0 * np.arange(121)
    made = recording(track(fast, fast[:, None] * [0.5, 0.0], "a"), track(slow, slow[:, None] * [0.0, 1.5], "b"))
    found = fit_statistics(made, 0.5, max_gap_s=6.0)
    np.testing.assert_allclose(np.diag(found.walk_covariance_m2), 0.25 * np.array([0.25, 2.25]) / 2, rtol=0.02)


# Recovery of what made a recording, through outliers and switched ids


def spoiled(rng, tracks, share=0.05, switches=10):
    """Tracks with a share of wrong fixes, and with pairs of targets whose ids are switched for good."""
    places = [np.array(each.positions_m) for each in tracks]
    for _ in range(switches):
        i, j = rng.choice(len(tracks), 2, replace=False)
        k = rng.integers(20, len(places[i]) - 20)
        places[i][k:], places[j][k:] = places[j][k:].copy(), places[i][k:].copy()
    for each in places:
        wrong = rng.random(len(each)) < share
        each[wrong] += rng.normal(0, 20.0, (wrong.sum(), each.shape[1]))
    return recording(*(track(t.times_s, x, t.track_id) for t, x in zip(tracks, places, strict=True)))


@pytest.mark.parametrize("spoil", [False, True])
@pytest.mark.parametrize("noise_m", [0.0, 0.1])
def test_a_random_walk_is_recovered(noise_m, spoil):
    rng, times, W = np.random.default_rng(5), 0.25 * np.arange(1200), np.array([[0.3, 0.1], [0.1, 0.2]])
    tracks = [
        track(times, 100 * rng.normal(size=2) + walk(rng, times, W) + noise_m * rng.normal(size=(1200, 2)), str(i))
        for i in range(10)
    ]
    fitted = fit(spoiled(rng, tracks) if spoil else recording(*tracks), tau=0.5)
    found, target = fitted.statistics, fitted.experiment.scenario.target
    np.testing.assert_allclose(found.walk_covariance_m2, 0.5 * W, atol=0.2 * 0.5 * 0.3)
    assert found.fix_noise_std_m == pytest.approx(noise_m, rel=0.2, abs=0.03)
    assert found.is_walk
    # In a long time the scenario's targets go as far: memory^2 q t.
    far = target.memory_s**2 * np.array(target.Q)
    np.testing.assert_allclose(far, W, atol=0.2 * 0.3)


@pytest.mark.parametrize("spoil", [False, True])
@pytest.mark.parametrize("noise_m", [0.0, 0.1])
@pytest.mark.parametrize("memory_s", [8.0, 30.0])
def test_a_velocity_with_memory_is_recovered(memory_s, noise_m, spoil):
    rng, q, dt, count = np.random.default_rng(6), 0.2, 0.25, 2400
    times, decay = dt * np.arange(count), np.exp(-dt / memory_s)
    std = np.sqrt(q * memory_s / 2)
    kicks = std * np.sqrt(1 - decay**2) * rng.normal(size=(40, count, 2))
    kicks[:, 0] = std * rng.normal(size=(40, 2))
    v = lfilter([1.0], [1.0, -decay], kicks, axis=1)
    places = np.cumsum(0.5 * dt * (v[:, 1:] + v[:, :-1]), axis=1) + 200 * rng.normal(size=(40, 1, 2))
    places = np.concatenate([places[:, :1], places], axis=1) + noise_m * rng.normal(size=(40, count, 2))
    tracks = [track(times, each, str(i)) for i, each in enumerate(places)]
    fitted = fit(spoiled(rng, tracks) if spoil else recording(*tracks), tau=0.5)
    target = fitted.experiment.scenario.target
    np.testing.assert_allclose(np.diag(target.Q), q, rtol=0.2)
    assert target.memory_s == pytest.approx(memory_s, rel=0.2)
    assert fitted.statistics.fix_noise_std_m == pytest.approx(noise_m, rel=0.2, abs=0.03)
    assert not fitted.statistics.is_walk
