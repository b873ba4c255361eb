"""Measures of episodes without ids, by hand: GOSPA, what was seen of each life, errors of confirmed tracks."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.worlds_of_detections import HALL

from foveate.errors import InputError
from foveate.evaluation.detections import detection_measures, lives, member_measures, protocols_in, require_ids
from foveate.evaluation.rows import Row
from foveate.evaluation.summary import summarise
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Trace
from foveate.simulation.team.records import TeamTrace

PROBLEM = HALL.problem()
SCENE = Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((0.0, 0.0),), horizon=2)
ROOT_HALF = np.sqrt(0.5)


@pytest.fixture
def episode():
    """Two steps, three slots of tracks, two places of targets; c = 4 m (half the depth); then a step of padding.

    Step 1: one target at 0, a confirmed track 1 m off, a tentative one. Step 2: another target at (9, 9) as well, the
    track 2 m off, and a false track.
    """
    mean, existence = np.zeros((1, 4, 3, 4)), np.zeros((1, 4, 3))
    mean[0, 1:, 0, 0], mean[0, 1:, 1, :2] = [1.0, 2.0, 7.0], [-8.0, 0.0]
    existence[0, 1:, 0], existence[0, 1:, 1] = 0.9, [0.4, 0.6, 0.9]
    truth, alive = np.zeros((1, 4, 2, 4)), np.zeros((1, 4, 2), bool)
    alive[0, :, 0], alive[0, 2:, 1], truth[0, 2:, 1, :2] = True, True, 9.0
    visible = np.zeros((1, 3, 2), bool)
    visible[0, 0, 0], visible[0, 2] = True, True
    shapes = {"pose": np.zeros((1, 4, 3)), "action": np.zeros((1, 3, 2)), "log_det": np.zeros((1, 3, 3))}
    information = np.broadcast_to(4.0 * np.eye(4), (1, 4, 3, 4, 4))
    parts = {
        "mean": mean,
        "existence": existence,
        "confirmed": existence > 0.5,
        "visible": visible,
        "information": information,
        **shapes,
    }
    dropped = np.array([[0, 3, 5]])
    arrays = {name: jnp.asarray(part) for name, part in {**parts, "dropped": dropped}.items()}
    # One episode at a time: the annotations of a trace are those of one.
    one = Trace(present=arrays["existence"][0] > 0.1, **{name: part[0] for name, part in arrays.items()})
    trace = replace(one)
    for name, part in {**parts, "dropped": dropped}.items():
        object.__setattr__(trace, name, part)
    return trace, truth, alive


def test_gospa_and_its_parts_are_means_over_the_steps(episode):
    row = detection_measures(PROBLEM, *episode, [SCENE], "gospa")[0]
    second = np.sqrt(4.0 + 8.0 + 8.0)
    np.testing.assert_allclose(row["gospa"], (1.0 + second) / 2)
    np.testing.assert_allclose(row["gospa_localisation"], (1.0 + 2.0) / 2)
    np.testing.assert_allclose([row["gospa_missed"], row["gospa_false"]], np.sqrt(8.0) / 2)
    assert row["score"] == row["objective"] == -row["gospa"]
    assert detection_measures(PROBLEM, *episode, [SCENE], "mean")[0]["objective"] is None


def test_what_was_seen_is_of_lives_up_to_the_horizon(episode):
    """One of two targets was detected, in one of three steps of targets; each was unseen for a step."""
    row = detection_measures(PROBLEM, *episode, [SCENE])[0]
    assert (row["seen_fraction"], row["longest_unseen_s"], row["dropped"]) == (0.5, 1.0, 3)
    np.testing.assert_allclose(row["seen_step_fraction"], 1 / 3)


def test_errors_are_of_confirmed_tracks_and_their_targets(episode):
    row = detection_measures(PROBLEM, *episode, [SCENE])[0]
    np.testing.assert_allclose([row["rmse_m"], row["nees"]], [2.0, 16.0])


def test_the_worst_robot_of_a_team_is_by_its_own_tracks(episode):
    """The first robot reports what the episode's filter does, the second nothing: it misses one target, then two."""
    trace, truth, alive = episode
    parts = (np.asarray(part)[0, 1:] for part in (trace.mean, trace.information, trace.confirmed))
    mean, information, confirmed = (jnp.asarray(np.stack([part, part], axis=1)) for part in parts)
    steps, robots = confirmed.shape[:2]
    shapes = jnp.zeros((steps + 1, robots, 3)), jnp.zeros((steps, robots, 2)), jnp.zeros((steps, robots, 3))
    visible, heard = jnp.zeros((steps, robots, 2), bool), jnp.zeros((steps, robots, robots), bool)
    own = {"mean": mean, "information": information, "confirmed": confirmed.at[:, 1].set(False)}
    team = jax.tree.map(lambda x: np.asarray(x)[None], TeamTrace(*shapes, None, visible, heard, **own))
    (row,) = member_measures(PROBLEM, team, truth, alive, [SCENE], "gospa")
    worst = -(np.sqrt(8.0) + 4.0) / 2
    assert row == {"agents": 2, "worst_score": worst, "worst_objective": worst, "members_nees": 16.0}
    assert member_measures(PROBLEM, None, truth, alive, [SCENE]) == [{}]


def test_without_a_confirmed_track_there_is_no_error_but_in_a_file_whose_format_has_numbers(episode):
    trace, truth, alive = episode
    object.__setattr__(trace, "confirmed", np.zeros_like(trace.confirmed))
    row = detection_measures(PROBLEM, trace, truth, alive, [SCENE])[0]
    assert (row["rmse_m"], row["nees"], row["gospa_false"], row["gospa_localisation"]) == (None, None, 0.0, 0.0)
    others = {"scene": "a", "episode": 0, "seed": 0, "method": "still", "protocol": "true", "motion": "unbiased"}
    known = Row(**others, targets=1, step_time_s=1.0, **row)
    cell = summarise([known, replace(known, rmse_m=2.0, nees=16.0)], 4)[0]
    assert (cell.rmse_m, cell.nees) == (2.0, 16.0)
    assert (summarise([known], 4)[0].nees, known.record()["nees"]) == (None, 0.0)


def test_lives_follow_one_another_in_a_place():
    alive = np.array([[1, 0], [1, 1], [0, 1], [1, 0]], bool)
    assert list(lives(alive)) == [(0, 0, 2), (0, 3, 4), (1, 1, 3)]


def test_without_ids_only_the_true_protocol_exists():
    assert protocols_in(HALL, ("surrogate", "true")) == ("true",)
    assert protocols_in(replace(HALL, detections=None), ("surrogate",)) == ("surrogate",)
    with pytest.raises(InputError, match="protocol 'surrogate': expected true: detections without ids have no soft"):
        protocols_in(HALL, ("surrogate",))
    with pytest.raises(InputError, match=r"omniscient: expected none with scenario\.detections"):
        require_ids(HALL, "omniscient")
