"""A training killed at random moments, also within a write, resumes to the same files as an undisturbed one.

Death is played by a disk that stops: the operation under way is done by half, all later ones not at all, not even
cleaning up. One process is really killed, and `make kill` kills many.
"""

import builtins
import functools
import json
import os
import resource
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from endurance.kill import ACTOR_CRITIC, MODEL, await_checks, checks, start

import foveate.experiment.checkpoint as checkpoint
import foveate.io.files as files
from foveate.cli.main import main
from foveate.experiment.checkpoint import load_run
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS, require_free
from foveate.io.toml import dumps_toml
from foveate.learning import loop as training
from foveate.learning.run_files import RunFiles, stored_run
from foveate.learning.train import train

KILLS = 6
KINDS = ("write .jsonl", "write .tmp", "fsync", "replace")
"""Operations on the disk. The first kills are at one of each kind, the others at random."""


class Killed(BaseException):
    pass


class Disk:
    """Counts what is done to it, and stops."""

    def __init__(self, rng):
        self.rng, self.left, self.kind, self.dead, self.moments = rng, np.inf, None, False, []

    def live(self, left, kind=None):
        """Wait until N operations, of one kind if given, are done."""
        self.left, self.kind, self.dead = left, kind, False

    def step(self, what, whole, half=lambda: None):
        """One operation: all of it, or when its time has come nothing, a part, or all of it, and then death."""
        if self.dead:
            raise Killed
        self.left -= self.kind in (None, what)
        if self.left > 0:
            return whole()
        self.dead = True
        self.moments.append(what)
        [lambda: None, half, whole][self.rng.integers(3)]()
        raise Killed

    def open(self, path, mode="r", *rest, **options):
        file = builtins.open(path, mode, *rest, **options)  # noqa: SIM115
        return self.File(self, file, path) if set(mode) & set("xwa") else file

    class File:
        def __init__(self, disk, file, path):
            self.disk, self.file, self.path = disk, file, path

        def __getattr__(self, name):
            return getattr(self.file, name)

        def __enter__(self):
            return self

        def __exit__(self, *exception):
            self.file.close()

        def write(self, data):
            part = data[: self.disk.rng.integers(len(data) + 1)]
            suffix = Path(self.path).suffix
            self.disk.step(f"write {suffix}", lambda: self.file.write(data), lambda: self.file.write(part))
            self.file.flush()


def mortal(monkeypatch):
    """From here on all that is written is written to a disk that may stop."""
    disk = Disk(np.random.default_rng(8))
    monkeypatch.setattr(files, "open", disk.open, raising=False)
    monkeypatch.setattr(Path, "open", lambda path, *mode, **options: disk.open(path, *mode, **options))
    unlink = Path.unlink
    monkeypatch.setattr(Path, "unlink", lambda path, **options: None if disk.dead else unlink(path, **options))
    real = dict(vars(os))
    for name in ("fsync", "replace"):
        real[name] = lambda *given, name=name: disk.step(name, lambda: getattr(os, name)(*given))
    monkeypatch.setattr(files, "os", SimpleNamespace(**real))
    return disk


@pytest.fixture(autouse=True, scope="module")
def traced_once():
    """Each call of a trainer traces its programs again, and checking every annotation makes a digest slow."""
    known, now = {}, []
    jit, held_out, advance_of = training.compiled, training.held_out_episodes, training.advance_of

    def episodes(experiment, *arguments):
        now[:] = [type(experiment.training).__name__]  # the first call of a training
        if now[0] not in known:
            known[now[0]] = held_out(experiment, *arguments)
        return known[now[0]]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "advance_of", lambda *of: known.setdefault((now[0], "advance"), advance_of(*of)))
        patch.setattr(training, "compiled", lambda f, quick: known.setdefault((now[0], f.__qualname__), jit(f, quick)))
        patch.setattr(training, "held_out_episodes", episodes)
        patch.setattr(checkpoint, "digest", functools.cache(checkpoint.digest))
        yield


def arrays(path):
    with np.load(path) as found:
        return {name: found[name].tobytes() for name in found.files if name != "header"}


def untimed(run):
    lines = [json.loads(line) for line in (run / METRICS).read_text().splitlines()]
    return [{k: v for k, v in line.items() if k not in ("elapsed_s", "epochs_per_s")} for line in lines]


@pytest.mark.slow
@pytest.mark.parametrize(
    "experiment",
    [
        pytest.param(MODEL, id="policy-gradient"),
        pytest.param(ACTOR_CRITIC, id="actor-critic", marks=pytest.mark.exhaustive),
    ],
)
def test_killed_at_random_moments_it_ends_the_same(experiment, tmp_path, monkeypatch):
    """Loop and files of the actor-critic are the same; tests/learning/test_actor_critic.py resumes its own state."""
    undisturbed = train(experiment, tmp_path / "a", seed=3)
    disk = mortal(monkeypatch)
    out, outcome = tmp_path / "b", None
    while outcome is None:
        if (killed := len(disk.moments)) < KILLS:
            kind = KINDS[killed] if killed < len(KINDS) else None
            disk.live(int(disk.rng.integers(1, 3 if kind else 14)), kind)
        else:
            disk.live(np.inf)
        before = {path: arrays(out / path) for path in (BEST, LAST) if (out / path).exists()}
        try:
            outcome = train(experiment, out, seed=3, resume=(out / CONFIG).exists())
        except Killed:
            for path in before:
                assert arrays(out / path), "what was there before is there, or what replaced it"
    assert len(disk.moments) == KILLS
    assert {*disk.moments} == set(KINDS)
    assert outcome == undisturbed
    assert load_run(out)[0] == experiment
    same_runs(out, tmp_path / "a")


def same_runs(one, other):
    for path in (CONFIG, BEST):
        assert (one / path).read_bytes() == (other / path).read_bytes()
    assert arrays(one / LAST) == arrays(other / LAST)
    assert untimed(one) == untimed(other)
    assert not list(one.rglob("*.tmp")), "nothing lies about"


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A training left alone, for all that are disturbed in another way."""
    run = tmp_path_factory.mktemp("alone") / "run"
    train(MODEL, run, seed=3)
    return run


@pytest.mark.slow
def test_a_process_that_is_really_killed(alone, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_ENABLE_X64", "1")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
    config, run = tmp_path / "experiment.toml", tmp_path / "killed"
    config.write_text(dumps_toml(MODEL))
    process = start(tmp_path, "--config", config, "--seed", 3, "--out", run)
    await_checks(process, run, 3)
    with pytest.raises(ValueError, match="another process is writing into it"):
        train(MODEL, run, seed=3, resume=True)
    time.sleep(np.random.default_rng().uniform(0, 0.03))
    process.send_signal(signal.SIGKILL)
    said = process.communicate()
    assert process.returncode == -signal.SIGKILL, said
    assert 3 <= checks(run) < 20
    train(MODEL, run, seed=3, resume=True)
    same_runs(run, alone)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux has it")
@pytest.mark.usefixtures("by_keyboard")
def test_a_process_that_is_interrupted_once_resumes_on_one_core(alone, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_ENABLE_X64", "1")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
    config, run = tmp_path / "experiment.toml", tmp_path / "interrupted"
    config.write_text(dumps_toml(MODEL))
    process = start(tmp_path, "--config", config, "--seed", 3, "--out", run, slow=True)
    await_checks(process, run, 3)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=600)[1]
    assert process.returncode == 130, said
    assert f"foveate train --resume {run}" in said
    assert "Traceback" not in said
    assert 3 <= checks(run) < 20
    cores = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(cores)})
        process = start(tmp_path, "--resume", run)
        said = process.communicate(timeout=600)
    finally:
        os.sched_setaffinity(0, cores)
    assert process.returncode == 0, said
    same_runs(run, alone)


@pytest.fixture
def by_keyboard():
    """Ctrl-C as on a terminal: a suite that is started in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.slow
@pytest.mark.usefixtures("by_keyboard")
def test_an_interrupt_saves_and_prints_how_to_resume(alone, tmp_path, monkeypatch, capsys):
    run, config, save = tmp_path / "run", tmp_path / "experiment.toml", RunFiles.save
    config.write_text(dumps_toml(MODEL))

    def interrupted(*arguments):
        if checks(run) == 4:
            signal.raise_signal(signal.SIGINT)  # before anything of the fifth check is written
        save(*arguments)

    monkeypatch.setattr(RunFiles, "save", interrupted)
    assert main(["train", "--config", str(config), "--seed", "3", "--out", str(run)]) == 130
    said = capsys.readouterr().err
    assert "when the current validation is saved" in said
    assert f"foveate train --resume {run}\n" in said
    assert checks(run) == 5
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert main(["train", "--resume", str(run), "--no-verdict"]) == 0
    same_runs(run, alone)


@pytest.mark.slow
@pytest.mark.usefixtures("by_keyboard")
def test_a_second_interrupt_stops_at_once(tmp_path, monkeypatch, capsys):
    run, config = tmp_path / "run", tmp_path / "experiment.toml"
    config.write_text(dumps_toml(MODEL))
    monkeypatch.setattr(RunFiles, "save", lambda *arguments: [signal.raise_signal(signal.SIGINT) for _ in range(2)])
    assert main(["train", "--config", str(config), "--out", str(run)]) == 130
    assert f"foveate train --resume {run}\n" in capsys.readouterr().err
    assert checks(run) == 0


@pytest.mark.slow
def test_a_full_disk_leaves_the_old_files(tmp_path, monkeypatch, capsys):
    """For real: no file may grow beyond what fits the first checks."""
    run, config, save = tmp_path / "run", tmp_path / "experiment.toml", RunFiles.save
    config.write_text(dumps_toml(MODEL))
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = []

    def full(*arguments):
        if checks(run) == 3:
            before.extend([(run / path).read_bytes() for path in (BEST, LAST)])
            resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limit[1]))
        save(*arguments)

    monkeypatch.setattr(RunFiles, "save", full)
    try:
        assert main(["train", "--config", str(config), "--seed", "3", "--out", str(run)]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    said = capsys.readouterr().err
    assert "File too large" in said
    assert str(run) in said
    assert f"foveate train --resume {run}\n" in said
    assert "Traceback" not in said
    assert before == [(run / path).read_bytes() for path in (BEST, LAST)]
    assert not list(run.rglob("*.tmp"))


@pytest.fixture
def no_root():
    """Whoever may write anywhere is nobody for a while."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_a_folder_that_cannot_be_written_to(capsys, no_root):
    assert main(["train", "--epochs", "1", "--out", "/foveate-run"]) == 2
    assert capsys.readouterr().err == "foveate: /foveate-run: Permission denied\n"


def test_a_beginning_that_was_killed_is_begun_again(tmp_path):
    run = tmp_path / "run"
    (run / "checkpoint").mkdir(parents=True)
    (run / METRICS).write_bytes(b"")
    (run / "checkpoint" / ".0123456789abcdef.tmp").write_bytes(b"half")
    require_free(run, MODEL)
    with pytest.raises(ValueError, match=rf"{run}: holds no training to resume: begin one there"):
        stored_run(run)
    (run / "thesis.tex").write_text("mine")
    with pytest.raises(ValueError, match="exists already"):
        train(MODEL, run)
    assert sorted(path.name for path in run.iterdir()) == ["checkpoint", METRICS, "thesis.tex"]
