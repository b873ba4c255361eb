"""A short run of `make fuzz`, and inputs built to be slow or large."""

import json
import sys
import time

import numpy as np
import pytest
from endurance.fuzz import arguments, furnish, fuzz, light, readers, require, run_command
from endurance.hostile import onnx_reader, overlapping
from hypothesis import given, settings
from hypothesis import strategies as st

from foveate.cli.main import COMMANDS
from foveate.errors import InputError

SLOWEST_S = 10.0
"""Here every annotation is checked, too, lines are counted, and other tests run."""
odd = st.text() | st.floats().map(str) | st.integers().map(str)
rows = st.lists(st.tuples(odd, odd, odd, odd), max_size=6)
values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
scene = st.fixed_dictionaries(
    {
        "id": values,
        "agent": st.lists(st.floats(), max_size=4) | values,
        "targets": st.lists(values, max_size=3) | values,
    },
    optional={"drift": values, "horizon": values},
)


@pytest.fixture(scope="module")
def read_by():
    return readers()


def rejected_or_taken(reader, path, text):
    path.write_text(text, encoding="utf-8", errors="surrogatepass", newline="")
    try:
        reader(path)
    except InputError as error:
        require(len(str(error).splitlines()) == 1 and str(path) in str(error), repr(error))


@pytest.mark.slow
def test_a_thousand_fuzzed_inputs_are_accepted_or_rejected():
    counts, broken = fuzz(1000, 5, report=lambda line: None, slowest_s=SLOWEST_S)
    assert broken == []
    assert sum(counts.values()) == 1000
    for kind in ("recording", "scenes", "toml", "checkpoint", *(["onnx"] if onnx_reader() else [])):
        assert counts[f"{kind} taken"] > 2
        assert counts[f"{kind} rejected"] > 50


@settings(max_examples=50, deadline=None)
@given(rows=rows)
def test_arbitrary_recordings_are_read_or_rejected(tmp_path_factory, read_by, rows):
    text = "time_s,track_id,x_m,y_m\n" + "\n".join(map(",".join, rows))
    rejected_or_taken(read_by["recording"], tmp_path_factory.getbasetemp() / "any.csv", text)


@settings(max_examples=50, deadline=None)
@given(scenes=st.lists(scene, max_size=3) | values)
def test_arbitrary_scenes_are_read_or_rejected(tmp_path_factory, read_by, scenes):
    text = json.dumps({"format": "foveate-scenes", "version": 1, "scenes": scenes})
    rejected_or_taken(read_by["scenes"], tmp_path_factory.getbasetemp() / "any.json", text)


@settings(max_examples=50, deadline=None)
@given(text=st.lists(st.tuples(st.sampled_from(["scenario", "tau_s", "[policy]\nkind"]), values), max_size=3))
def test_arbitrary_configurations_are_read_or_rejected(tmp_path_factory, read_by, text):
    lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in text)
    rejected_or_taken(read_by["toml"], tmp_path_factory.getbasetemp() / "any.toml", lines)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(command=st.sampled_from([*COMMANDS]), words=st.lists(st.text(), max_size=3))
def test_arbitrary_arguments_are_accepted_or_rejected(tmp_path_factory, command, words):
    folder = tmp_path_factory.getbasetemp() / "words"
    folder.mkdir(exist_ok=True)
    furnish(folder)
    with pytest.MonkeyPatch.context() as patch, light():
        patch.chdir(folder)
        assert run_command([command, *words]).startswith("status")


MEBIBYTE = 1 << 20
LARGE = {
    "scenes, many": (
        "scenes",
        json.dumps(
            {
                "format": "foveate-scenes",
                "version": 1,
                "scenes": [{"id": f"s{i}", "agent": [0, 0, 0], "targets": []} for i in range(2_000)],
            }
        ),
    ),
    "scenes, deep": ("scenes", '{"format": "foveate-scenes", "version": 1, "scenes": ' + "[" * (MEBIBYTE - 100)),
    "scenes, deep with a digest": (
        "scenes",
        '{"format": "foveate-scenes", "version": 1, "digest": "x", "scenes": ' + "[" * 900 + "]" * 900 + "}",
    ),
    "recording, one line": ("recording", "time_s,track_id,x_m,y_m\n" + "9" * MEBIBYTE),
    "recording, tracks": ("recording", "time_s,track_id,x_m,y_m\n" + "".join(f"0,{i},0,0\n" for i in range(30_000))),
    "recording, a long time": ("recording", "time_s,track_id,x_m,y_m\n0,a,0,0\n1e12,a,0,0\n"),
    "toml, deep": ("toml", "a = " + "[" * (MEBIBYTE - 100)),
    "toml, dotted": ("toml", ".".join("a" * (MEBIBYTE // 2)) + " = 1"),
    "toml, dotted and quoted": ("toml", '"=".' * (MEBIBYTE // 4) + "a = 1"),
    "toml, many dotted": ("toml", "".join(f"k{i}" + ".a" * 20 + " = 1\n" for i in range(20_000))),
    "toml, spaces": ("toml", "a" + " " * (MEBIBYTE - 10) + ". b = 1"),
    "toml, keys": ("toml", "".join(f"k{i} = 1\n" for i in range(70_000))),
    "toml, a number": ("toml", "[scenario]\ntau_s = " + "9" * (MEBIBYTE - 100)),
}
SHARE = {"scenes, many": 1 / 3, "recording, tracks": 3 / 8}
"""Of the time, where not as much is read: these are rows that each take long."""


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE)
def test_large_files_are_read_within_seconds(tmp_path, read_by, name):
    kind, text = LARGE[name]
    assert len(text) <= MEBIBYTE + 100
    began = time.thread_time()  # not that of what other tests have left running
    rejected_or_taken(read_by[kind], tmp_path / "large", text)
    # Here every annotation is checked, too; where lines are counted, Python takes twice as long again.
    allowed_s = SHARE.get(name, 1.0) * (SLOWEST_S if sys.gettrace() is None else 2 * SLOWEST_S)
    assert time.thread_time() - began < allowed_s


def test_a_small_archive_that_unpacks_to_gigabytes_is_refused_at_once(tmp_path, read_by):
    """Its members are all the same bytes: a mebibyte that would be read 1,500 times."""
    (tmp_path / "x.npz").write_bytes(overlapping())
    began = time.thread_time()
    with pytest.raises(InputError, match=r"x\.npz: .*larger than the file"):
        read_by["checkpoint"](tmp_path / "x.npz")
    assert time.thread_time() - began < 1.0


def test_arguments_reach_every_command():
    """Sampled arguments must reach every command; otherwise the fuzzing would test nothing."""
    rng = np.random.default_rng(0)
    assert {word for _ in range(500) for word in arguments(rng)[:1]} >= set(COMMANDS)
