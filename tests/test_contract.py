"""The checker of JSON files (helpers/contract.py) passes the stored samples and names what is wrong in broken ones."""

import json
from pathlib import Path

import pytest
from helpers.contract import faults

ROOT = Path(__file__).parents[1]
SAMPLES = {
    "scenes": ROOT / "tests" / "formats" / "scenes.json",
    "evaluate": ROOT / "tests" / "formats" / "evaluation-2.json",
    "verdict": ROOT / "tests" / "formats" / "verdict.json",
    "replay": ROOT / "tests" / "formats" / "replay.json",
    "bench": ROOT / "benchmarks" / "baseline.json",
}


@pytest.mark.parametrize("kind", SAMPLES)
def test_stored_samples_keep_the_contract(kind):
    assert faults(kind, SAMPLES[kind]) == []


def test_scenes_in_space_keep_the_contract(tmp_path):
    scene = {"id": "a", "agent": [0, 0, 1, 1, 0, 0, 0], "targets": [[1, 2, 3]]}
    (tmp_path / "scenes.json").write_text(
        json.dumps({"format": "foveate-scenes", "version": 1, "scenes": [scene]}), encoding="utf-8"
    )
    assert faults("scenes", tmp_path / "scenes.json") == []


REMOVED = object()


@pytest.mark.parametrize(
    ("kind", "place", "value", "fault"),
    [
        ("scenes", ("format",), "foveate-policy", "file: format = 'foveate-policy'"),
        ("scenes", ("version",), 2, "file: version = 2"),
        ("scenes", ("scenes",), [], "no scenes"),
        ("scenes", ("scenes", 0), 3, "scenes[0]: expected an object"),
        ("scenes", ("scenes", 1, "agent"), REMOVED, "scenes[1]: no 'agent'"),
        ("scenes", ("scenes", 0, "agent"), [0.0] * 6, "scenes[0]: agent = "),
        ("scenes", ("scenes", 0, "agent"), [0.0, 0.0, float("nan")], "scenes[0]: agent = "),
        ("scenes", ("scenes", 0, "targets"), [[1.0, 2.0, 3.0]], "scenes[0]: targets = "),
        ("scenes", ("scenes", 0, "drift"), [[0.1, 0.0]], "scenes[0]: drift = "),
        ("scenes", ("scenes", 0, "horizon"), 0, "scenes[0]: horizon = 0"),
        ("scenes", ("scenes", 1, "id"), "two", "id 'two' is given twice"),
        ("evaluate", ("rows",), [], "no rows"),
        ("evaluate", ("summary",), REMOVED, "no summary"),
        ("evaluate", ("rows", 0, "nees"), REMOVED, "rows[0]: no 'nees'"),
        ("evaluate", ("rows", 0, "nees"), float("inf"), "rows[0]: nees = inf"),
        ("evaluate", ("rows", 1, "seed"), True, "rows[1]: seed = True"),
        ("evaluate", ("rows", 0, "seen_fraction"), 1.5, "rows[0]: seen_fraction = 1.5"),
        ("evaluate", ("rows", 0, "protocol"), "soft", "rows[0]: protocol = 'soft'"),
        ("evaluate", ("rows", 0, "score"), None, "rows[0]: score = None of 2 targets"),
        ("evaluate", ("rows", 1, "score"), 3.0, "rows[1]: score = 3.0 of 0 targets"),
        ("evaluate", ("rows", 0, "objective"), REMOVED, "rows[0]: no 'objective'"),
        ("verdict", ("objective",), "speed", "file: objective = 'speed'"),
        ("verdict", ("rows", 1, "se"), -0.1, "rows[1]: se = -0.1"),
        ("verdict", ("rows", 0, "method"), "still", "rows[0]: expected the policy"),
        ("evaluate", ("summary", 0, "motion"), "still", "summary[0]: motion = 'still'"),
        ("evaluate", ("summary", 0, "ci95"), [2.0, 1.0], "summary[0]: ci95 = [2.0, 1.0]"),
        ("replay", ("rows", 0, "lost"), 0.5, "rows[0]: lost = 0.5"),
        ("replay", ("rows", 0, "seen_time_fraction"), REMOVED, "rows[0]: no 'seen_time_fraction'"),
        ("replay", ("rows", 0, "step_time_s"), -1.0, "rows[0]: step_time_s = -1.0"),
        ("bench", ("metrics",), {}, "no metrics"),
        ("bench", ("metrics", 0, "better"), "more", "metrics[0]: better = 'more'"),
        ("bench", ("metrics", 2, "key"), "limit", "no metric 'train_step_over_limit_60'"),
    ],
)
def test_a_broken_file_is_named(tmp_path, kind, place, value, fault):
    data = json.loads(SAMPLES[kind].read_text(encoding="utf-8"))
    *parents, last = place
    record = data
    for key in parents:
        record = record[key]
    if kind == "bench" and last == "key":
        assert record["key"] == "train_step_over_limit_60", "the metric that this test removes"
    if value is REMOVED:
        del record[last]
    else:
        record[last] = value
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps(data), encoding="utf-8")
    found = faults(kind, broken)
    assert any(line.startswith(fault) for line in found), found


def test_a_list_is_no_document(tmp_path):
    (tmp_path / "list.json").write_text("[]", encoding="utf-8")
    assert faults("scenes", tmp_path / "list.json") == ["expected an object"]
