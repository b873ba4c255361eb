"""Scenes files: what is written comes back; anything wrong is one line with file and place; the contract holds."""

import json

import pytest
from helpers.commands import check_contract

from foveate.geometry.space import SPACES
from foveate.scenario.scenes import Scene, SceneSettings, checked, read_scenes, write_scenes

PLANAR, SETTINGS = SPACES["planar"], SceneSettings()
GOOD = {"id": "a", "agent": [1.0, 2.0, 0.5], "targets": [[1, 2], [3.5, -4]], "drift": [[0.1, 0], [0, 0]], "horizon": 9}
SCENES = [
    Scene(
        id="one ü",
        agent=(0.1, -2.0, 3.25),
        targets=((1 / 3, 2.0), (3.0, 1e-17)),
        drift=((0.1, 0.2), (0.0, 0.0)),
        horizon=7,
    ),
    Scene(id="empty", agent=(0.0, 0.0, 0.0), targets=(), drift=(), horizon=3),
]


def written(path, rows=(GOOD,), **changes):
    path.write_text(json.dumps({"format": "foveate-scenes", "version": 1, "scenes": list(rows), **changes}))
    return path


def test_round_trip(tmp_path):
    write_scenes(tmp_path / "s.json", SCENES)
    assert read_scenes(tmp_path / "s.json", PLANAR, SETTINGS) == SCENES
    spatial = Scene(
        id="3d", agent=(1.0, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5), targets=((1.0, 2.0, 3.0),), drift=((0.0,) * 3,), horizon=5
    )
    write_scenes(tmp_path / "s3.json", [spatial])
    assert read_scenes(tmp_path / "s3.json", SPACES["spatial"], SETTINGS) == [spatial]


def test_a_scene_made_in_python_needs_neither_drift_nor_horizon(tmp_path):
    bare = Scene(id="b", agent=(0.0, 0.0, 0.0), targets=((1.0, 2.0), (3.0, 4.0)))
    assert bare.motion == "unbiased"
    expected = Scene(id="b", agent=bare.agent, targets=bare.targets, drift=((0.0, 0.0),) * 2, horizon=6)
    assert checked([bare], PLANAR, SETTINGS) == [expected]
    assert checked([bare], PLANAR, SceneSettings(steps=40))[0].horizon == 40
    write_scenes(tmp_path / "s.json", [bare])
    assert read_scenes(tmp_path / "s.json", PLANAR, SETTINGS) == [expected]


def test_defaults_and_motion(tmp_path):
    bare = {"id": "b", "agent": [0, 0, 0], "targets": [[1, 2]] * 4}
    scenes = read_scenes(written(tmp_path / "s.json", [GOOD, bare]), PLANAR, SETTINGS)
    assert [s.motion for s in scenes] == ["biased", "unbiased"]
    assert scenes[1].drift == ((0.0, 0.0),) * 4
    assert scenes[1].horizon == 12
    long = SceneSettings(steps=40)
    assert read_scenes(tmp_path / "s.json", PLANAR, long)[1].horizon == 40
    assert read_scenes(tmp_path / "s.json", PLANAR, long)[0].horizon == 9


def without(key):
    return {name: value for name, value in GOOD.items() if name != key}


ROWS = {
    "no object": ([3], "scenes[0]"),
    "no id": ([GOOD, without("id")], "scenes[1]: no 'id'"),
    "no agent": ([without("agent")], "scenes[0]: no 'agent'"),
    "no targets": ([without("targets")], "scenes[0]: no 'targets'"),
    "unknown key": ([{**GOOD, "goal": 1}], "unknown key 'goal'"),
    "number as id": ([{**GOOD, "id": 3}], "id = 3"),
    "empty id": ([{**GOOD, "id": ""}], "id = ''"),
    "half a character as id": ([{**GOOD, "id": "a\ud800"}], "expected a non-empty text of whole characters"),
    "id twice": ([GOOD, GOOD], "id 'a' is given twice"),
    "agent of another space": ([{**GOOD, "agent": [0, 0, 0, 1, 0, 0, 0]}], "scenes[0] ('a'): agent = [0"),
    "agent no list": ([{**GOOD, "agent": "here"}], "agent = 'here'"),
    "target of three numbers": ([{**GOOD, "targets": [[1, 2], [1, 2, 3]]}], "targets[1] = [1, 2, 3]: expected 2"),
    "target no row": ([{**GOOD, "targets": [1, 2]}], "targets[0] = 1"),
    "targets no list": ([{**GOOD, "targets": {"x": 1}}], "targets = {'x': 1}"),
    "text as number": ([{**GOOD, "targets": [["1", 2], [1, 2]]}], "targets[0] = ['1', 2]"),
    "truth as number": ([{**GOOD, "agent": [True, 0, 0]}], "agent = [True"),
    "far away": ([{**GOOD, "targets": [[1e12, 2], [1, 2]]}], "targets[0] = [1000000000000.0, 2]"),
    "too few drifts": ([{**GOOD, "drift": [[0, 0]]}], "drift has 1 rows: expected 2"),
    "drift of one number": ([{**GOOD, "drift": [[0], [0]]}], "drift[0] = [0]"),
    "no step": ([{**GOOD, "horizon": 0}], "horizon = 0"),
    "half a step": ([{**GOOD, "horizon": 2.5}], "horizon = 2.5"),
    "true steps": ([{**GOOD, "horizon": True}], "horizon = True"),
    "steps as null": ([{**GOOD, "horizon": None}], "horizon = None"),
    "too many steps": ([{**GOOD, "horizon": 10**7}], "horizon = 10000000"),
    "no scene": ([], "at least one scene"),
}


def rejection(path):
    with pytest.raises(ValueError, match=path.name) as caught:
        read_scenes(path, PLANAR, SETTINGS)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert len(message.splitlines()) == 1
    return message


@pytest.mark.parametrize("name", ROWS)
def test_bad_scenes(tmp_path, name):
    rows, words = ROWS[name]
    assert words in rejection(written(tmp_path / "bad.json", rows))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("{", "cut short"),
        ("[]", "foveate-scenes"),
        ('{"format": "foveate-policy", "version": 1, "scenes": []}', "foveate-scenes"),
        ('{"format": "foveate-scenes", "version": 2, "scenes": []}', "version 2"),
        ('{"format": "foveate-scenes", "scenes": []}', "version None"),
        ('{"format": "foveate-scenes", "version": 1}', "scenes"),
        ('{"format": "foveate-scenes", "version": 1, "scenes": {}}', "scenes"),
        ('{"format": "foveate-scenes", "version": 1, "scenes": [], "more": 1}', "unknown key 'more'"),
        ('{"format": "foveate-scenes", "version": 1, "scenes": [{"id": "a", "agent": [NaN, 0, 0]}]}', "NaN"),
        ('{"format": "foveate-scenes", "version": 1, "digest": null, "scenes": []}', "does not fit its digest"),
        ('{"format": "foveate-scenes", "version": 1, "scenes": [], "scenes": []}', "'scenes' is given twice"),
    ],
)
def test_bad_files(tmp_path, text, words):
    (tmp_path / "bad.json").write_text(text)
    assert words in rejection(tmp_path / "bad.json")


def test_whole_numbers_beyond_all_floats(tmp_path):
    """JSON may hold whole numbers of hundreds of digits, of which no float can be made."""
    assert "targets[0]" in rejection(written(tmp_path / "bad.json", [{**GOOD, "targets": [[10**400, 0], [0, 0]]}]))


def test_missing_file(tmp_path):
    assert "no such file" in rejection(tmp_path / "none.json")


def test_written_scenes_keep_the_contract(tmp_path):
    write_scenes(tmp_path / "scenes.json", SCENES)
    check_contract("scenes", tmp_path / "scenes.json")
