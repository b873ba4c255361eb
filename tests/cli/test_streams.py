"""Standard streams that are closed, full or cannot encode a name end no command with a traceback."""

import errno
import io
import os
import shlex
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from foveate.cli.main import main
from foveate.cli.streams import steady_streams
from foveate.io import files

ROWS = ["time_s,track_id,x_m,y_m", *(f"{0.1 * t:.1f},a,{0.1 * t:.2f},{0.03 * t * t:.3f}" for t in range(80))]


def shell(folder: Path, words: str) -> subprocess.CompletedProcess[str]:
    """Run `words`, in which foveate stands for the command, by a shell in this folder."""
    command = words.replace("foveate", f"{shlex.quote(sys.executable)} -m foveate")
    return subprocess.run(["sh", "-c", command], cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "r.csv").write_text("\n".join(ROWS))
    return tmp_path


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
@pytest.mark.parametrize(
    ("words", "status"),
    [
        ("foveate --version >&-", 0),
        ("foveate --version >&- 2>&- <&-", 0),
        ("foveate fit --help >&-", 0),
        ("foveate fit missing.csv --out x.toml 2>&-", 2),
        ("foveate fit missing.csv --out x.toml 2>/dev/full", 2),
        ("(foveate --help; echo $? >status) | true; exit $(cat status)", 0),
    ],
)
def test_closed_streams(folder: Path, words: str, status: int):
    done = shell(folder, words)
    assert done.returncode == status
    assert not done.stdout
    assert not done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has it")
def test_a_full_disk_is_named(folder: Path):
    done = shell(folder, "foveate --version >/dev/full")
    assert (done.returncode, done.stderr) == (2, "foveate: standard output: No space left on device\n")


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
def test_a_command_finishes_its_files_though_nobody_reads_it(folder: Path):
    """Also where it starts with closed descriptors, which the files that it opens would take."""
    done = shell(folder, "(foveate fit r.csv --out x.toml; echo $? >status) | true; exit $(cat status)")
    assert (done.returncode, done.stderr) == (0, "")
    closed = shell(folder, "foveate fit r.csv --out y.toml >&- 2>&- <&-")
    assert closed.returncode == 0
    assert (folder / "x.toml").read_bytes() == (folder / "y.toml").read_bytes()


class Full(io.RawIOBase):
    """A device without space, whose descriptor is that of a file."""

    def __init__(self, file: io.FileIO) -> None:
        self.file = file

    def writable(self) -> bool:
        return True

    def write(self, _: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fileno(self) -> int:
        return self.file.fileno()


def test_in_this_process_nobody_reads_the_pipe():
    """What is left in the buffer goes nowhere, also at the end of Python; what is printed later is not even tried."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as pipe:
        with redirect_stdout(pipe), steady_streams():
            print("nobody reads this")
            sys.stdout.flush()
            print("nor this", flush=True)
        assert os.fstat(writing).st_mode == os.stat(os.devnull).st_mode


@pytest.mark.parametrize("flushes", [False, True])
def test_in_this_process_a_full_device_is_named_on_output_and_ignored_for_messages(tmp_path: Path, flushes: bool):
    with (tmp_path / "out").open("wb", buffering=0) as file:
        full = io.TextIOWrapper(Full(file), write_through=not flushes)
        with redirect_stderr(full), steady_streams():
            print("a message", file=sys.stderr, flush=flushes)
    with (tmp_path / "out").open("wb", buffering=0) as file:
        full = io.TextIOWrapper(Full(file), write_through=not flushes)
        with redirect_stdout(full), steady_streams(), pytest.raises(OSError, match="No space left") as caught:
            print("a result", flush=flushes)
        assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, "standard output")


def test_in_this_process_a_stream_without_a_descriptor_may_fail():
    class Failing(io.StringIO):
        def write(self, _: str) -> int:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    with redirect_stdout(Failing()), steady_streams(), pytest.raises(OSError, match="standard output"):
        print("x")


def test_in_this_process_without_streams(monkeypatch: pytest.MonkeyPatch):
    """As Python has it where it starts with closed descriptors, or under pythonw."""
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    with steady_streams():
        print("x", flush=True)
        assert sys.stdout.write("four") == 4
        assert not sys.stdout.isatty()
        assert not sys.stderr.getvalue()
    assert sys.stdout is None


@pytest.mark.skipif(sys.platform == "win32", reason="needs descriptors")
def test_in_this_process_a_closed_descriptor_is_opened_again():
    """So that a file opened later does not become standard input."""
    kept = os.dup(0)
    try:
        os.close(0)
        with steady_streams():
            assert os.read(0, 1) == b""
            with Path(__file__).open() as file:
                assert file.fileno() > 2
    finally:
        os.dup2(kept, 0)
        os.close(kept)


def test_names_that_a_terminal_cannot_encode_are_escaped(tmp_path: Path):
    with (tmp_path / "out").open("w", encoding="ascii") as file, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", file)
        with steady_streams():
            print("é \udcff ±")
    assert (tmp_path / "out").read_text() == "\\xe9 \\udcff \\xb1\n"


def test_links_in_a_circle_are_named(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(folder)
    os.symlink("loop", "loop")
    os.symlink("b", "a")
    os.symlink("a", "b")
    for words in (
        "fit loop --out x.toml",
        "fit r.csv --out loop",
        "fit r.csv --out a/x.toml",
        "evaluate loop",
        "evaluate paper --scenes a",
        "evaluate paper --json b",
        "train --config loop",
        "export paper loop",
        "replay paper loop",
    ):
        status = main(words.split())
        said = capsys.readouterr()
        assert status == 2, (words, said)
        assert len(said.err.splitlines()) == 1, said.err
        assert any(name in said.err for name in ("loop", "a", "b"))
    assert Path("loop").is_symlink()


def test_a_user_without_a_home_has_a_cache(monkeypatch: pytest.MonkeyPatch):
    def unknown() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", unknown)
    folder = files.cache_folder("plans")
    assert folder == files.cache_folder("plans")
    assert folder.parents[1].stat().st_mode & 0o077 == 0, "no other user can write into it"
