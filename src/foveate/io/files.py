"""Atomic writing of files, and reading of them with one-line errors."""

import atexit
import errno
import functools
import hashlib
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from foveate.errors import InputError
from foveate.io.strict_json import parse_json

LOCK = ".lock"
"""Lock file in a folder that only one process may write to."""
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)
MAX_TEXT_BYTES = 64 << 20
"""Largest text file that is read: parsed, it takes ten to thirty times as much memory."""
MAX_BYTES = 2 << 30
"""Largest file of arrays that is read."""
PART_BYTES = 1 << 20
"""What is read of a file at once, at first; later as much as was read before."""
_TEMPORARY = re.compile(r"\.[0-9a-f]{16}\.tmp")


def cache_folder(name: str) -> Path:
    """Folder foveate/`name` in this user's cache, where the system keeps caches, for files that can be recreated.

    A user without a home gets a temporary one: one that others can write to must not hold what is read back.
    """
    from platformdirs import user_cache_path

    try:
        Path.home()
    except RuntimeError:
        if not os.environ.get("XDG_CACHE_HOME"):
            return _temporary_cache() / "foveate" / name
    return user_cache_path("foveate", appauthor=False, opinion=False) / name


@functools.cache
def _temporary_cache() -> Path:
    folder = tempfile.mkdtemp(prefix="foveate-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def file_error(path: str | Path, problem: str) -> InputError:
    """Error of one line about a file, or a place in it."""
    return InputError(" ".join(f"{path}: {problem}".splitlines()))


def write_atomic(path: str | Path, data: bytes) -> None:
    """Write `data` so that a crash leaves the old file or the new one, never a part.

    Raises InputError if `path` or its folder is unsuitable, and OSError naming `path` if the system fails.
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    if os.path.isdir(path):
        raise file_error(path, "is a folder; name a file")
    if os.path.exists(path) and not os.path.isfile(path):
        with named(path):
            Path(path).write_bytes(data)  # a device or a pipe: replacing /dev/null by a file would be a disaster
        return
    if not target.parent.is_dir():
        raise file_error(path, f"there is no folder {target.parent}; make it first or name another")
    temporary = target.parent / f".{secrets.token_hex(8)}.tmp"
    try:
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException as error:  # also an interrupt from the keyboard leaves nothing behind
        with suppress(OSError):  # a second failure would hide the first
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _with_name(error, path) from error
        raise
    if hasattr(os, "O_DIRECTORY"):  # Windows cannot open a folder, and needs no sync of the rename
        handle = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def append_line(path: Path, line: str) -> None:
    """Append a line to a text file in one write: a crash leaves all of it, or a part without its end."""
    with named(path), path.open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")


@contextmanager
def named(path: str | Path) -> Iterator[None]:
    """Name the file in errors of the system."""
    try:
        yield
    except OSError as error:
        raise _with_name(error, path) from error


def _with_name(error: OSError, path: str | Path) -> OSError:
    """The same error about `path`: that of a full disk names no file, or a temporary one."""
    return OSError(error.errno, error.strerror, str(path))


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes, and remove temporary files of killed ones. Locks end with the process.

    Raises InputError if another process holds the lock. A file system without locks is written without.
    """
    from filelock import FileLock, Timeout

    # A lock by the existence of a file, its substitute where there are no others, would outlive a killed process.
    lock = FileLock(folder / LOCK, blocking=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout as error:
        raise file_error(folder, "another process is writing into it: wait, or choose another folder") from error
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    try:
        for path in [*folder.iterdir(), *folder.glob("*/.*")]:
            if is_temporary(path):
                path.unlink(missing_ok=True)
        yield
    finally:
        lock.release()


def is_temporary(path: Path) -> bool:
    """True for a file that a killed `write_atomic` left."""
    return _TEMPORARY.fullmatch(path.name) is not None


def write_json(path: str | Path, obj: Any) -> None:
    """Write `obj` as JSON, atomically. Raises InputError on NaN and infinity."""
    try:
        text = json.dumps(obj, allow_nan=False, indent=1)
    except ValueError as error:
        raise file_error(path, f"cannot be written: {error}; use null where there is no number") from error
    write_atomic(path, text.encode() + b"\n")


def content_digest(content: Any) -> str:
    """SHA-256, in hex, of JSON content, whatever its order and spacing. Raises ValueError on NaN and infinity."""
    text = json.dumps(content, allow_nan=False, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_document(path: str | Path, kind: str, version: int, content: dict[str, Any]) -> None:
    """Write JSON with its format, version and a digest that reveals later changes. Raises as `write_json`."""
    header = {"format": f"foveate-{kind}", "version": version}
    try:
        digest = content_digest({**header, **content})
    except ValueError as error:
        raise file_error(path, f"cannot be written: {error}; use null where there is no number") from error
    write_json(path, {**header, "digest": digest, **content})


def read_document(path: str | Path, kind: str, newest: int, label: str) -> dict[str, Any]:
    """Read the content of a JSON file of format "foveate-`kind`" and version 1 to `newest`, without header and digest.

    A missing digest is accepted, since other programs write such files; a wrong one is not. `label` names the file in
    errors.
    """
    document = read_json(path, label)
    if not isinstance(document, dict):
        raise file_error(path, f"is not a {label}: expected an object of the format 'foveate-{kind}'")
    is_sealed, recorded = "digest" in document, document.pop("digest", None)
    check_format(path, document, kind, newest)
    if is_sealed and recorded != content_digest(document):
        hint = "after a change by hand delete that"
        raise file_error(path, f"is damaged, or was changed by hand: it does not fit its digest ({hint})")
    return {name: value for name, value in document.items() if name not in ("format", "version")}


def check_format(path: str | Path, header: dict[str, Any], kind: str, newest: int) -> None:
    """Raise InputError unless a header has format "foveate-`kind`" and version 1 to `newest`."""
    name, version = header.get("format"), header.get("version")
    if name != f"foveate-{kind}":
        raise file_error(path, f"has the format {name!r}; expected 'foveate-{kind}'")
    if type(version) is not int or version < 1:
        raise file_error(path, f"has the version {version!r}; expected a whole number from 1 to {newest}")
    if version > newest:
        raise file_error(path, f"has version {version}; this foveate reads 1 to {newest}, use a newer one")


def read_bytes(path: str | Path, label: str, most: int = MAX_BYTES) -> bytes:
    """Read a file of at most `most` bytes. The InputError for one that cannot be read asks for a `label`."""
    try:
        with open(path, "rb") as file:
            is_short, data = os.fstat(file.fileno()).st_size <= most, b""
            # In parts: a device, as /dev/zero, has no size and no end, and one large request would take its memory.
            while is_short and len(data) <= most and (part := file.read(max(PART_BYTES, len(data)))):
                data += part
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL character
        reasons = {FileNotFoundError: "there is no such file", IsADirectoryError: "is a folder"}
        other = f"cannot be read ({getattr(error, 'strerror', None) or error})"
        raise file_error(path, f"{reasons.get(type(error), other)}; give the name of a {label}") from error
    if not is_short or len(data) > most:
        raise file_error(path, f"has more than {most} bytes; give the name of a {label}")
    return data


def read_text(path: str | Path, label: str, most: int = MAX_TEXT_BYTES) -> str:
    """Read a UTF-8 file, with or without byte-order mark. Raises as `read_bytes`, and if it is not UTF-8."""
    try:
        return read_bytes(path, label, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise file_error(path, f"byte {error.start} is not UTF-8; save the {label} as UTF-8 text") from error


def read_json(path: str | Path, label: str) -> Any:
    """Read a JSON file. Raises as `read_text`, and if the file is cut short or not strict JSON."""
    text = read_text(path, label)
    try:
        return parse_json(text)
    except json.JSONDecodeError as error:
        cut = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated string")
        problem = "is empty or cut short" if cut else "is not JSON"
        place = f"{error.msg} at line {error.lineno}, column {error.colno}"
        raise file_error(path, f"{problem} ({place}); give a complete {label}") from error
    except InputError as error:
        raise file_error(path, f"is not a usable {label}: {error}") from error
