"""Atomic writing of files, and reading of them with one-line errors."""

import errno
import hashlib
import json
import math
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from foveate.errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

LOCK = ".lock"
"""Lock file in a folder that only one process may write to."""
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)
_TEMPORARY = re.compile(r"\.[0-9a-f]{16}\.tmp")


def cache_folder(name: str) -> Path:
    """Folder foveate/`name` in this user's cache, for files that can be recreated."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "foveate" / name


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
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):  # a full disk names no file, or the temporary one
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    if hasattr(os, "O_DIRECTORY"):  # Windows cannot open a folder, and needs no sync of the rename
        handle = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def append_line(path: Path, line: str) -> None:
    """Append a line to a text file in one write: a crash leaves all of it, or a part without its end."""
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes, and remove temporary files of killed ones. Locks end with the process.

    Raises InputError if another process holds the lock. A file system without locks is written without.
    """
    with (folder / LOCK).open("ab") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                problem = "another process is writing into it: wait, or choose another folder"
                raise file_error(folder, problem) from error
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
        for path in [*folder.iterdir(), *folder.glob("*/.*")]:
            if is_temporary(path):
                path.unlink(missing_ok=True)
        yield


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
    recorded = document.pop("digest", None)
    check_format(path, document, kind, newest)
    try:
        fits = recorded is None or recorded == content_digest(document)
    except RecursionError as error:
        raise file_error(path, f"is not a usable {label}: {error}") from error
    if not fits:
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


def read_bytes(path: str | Path, label: str) -> bytes:
    """Read a file. The InputError for one that cannot be read asks for a `label`."""
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL character
        reasons = {FileNotFoundError: "there is no such file", IsADirectoryError: "is a folder"}
        other = f"cannot be read ({getattr(error, 'strerror', None) or error})"
        raise file_error(path, f"{reasons.get(type(error), other)}; give the name of a {label}") from error


def read_text(path: str | Path, label: str) -> str:
    """Read a UTF-8 file, with or without byte-order mark. Raises as `read_bytes`, and if it is not UTF-8."""
    try:
        return read_bytes(path, label).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise file_error(path, f"byte {error.start} is not UTF-8; save the {label} as UTF-8 text") from error


def read_json(path: str | Path, label: str) -> Any:
    """Read a JSON file. Raises as `read_text`, and if the file is cut short or not strict JSON."""
    text = read_text(path, label)
    try:
        return json.loads(text, parse_constant=_reject_constant, parse_float=_finite)
    except json.JSONDecodeError as error:
        cut = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated string")
        problem = "is empty or cut short" if cut else "is not JSON"
        place = f"{error.msg} at line {error.lineno}, column {error.colno}"
        raise file_error(path, f"{problem} ({place}); give a complete {label}") from error
    except (ValueError, RecursionError) as error:
        raise file_error(path, f"is not a usable {label}: {error}") from error


def _reject_constant(name: str) -> NoReturn:
    """Reject NaN and the infinities, which Python's parser accepts though JSON does not have them."""
    raise InputError(f"{name} is not JSON; use null where there is no number")


def _finite(digits: str) -> float:
    number = float(digits)
    if not math.isfinite(number):
        raise InputError(f"the number {digits:.40} is too large; give one below 1.8e308")
    return number
