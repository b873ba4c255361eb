"""Parts of a recording, and the choice among policies by one of them; against sums by hand and the shipped planners."""

import json
import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compilation import time_no_decision
from helpers.recordings import recording as made
from helpers.recordings import track

import foveate
from foveate.errors import InputError
from foveate.evaluation.plan import online_planner
from foveate.evaluation.planners import planner
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import NamedPolicy
from foveate.names import METHODS
from foveate.planning.named import heuristic_policy
from foveate.planning.shooting import ONLINE, PUBLISHED, refining
from foveate.recordings.methods import replay_methods
from foveate.recordings.recording import window
from foveate.recordings.split import parsed_split, part_of, span_of

TIMES = np.arange(0.0, 101.0)


def fixes(recording):
    return {(each.track_id, time) for each in recording.tracks for time in each.times_s}


@pytest.mark.parametrize("origin_s", [0, 1_760_000_000])
def test_parts_share_no_fix_and_leave_none_out(origin_s):
    line = np.column_stack([TIMES, TIMES])
    whole = replace(made(track(TIMES, line), track(TIMES + 0.5, line, "b")), clock_origin_s=origin_s)
    shares = parsed_split("60,20,20")
    parts = {name: part_of(whole, shares, name) for name in ("train", "choose", "judge")}
    assert [len(fixes(part)) for part in parts.values()] == [2 * 60 + 1, 40, 2 * 20 + 1]  # of 0 to 100.5 s
    assert set.union(*map(fixes, parts.values())) == fixes(whole)
    assert parts["train"].end_s < 0.6 * 100.5 <= parts["choose"].start_s
    assert parts["choose"].end_s < 0.8 * 100.5 <= parts["judge"].start_s
    assert span_of(parts["judge"]) == f"{origin_s + 80.5:.10g} to {origin_s + 100.5:.10g} s"


def test_a_fix_on_the_border_belongs_to_the_later_part():
    whole = made(track(TIMES, np.column_stack([TIMES, TIMES])))
    assert part_of(whole, parsed_split([50.0, 25.0, 25.0]), "train").end_s == 49.0
    assert part_of(whole, parsed_split([50.0, 25.0, 25.0]), "choose").start_s == 50.0


@pytest.mark.parametrize("text", ["60,40", "60,20,20,1", "60,40,0", "a,b,c", "1,nan,1", "1,inf,1", "", "-1,1,1"])
def test_other_shares_are_wrong(text):
    with pytest.raises(InputError, match=r"split .*: expected three shares > 0, .* as 60,20,20"):
        parsed_split(text)
    assert parsed_split("6,2,2") == pytest.approx((0.6, 0.2, 0.2))


@pytest.mark.slow  # compiles two replays
def test_fit_and_replay_take_their_parts(recording):
    border_s = 0.6 * (recording.end_s - recording.start_s)
    fitted = foveate.fit(recording, split="60,20,20")
    assert fitted.experiment == foveate.fit(window(recording, None, np.nextafter(border_s, 0.0))).experiment
    still = foveate.heuristic("still", fitted.experiment.scenario)
    options = {"method": "policy", "agent_start": (0.0, 0.0, 0.0), "progress": False}
    judged = foveate.replay(still, recording, split="60,20,20", **options)
    by_hand = foveate.replay(still, recording, start=0.8 * recording.end_s, **options)
    assert replace(judged.rows[0], step_time_s=0.0) == replace(by_hand.rows[0], step_time_s=0.0)
    assert (judged.settings.part, judged.settings.recording) == ("judge", "r.csv, 16 to 20 s")
    other = foveate.replay(still, recording, split="60,20,20", part="choose", **options)
    assert other.rows[0].targets != judged.rows[0].targets  # c leaves at 12.5 s
    assert (by_hand.settings.part, by_hand.settings.split) == (None, None)


def named(name, scenario, goal="seen"):
    experiment = foveate.fit(GOALS[goal], goal=goal).experiment
    network = heuristic_policy("still" if name == "still" else "random", scenario.problem(), 6.0)
    return NamedPolicy(name=name, experiment=replace(experiment, scenario=scenario), network=network)


GOALS = dict.fromkeys(("seen", "information"), made(track(TIMES, np.column_stack([TIMES, np.sin(TIMES)]))))


@pytest.mark.parametrize("goal", ["seen", "information"])
def test_the_best_on_the_middle_part_is_judged_on_the_last(recording, scenario, tmp_path, goal):
    several = [named(name, scenario, goal) for name in ("random", "still")]
    options = {"split": "40,40,20", "method": "policy", "agent_start": (0.0, 0.0, 0.0), "progress": False}
    alone = {}
    for each in several:
        rows = foveate.replay(each, recording, part="choose", **options).rows
        alone[each.name] = rows[0].seen_time_fraction if goal == "seen" else rows[0].log_det_mean
    best = max(alone, key=alone.__getitem__)
    for order in (several, several[::-1]):
        result = foveate.replay(order[0], recording, candidates=order[1:], **options)
        assert result.settings.run == best
        own = foveate.replay(next(each for each in several if each.name == best), recording, **options)
        assert replace(result.rows[0], step_time_s=0.0) == replace(own.rows[0], step_time_s=0.0)
        assert [each.run for each in result.settings.candidates] == [each.name for each in order]
    result.to_json(tmp_path / "r.json")
    said = json.loads((tmp_path / "r.json").read_text())
    assert (said["part"], said["split"]) == ("judge", [0.4, 0.4, 0.2])
    found = {
        each["run"]: each["seen_time_fraction" if goal == "seen" else "log_det_mean"] for each in said["candidates"]
    }
    assert found == pytest.approx(alone)


def test_candidates_need_a_part_to_be_compared_on(recording, scenario):
    one, other = named("still", scenario), named("random", scenario)
    for wrong in ({}, {"split": "40,40,20", "part": "choose"}):
        with pytest.raises(InputError, match="candidates: expected a split"):
            foveate.replay(one, recording, candidates=[other], progress=False, **wrong)


def test_planners_have_the_names_of_their_rows():
    for name in ("icr", "icr-3", "refine-15"):
        assert online_planner(name).method == name
    assert [online_planner(name) for name in ("nearest", "refine", "icr-", "icr-x", "icr-open", "policy")] == [None] * 6
    assert online_planner("icr").settings("true") == PUBLISHED
    assert online_planner("icr-3").settings("true") == replace(ONLINE["true"], starts=3)
    assert online_planner("refine-5").settings("true") == refining("true", 5)
    with pytest.raises(InputError, match="starts"):
        online_planner("icr-0")


@pytest.mark.parametrize("name", ["icr-x", "icr+x", "uncertain+x", "uncertain+", "all+greedy", "explore"])
def test_one_list_has_all_methods_that_are_possible(name):
    with pytest.raises(
        InputError, match=f"method '{re.escape(name)}': expected one of policy, .*NAME.RULE.*icr-ST"
    ) as it:
        replay_methods(["uncertain+greedy", "icr-3", "all", name])
    assert "lookahead" not in str(it.value)
    mine = ("uncertain+greedy", "icr-3", "icr-3+greedy")
    assert replay_methods([*mine, "all"]) == (*mine, *METHODS)
    assert replay_methods(["explore", "all"], has_ids=False) == ("explore", *METHODS, "alternate", "lookahead")


@pytest.mark.slow  # plans at every step
def test_planners_stand_beside_the_heuristics(recording, scenario, monkeypatch):
    """A planner runs as the one made by hand; it sees more than standing still."""
    time_no_decision(monkeypatch)
    own = foveate.heuristic("nearest", scenario)
    options = {"agent_start": (0.0, 0.0, 0.0), "end": 8.0, "progress": False}
    result = foveate.replay(own, recording, method=["still", "refine-3"], **options)
    rows = {row.method: row for row in result.rows}
    steps = len(result.traces["refine-3"][0].slots.times_s) - 1
    policy = planner(scenario.problem(), refining("true", 3), steps, policy=own.network)
    hand = foveate.replay(
        NamedPolicy(name="x", experiment=Experiment(scenario=scenario), network=policy),
        recording, method="policy", **options,
    )  # fmt: skip
    assert jnp.array_equal(hand.traces["policy"][1].pose, result.traces["refine-3"][1].pose)
    assert rows["refine-3"].log_det_mean > rows["still"].log_det_mean
    with pytest.raises(InputError, match=r"method 'icr-x': expected one of policy, .*or a planner: icr, icr-STARTS"):
        foveate.replay(own, recording, method="icr-x", progress=False)
