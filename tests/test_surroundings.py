"""What surrounds a command goes wrong: full disks, folders that cannot be written, no home, clocks that go back.

Killed and interrupted trainings: learning/test_killed.py. Standard streams: cli/test_streams.py.
"""

import ast
import codecs
import errno
import importlib
import json
import os
import re
import resource
import shutil
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

import foveate
from foveate.cli.main import main
from foveate.experiment.checkpoint import load_run, save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.run_folder import BEST, CONFIG
from foveate.io import figures, files, jax_settings, npz, tables
from foveate.io.cache import Job
from foveate.io.toml import save_toml
from foveate.learning.tensorboard import Events
from foveate.policies.attention import AttentionSettings

SOURCE = Path(foveate.__file__).parent
SMALL = Experiment(policy=AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,)))
UNCACHED = "ignore:Error writing persistent compilation cache entry:UserWarning"
"""Compiled programs of the tests themselves cannot be kept there, either."""
ROWS = ["time_s,track_id,x_m,y_m", *(f"{0.1 * t:.1f},a,{0.1 * t:.2f},{0.03 * t * t:.3f}" for t in range(80))]


def writes(node: ast.AST) -> bool:
    """True for a call that writes into a file by its name."""
    if not isinstance(node, ast.Call):
        return False
    name = getattr(node.func, "attr", getattr(node.func, "id", ""))
    modes = [a.value for a in [*node.args, *(k.value for k in node.keywords)] if isinstance(a, ast.Constant)]
    opens = name == "open" and any(
        isinstance(mode, str) and re.fullmatch("[wax][bt+]*|r[bt]*\\+[bt]*", mode) for mode in modes
    )
    return opens or name in ("write_text", "write_bytes", "tofile", "savetxt", "savez", "NamedTemporaryFile")


def test_every_file_is_written_in_one_place():
    """Then what is tested of `io.files` holds for every command."""
    texts = {path.relative_to(SOURCE).as_posix(): path.read_text() for path in SOURCE.rglob("*.py")}
    found = {name for name, text in texts.items() if any(map(writes, ast.walk(ast.parse(text))))}
    assert found == {"io/files.py", "learning/tensorboard.py"}
    for text, expected in (("open(p, 'wb')", True), ("p.open('a', encoding='utf-8')", True), ("open(p, 'rb')", False)):
        assert any(map(writes, ast.walk(ast.parse(text)))) == expected


def test_only_the_names_of_events_know_the_clock():
    """Durations are those of clocks that only go ahead: setting the wall clock changes nothing else."""
    of_the_wall = re.compile(r"\btime\.time\(|\btime_ns\(|datetime\.now|date\.today")
    found = [path.name for path in SOURCE.rglob("*.py") if of_the_wall.search(path.read_text())]
    assert found == ["tensorboard.py"]


def test_events_stay_in_order_where_the_clock_goes_back(tmp_path, monkeypatch):
    for now in (2e9, 1e9, 0.0, 3e9):
        monkeypatch.setattr(time, "time", lambda now=now: now)
        with Events(tmp_path) as events:
            events.add({"x": 1.0}, 1)
    assert [path.name.split(".")[-1] for path in sorted(tmp_path.iterdir())] == ["0000", "0001", "0002", "0003"]


@pytest.fixture
def full_disk():
    """No file grows beyond 64 bytes, as where a quota is used up."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def drawn(path):
    figure = figures.new_figure(3.0, 2.0)
    figures.save(figure, path)


WHOLE = {
    "bytes": ("x.bin", lambda path: files.write_atomic(path, b"x" * 1000)),
    "json": ("x.json", lambda path: files.write_json(path, list(range(500)))),
    "document": ("x.json", lambda path: files.write_document(path, "scenes", 1, {"scenes": list(range(500))})),
    "arrays": ("x.npz", lambda path: npz.save_arrays(path, {"a": np.zeros(99)}, {"format": "foveate-x", "version": 1})),
    "toml": ("x.toml", lambda path: save_toml(SMALL, path)),
    "figure": ("x.png", drawn),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_a_full_disk_leaves_the_old_file_and_is_named(kind, tmp_path, full_disk):
    name, write = WHOLE[kind]
    path = tmp_path / name
    path.write_bytes(b"old")
    with pytest.raises(OSError, match="File too large") as caught:
        write(path)
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(path))
    assert path.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == [name], "and nothing beside it"


def test_a_full_disk_is_named_by_what_appends(tmp_path, full_disk):
    path = tmp_path / "metrics.jsonl"
    with pytest.raises(OSError, match="File too large") as caught:
        files.append_line(path, "x" * 1000)
    assert caught.value.filename == str(path)
    with pytest.raises(OSError, match="File too large") as caught, Events(tmp_path) as events:
        events.add({f"number {i}": 1.0 for i in range(100)}, 1)
    assert "events.out.tfevents" in str(caught.value.filename)


@pytest.mark.slow
@pytest.mark.filterwarnings(UNCACHED)
def test_a_command_on_a_full_disk_says_one_line(tmp_path, capsys, monkeypatch, full_disk):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits[1], limits[1]))
    (tmp_path / "r.csv").write_text("\n".join(ROWS))
    monkeypatch.chdir(tmp_path)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))
    assert main(["fit", "r.csv", "--out", "x.toml"]) == 2
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits[1], limits[1]))
    assert capsys.readouterr().err.splitlines()[-1] == "foveate: x.toml: File too large"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.csv"]


@pytest.fixture
def nobody():
    """Whoever may write anywhere is another user for a while."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    codecs.lookup("utf-8-sig")  # what the other user could not read of this Python is loaded before
    for name in ("train", "evaluate", "fit"):
        importlib.import_module(f"foveate.cli.run.{name}")
    os.seteuid(65534)
    yield
    os.seteuid(0)


@pytest.fixture
def mine():
    """A folder that this user has and others may read, but neither write nor, in `mine/closed`, enter."""
    folder = Path(tempfile.mkdtemp(prefix="foveate-test-"))
    folder.chmod(0o755)
    (folder / "closed").mkdir(mode=0o700)
    (folder / "r.csv").write_text("\n".join(ROWS))
    yield folder
    os.seteuid(os.getuid())
    shutil.rmtree(folder)


@pytest.mark.filterwarnings(UNCACHED)
def test_another_user_is_told_what_cannot_be_written(mine, nobody, capsys):
    with pytest.raises(OSError, match="Permission denied"):
        files.write_atomic(mine / "x.toml", b"")
    for words in (
        f"train --resume {mine}/closed/run",
        f"evaluate {mine}/closed/run",
        f"fit {mine}/closed/r.csv --out x.toml",
    ):
        assert main(words.split()) == 2, words
        said = capsys.readouterr().err.splitlines()[-1]
        assert str(mine) in said, words
        assert "Traceback" not in said
    assert sorted(path.name for path in mine.iterdir()) == ["closed", "r.csv"]


def test_a_cache_that_cannot_be_used_costs_only_time(mine, nobody, monkeypatch, caplog, request):
    """That of another user, as after sudo; also one that cannot be entered."""
    # A benchmark turns the cache off for the rest of its process, which is that of other tests here.
    for name, value in (("jax_compilation_cache_dir", None), ("jax_enable_compilation_cache", True)):
        request.addfinalizer(partial(jax.config.update, name, jax.config.values[name]))
        jax.config.update(name, value)
    for home in (mine, mine / "closed", Path("/proc")):
        monkeypatch.setenv("XDG_CACHE_HOME", str(home))
        with caplog.at_level("INFO", "foveate"):
            jax_settings.keep_compiled()
        assert jax.config.values["jax_compilation_cache_dir"] is None
        assert f"{home}/foveate/jax: cannot be written" in caplog.messages[-1]
        path = files.cache_folder("plans") / "x.json"
        job = Job(path=path, kind="x", version=1, key=str, compute=lambda: 3, encode=int, decode=int, optional=True)
        with pytest.warns(UserWarning, match="not kept"):
            assert job.result() == 3


def test_without_a_home_and_a_folder_for_temporary_files(monkeypatch, tmp_path):
    def unknown() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", unknown)
    monkeypatch.setattr(tempfile, "tempdir", None)
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.setenv(name, str(tmp_path / "missing"))
    files._temporary_cache.cache_clear()
    assert files.cache_folder("plans").parents[1].is_dir()
    files._temporary_cache.cache_clear()


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"{}", b'{"format": "foveate-x", "version": 99}'])
@pytest.mark.parametrize("name", ["x.json", "x.npz"])
def test_a_cache_of_another_version_or_program_is_computed_again(tmp_path, name, damage):
    (tmp_path / name).write_bytes(damage)
    lines = []
    coded = (lambda x: {"x": np.array(x)}, lambda a: int(a["x"])) if name == "x.npz" else (int, int)
    job = Job(
        path=tmp_path / name, kind="x", version=1, key=lambda: "k", compute=lambda: 3, encode=coded[0], decode=coded[1]
    )
    assert job.result(on_rejected=lines.append) == 3
    assert len(lines) == 1
    assert name in lines[0]
    assert job.result(on_rejected=lines.append) == 3
    assert len(lines) == 1


@pytest.mark.slow
def test_a_changed_configuration_whose_digest_was_made_again_is_of_another_experiment(tmp_path):
    (tmp_path / BEST).parent.mkdir()
    write_config(tmp_path, SMALL)
    policy = SMALL.new_policy(jax.random.key(0), SMALL.scenario.problem())
    save_tree(tmp_path / BEST, policy, SMALL, "policy", {"seed": 0})
    assert load_run(tmp_path)[0] == SMALL
    text = (tmp_path / CONFIG).read_text()
    faster = foveate.Experiment(policy=SMALL.policy, scenario=foveate.Scenario(tau_s=0.5))
    save_toml(faster, tmp_path / CONFIG)
    assert (tmp_path / CONFIG).read_text() != text
    with pytest.raises(ValueError, match=r"best\.npz: belongs to another experiment"):
        load_run(tmp_path)


@pytest.mark.parametrize(
    "name", ["a|b", "a\\|b", "a\\\\|b", "\\", "<b>x</b>", "[x](http://y)", "a\nb", "a\r\n# b", "a\u2028|b"]
)
def test_a_name_makes_no_cell_line_or_link_in_markdown(name):
    lines = tables.markdown(
        "t", {"scene": name}, [tables.Table(title=name, header=("a", "b"), rows=((name, "1"),), note="")], {}
    )
    (row,) = [line for line in lines.splitlines() if line.endswith(" 1 |")]
    # As GFM reads a row: a backslash takes the meaning of the mark after it.
    assert len(re.findall(r"\|", re.sub(r"\\.", "", row))) == 3
    assert not re.search(r"^# b|<b>|\]\(", lines, re.MULTILINE)
    assert lines.count("\n") == 11


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
def test_64_targets_for_4096_steps_with_noise_of_a_kilometre(tmp_path, capsys):
    """Finite, and within the memory of a small machine."""
    config, out = tmp_path / "x.toml", tmp_path / "x.json"
    config.write_text(
        "[scenario.sensor]\nstd_m = 1e3\n[scenario.view]\nshape = 'sector'\nangle_deg = 270.0\ndepth_m = 5e3\n"
        "[scenario.scenes]\ntargets_min = 64\ntargets_max = 64\nsteps = 4096\ninitial_error = 'consistent'\n"
    )
    words = f"evaluate any@{config} --method uncertain --protocol true --json {out} --scenes own"
    assert main(words.split()) == 0, capsys.readouterr().err
    rows = json.loads(out.read_text())["rows"]
    assert all(row["targets"] == 64 for row in rows)
    assert all(np.isfinite(row[name]) for row in rows for name in ("score", "rmse_m", "nees"))
