"""Files of an earlier version are read as they were meant; changed ones are rejected in one line that names them."""

import ast
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from formats.make import NONE, RUNS, TWO, decision

from foveate.evaluation.summary import read_result
from foveate.evaluation.verdict import read_verdict
from foveate.experiment.checkpoint import VERSION, accepted_digests, load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS, read_validations
from foveate.io.files import read_document
from foveate.io.npz import load_arrays, save_arrays
from foveate.io.toml import digest, load_toml, read_toml
from foveate.learning.loop import train
from foveate.recordings.formats import load_recording
from foveate.recordings.measures import ReplayRow
from foveate.scenario.scenes import read_scenes

FORMATS, SOURCE = Path(__file__).parent / "formats", Path(__file__).parents[1] / "src" / "foveate"

PAPER = PRESETS["paper"].scenario


def scenes(path):
    return read_scenes(path, PAPER.problem().agent.space, PAPER.scenes)


READERS = {
    "scenes.json": scenes,
    "evaluation.json": read_result,
    "evaluation-2.json": read_result,
    "verdict.json": lambda path: read_verdict(path.parent),
    "extended.json": lambda path: accepted_digests(path.parent, "now"),
    "replay.json": lambda path: read_document(path, "replay", 1, "replay"),
    "preset-quadrotor.toml": lambda path: load_toml(Experiment, path),
    "recording.csv": load_recording,
    f"policy-gradient/{CONFIG}": lambda path: load_run(path.parent),
    f"policy-gradient/{BEST}": lambda path: load_run(path.parents[1]),
    f"policy-gradient/{LAST}": lambda path: load_arrays(path, "training", VERSION),
}


def test_a_run_of_an_earlier_version():
    name = "policy-gradient"
    experiment, _, facts = load_run(FORMATS / name)
    assert experiment == RUNS[name]
    assert facts["seed"] == 1
    expected = json.loads((FORMATS / "decisions.json").read_text())[name]
    np.testing.assert_allclose(decision(FORMATS / name), expected, atol=1e-5)
    assert [check.epoch for check in read_validations(FORMATS / name / METRICS)] == [2, 4]


def test_a_pointer_policy_of_version_0_1_is_trained_again(copied):
    """Its network is no longer there: one line says so; its configuration is read, without the keys that are gone."""
    run = copied / "actor-critic"
    assert load_toml(Experiment, run / CONFIG) == RUNS["actor-critic"]
    assert [check.epoch for check in read_validations(run / METRICS)] == [2, 4]
    with pytest.raises(ValueError, match="trained by an earlier version") as caught:
        load_run(run)
    assert str(caught.value).endswith(f"train again with {run / CONFIG}")
    assert str(caught.value).startswith(f"{run / BEST}: ")
    assert "\n" not in str(caught.value)
    (run / CONFIG).write_text((run / CONFIG).read_text().replace("mode_widths", "modewidths"))
    with pytest.raises(ValueError, match=r"policy\.modewidths = \[8\]: unknown key"):
        load_toml(Experiment, run / CONFIG)


@pytest.mark.slow
def test_a_run_older_than_a_setting_resumes_twice(tmp_path):
    """Its config.toml keeps the digest that it had, and what is saved later goes by that, too."""
    run, experiment = tmp_path / "run", RUNS["policy-gradient"]

    def stop(check, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(experiment, run, seed=1, on_validation=stop)
    lines = (run / CONFIG).read_text().splitlines(keepends=True)
    old = "".join(line for line in lines if not line.startswith(("jitter_m_s", "digest")))
    (run / CONFIG).write_text(old)
    stored, content = read_toml(Experiment, run / CONFIG)
    assert stored == experiment
    assert content != digest(experiment), "else nothing is tested"
    for name, kind in ((BEST, "policy"), (LAST, "training")):
        header, arrays = load_arrays(run / name, kind, VERSION)
        save_arrays(run / name, arrays, {**{k: v for k, v in header.items() if k != "digest"}, "experiment": content})
    for _ in range(2):
        assert train(experiment, run, seed=1, resume=True).epochs == experiment.training.epochs
        assert load_run(run)[0] == experiment
    assert (run / CONFIG).read_text() == old


def test_digest_of_a_preset_is_that_of_version_0_1():
    """Jobs and results name experiments by their digest: a key that gets another name must not change it."""
    assert digest(PRESETS["paper"]) == "58fa7acd86d515f2"


def test_presets_scenes_recordings_and_results_of_an_earlier_version():
    for path in FORMATS.glob("preset-*.toml"):
        assert isinstance(load_toml(Experiment, path), Experiment)
    assert len(list(FORMATS.glob("preset-*.toml"))) >= 4
    assert scenes(FORMATS / "scenes.json") == [TWO, NONE]
    recording = load_recording(FORMATS / "recording.csv")
    assert [(track.track_id, len(track.times_s)) for track in recording.tracks] == [("a", 4), ("b", 2)]
    rows, facts = read_result(FORMATS / "evaluation.json")
    assert [(row.scene, row.protocol) for row in rows] == [
        (scene, protocol) for protocol in ("surrogate", "true") for scene in ("two", "none")
    ]
    assert {"foveate", "jax", "device", "precision", "experiment", "seed"} <= set(facts)
    assert [row.objective for row in rows] == [None] * 4, "version 1 had none"
    rows, _ = read_result(FORMATS / "evaluation-2.json")
    assert [row.objective for row in rows] == [row.score for row in rows], "the paper's objective is the score"
    verdict = read_verdict(FORMATS)
    assert verdict is not None
    assert [(row.method, row.kind) for row in verdict.rows] == [
        ("policy", "policy"), ("still", "heuristic"), ("icr-16", "planner")
    ]  # fmt: skip
    assert accepted_digests(FORMATS, "now") == ("now", digest(PRESETS["paper"]))
    document = read_document(FORMATS / "replay.json", "replay", 1, "replay")
    assert {"foveate", "device", "experiment", "seed", "recording_sha256"} <= set(document)
    assert document["recording_sha256"] == recording.sha256
    assert set(document["rows"][0]) <= {*ReplayRow.__dataclass_fields__}


@pytest.fixture
def copied(tmp_path):
    shutil.copytree(FORMATS, tmp_path / "f")
    return tmp_path / "f"


def rejected(read, path):
    """True if a file is rejected in one line that names it or a file beside it."""
    try:
        read(path)
    except ValueError as error:
        said = str(error)
        assert len(said.splitlines()) == 1
        assert str(path.parent) in said
        return True
    return False


@pytest.mark.parametrize("name", READERS)
def test_a_cut_file_is_rejected(copied, name):
    path, read = copied / name, READERS[name]
    assert not rejected(read, path)
    whole = path.read_bytes()
    cuts = {*np.random.default_rng(0).integers(0, len(whole.rstrip()), 12).tolist(), 0, 1, len(whole.rstrip()) - 1}
    for size in cuts:
        path.write_bytes(whole[:size])
        assert rejected(read, path), f"cut to {size} of {len(whole)} bytes"


@pytest.mark.parametrize("name", READERS)
def test_a_flipped_byte_is_rejected_or_harmless(copied, name):
    """In spaces and comments a flip may change nothing; anywhere else it is noticed."""
    path, read = copied / name, READERS[name]
    whole, meant, rng = path.read_bytes(), repr(read(path)), np.random.default_rng(1)
    noticed = 0
    for place in rng.integers(0, len(whole), 60):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(flipped))
        if rejected(read, path):
            noticed += 1
        else:
            assert repr(read(path)) == meant, f"byte {place}: {whole[place - 20 : place + 20]!r}"
    assert noticed > 30


def test_an_edited_file_is_read_without_its_digest(copied):
    """Without its digest a file is as one that somebody wrote."""
    path = copied / "preset-paper.toml"
    text = path.read_text().replace("epochs = 1000", "epochs = 2000")
    path.write_text(text)
    with pytest.raises(ValueError, match=r"delete its line 'digest = \.\.'"):
        load_toml(Experiment, path)
    path.write_text("".join(line for line in text.splitlines(keepends=True) if not line.startswith("digest")))
    assert load_toml(Experiment, path).training.epochs == 2000


def test_a_version_to_come_is_rejected(copied):
    for name, newest in (("preset-paper.toml", 1), ("scenes.json", 1), ("evaluation-2.json", 2), ("verdict.json", 1)):
        path = copied / name
        text = path.read_text()
        for word in ("version = ", '"version": '):
            text = text.replace(f"{word}{newest}", f"{word}{newest + 1}")
        path.write_text(text)
        read = READERS.get(name, lambda path: load_toml(Experiment, path))
        said = f"{name}: has version {newest + 1}; this foveate reads 1 to {newest}, use a newer one"
        with pytest.raises(ValueError, match=said):
            read(path)


def test_a_damaged_line_of_metrics_is_named(copied):
    path = copied / "policy-gradient" / METRICS
    path.write_text(path.read_text()[5:])
    with pytest.raises(ValueError, match="line 1"):
        read_validations(path)


CODE = {"eval", "exec", "compile", "__import__"}
LOADERS = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "joblib"}


def test_no_reader_executes_code():
    """No pickle, no eval, no import by a name from a file; but `--add FILE.py` runs that file, and says so."""
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            where = f"{path}, line {getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [alias.name for alias in node.names] + [getattr(node, "module", "") or ""]
                assert not LOADERS & {name.partition(".")[0] for name in names}, where
            if isinstance(node, ast.Call):
                name = getattr(node.func, "id", "")
                assert name not in CODE, where
                attribute = getattr(node.func, "attr", "")
                assert attribute != "exec_module" or path.name == "reproduce.py", where
                unsafe = [
                    k for k in node.keywords if k.arg == "allow_pickle" and getattr(k.value, "value", 1) is not False
                ]
                assert not unsafe, where
                owner = getattr(getattr(node.func, "value", None), "id", "")
                assert owner != "yaml" or attribute == "safe_load", where
                if attribute == "load" and getattr(node.func.value, "id", "") in ("np", "numpy", "jnp", "torch"):
                    pytest.fail(f"{where}: loads by a way that may unpickle")
