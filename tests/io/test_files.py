"""Files are written whole or not at all; reading errors are one line that names the file."""

import errno
import math
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foveate.errors import InputError
from foveate.io import files
from foveate.io.files import read_bytes, read_json, write_atomic, write_json


def test_write_replaces_the_old_content_and_leaves_no_other_file(tmp_path: Path):
    path = tmp_path / "result.json"
    write_atomic(path, b"old")
    write_atomic(path, b"new")
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["result.json"]


def test_write_gives_the_permissions_of_an_ordinary_file(tmp_path: Path):
    (tmp_path / "ordinary").write_bytes(b"")
    write_atomic(tmp_path / "atomic", b"")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "ordinary").stat().st_mode


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_failed_write_keeps_the_old_file_and_cleans_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str):
    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    path = tmp_path / "result.json"
    path.write_bytes(b"old")
    monkeypatch.setattr(files.os, step, fail)
    with pytest.raises(KeyboardInterrupt):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["result.json"]


def test_content_is_on_the_disk_before_the_name_and_the_name_before_the_return(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    seen = []
    fsync, replace = os.fsync, os.replace

    def log_fsync(handle: int) -> None:
        seen.append("folder" if os.path.isdir(f"/dev/fd/{handle}") else "file")
        fsync(handle)

    def log_replace(source: Path, target: Path) -> None:
        assert source.parent == target.parent == tmp_path
        seen.append("replace")
        replace(source, target)

    monkeypatch.setattr(files.os, "fsync", log_fsync)
    monkeypatch.setattr(files.os, "replace", log_replace)
    write_atomic(tmp_path / "result.json", b"new")
    assert seen == ["file", "replace", "folder"]


def test_readers_do_not_see_a_partial_file(tmp_path: Path):
    path = tmp_path / "result"
    contents = {letter * 100_000 for letter in (b"a", b"b")}
    write_atomic(path, b"a" * 100_000)
    writer = threading.Thread(target=lambda: [write_atomic(path, data) for _ in range(10) for data in contents])
    writer.start()
    while writer.is_alive():
        assert path.read_bytes() in contents
    writer.join()


def test_write_follows_a_link_and_leaves_devices_alone(tmp_path: Path):
    (tmp_path / "target").write_bytes(b"old")
    (tmp_path / "link").symlink_to("target")
    write_atomic(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_bytes() == b"new"
    (tmp_path / "null").symlink_to(os.devnull)
    write_atomic(tmp_path / "null", b"new")
    assert (tmp_path / "null").is_char_device()


def test_write_rejects_a_folder_and_a_missing_folder(tmp_path: Path):
    with pytest.raises(ValueError, match="is a folder; name a file"):
        write_atomic(tmp_path, b"")
    with pytest.raises(ValueError, match=r"there is no folder .*absent"):
        write_atomic(tmp_path / "absent" / "result.json", b"")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@settings(deadline=None, max_examples=50)
@given(value=json_values)
def test_json_round_trip(tmp_path_factory: pytest.TempPathFactory, value: object):
    path = tmp_path_factory.getbasetemp() / "value.json"
    write_json(path, value)
    assert read_json(path, "value") == value


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_json_rejects_numbers_that_are_not_finite(tmp_path: Path, number: float):
    path = tmp_path / "rows.json"
    with pytest.raises(ValueError, match=r"rows\.json: cannot be written: .*use null"):
        write_json(path, {"rows": [{"score": number}]})
    assert not path.exists()


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is empty or cut short"),
        (b'{"format": "foveate-sc', "is empty or cut short"),
        (b'{"scenes": [1, 2,', "is empty or cut short"),
        (b"id,x,y\n1,2,3\n", "is not JSON .*line 1, column 1"),
        (b'{"scenes": []} tail', "is not JSON .*line 1, column 16"),
        (b'{"id": "\xff"}', "byte 8 is not UTF-8"),
        (b'{"score": NaN}', "NaN is not JSON; use null"),
        (b'{"score": -Infinity}', "-Infinity is not JSON; use null"),
        (b'{"score": 1e999}', "the number 1e999 is too large"),
        (b"9" * 5000, "is not a usable scenes file"),
        (b"[" * 100_000, "is not a usable scenes file"),
    ],
)
def test_json_error_names_the_fault_and_the_expected(tmp_path: Path, content: bytes, problem: str):
    path = tmp_path / "scenes.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"scenes\.json: .*{problem}") as caught:
        read_json(path, "scenes file")
    assert len(str(caught.value).splitlines()) == 1
    assert "Error" not in str(caught.value)


def test_json_may_start_with_a_byte_order_mark(tmp_path: Path):
    (tmp_path / "scenes.json").write_bytes(b"\xef\xbb\xbf{}")
    assert read_json(tmp_path / "scenes.json", "scenes file") == {}


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("absent.json", "there is no such file; give the name of a scenes file"),
        (".", "is a folder; give the name of a scenes file"),
        ("nul\0.json", "cannot be read"),
        ("two\nlines.json", "there is no such file"),
        ("x" * 300, "cannot be read .*[Ff]ile name too long"),
    ],
)
def test_unreadable_file_is_one_line(tmp_path: Path, name: str, problem: str):
    with pytest.raises(ValueError, match=problem) as caught:
        read_bytes(tmp_path / name, "scenes file")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("read", [read_bytes, files.read_text])
def test_a_file_is_read_up_to_its_bound_and_no_further(tmp_path: Path, read: Callable[..., object]):
    path = tmp_path / "scenes.json"
    path.write_bytes(b"x" * 3_000_000)
    assert read(path, "scenes file", 3_000_000)
    with pytest.raises(ValueError, match=r"scenes\.json: has more than 2999999 bytes; give the name of a scenes file"):
        read(path, "scenes file", 2_999_999)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has them")
def test_devices_without_end_and_without_room_are_named():
    with pytest.raises(ValueError, match="/dev/zero: has more than 5000000 bytes"):
        read_bytes("/dev/zero", "scenes file", 5_000_000)
    for write in (lambda: write_atomic("/dev/full", b"x"), lambda: files.append_line(Path("/dev/full"), "x")):
        with pytest.raises(OSError, match="No space left") as caught:
            write()
        assert caught.value.filename == "/dev/full"


def test_a_folder_has_one_writer_and_its_lock_ends_with_it(tmp_path: Path):
    with files.sole_writer(tmp_path), pytest.raises(InputError, match="another process"), files.sole_writer(tmp_path):
        pass
    (tmp_path / ".0123456789abcdef.tmp").write_bytes(b"")
    with files.sole_writer(tmp_path):
        assert os.listdir(tmp_path) == [files.LOCK]


def test_a_file_system_without_locks_is_written_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    fcntl = pytest.importorskip("fcntl")

    def flock(*given: object) -> None:
        raise OSError(errno.ENOSYS, "no locks")

    monkeypatch.setattr(fcntl, "flock", flock)
    with files.sole_writer(tmp_path), files.sole_writer(tmp_path):
        assert set(os.listdir(tmp_path)) <= {files.LOCK}


def test_caches_are_where_linux_keeps_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert files.cache_folder("plans") == tmp_path / "foveate" / "plans"
    assert not (tmp_path / "foveate").exists()
