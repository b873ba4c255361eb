"""Files written whole or not at all, and read with errors that say in one line what is wrong."""

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
    """Folder foveate/`name` in this user's cache, for things that can be made again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "foveate" / name


def file_error(path: str | Path, problem: str) -> InputError:
    """Error about a file or a place in it, as one line that starts with its name."""
    return InputError(" ".join(f"{path}: {problem}".splitlines()))


def write_atomic(path: str | Path, data: bytes) -> None:
    """Write `data` so that a crash leaves the old file or the new one, never a part.

    Raises InputError where `path` is a folder or its folder is missing, OSError naming `path` where the system rejects.
    """
    target = Path(os.path.realpath(path))  # a link keeps pointing where it did
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
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Bring a rename inside `folder` to the disk."""
    if not hasattr(os, "O_DIRECTORY"):  # Windows cannot open a folder, and needs no sync of it
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
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
    """Lock a folder against every other process that asks for it, until the end of this one at the latest.

    Temporary files that killed writes have left there are removed. On a file system without locks there is none. Raises
    InputError where another process has the folder.
    """
    with (folder / LOCK).open("ab") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise file_error(
                    folder, "another process is writing into it: wait, or choose another folder"
                ) from error
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
    """Write `obj` as JSON, whole or not at all. Raises ValueError on NaN and infinity."""
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
    """Write JSON with its "format", "version", and a "digest" by which a later change is noticed.

    Raises ValueError on NaN and infinity.
    """
    document = {"format": f"foveate-{kind}", "version": version, **content}
    try:
        digest = content_digest(document)
    except ValueError as error:
        raise file_error(path, f"cannot be written: {error}; use null where there is no number") from error
    write_json(path, {"format": document["format"], "version": version, "digest": digest, **content})


def read_document(path: str | Path, kind: str, newest: int, what: str) -> dict[str, Any]:
    """Content of a JSON file of format "foveate-`kind`" and version 1 to `newest`, without these keys and the digest.

    Others may write such files without a digest; one that is there must fit. Raises InputError in one line.
    """
    document = read_json(path, what)
    if not isinstance(document, dict):
        raise file_error(path, f"is not a {what}: wanted an object of the format 'foveate-{kind}'")
    recorded = document.pop("digest", None)
    check_format(path, document, kind, newest)
    try:
        fits = recorded is None or recorded == content_digest(document)
    except RecursionError as error:
        raise file_error(path, f"is not a usable {what}: {error}") from error
    if not fits:
        raise file_error(
            path, "is damaged, or was changed by hand: it does not fit its digest (after a change by hand delete that)"
        )
    return {name: value for name, value in document.items() if name not in ("format", "version")}


def check_format(path: str | Path, header: dict[str, Any], kind: str, newest: int) -> None:
    """Raise InputError unless a header says format "foveate-`kind`" and version 1 to `newest`."""
    name, version = header.get("format"), header.get("version")
    if name != f"foveate-{kind}":
        raise file_error(path, f"has the format {name!r}; wanted 'foveate-{kind}'")
    if type(version) is not int or version < 1:
        raise file_error(path, f"has the version {version!r}; wanted a whole number from 1 to {newest}")
    if version > newest:
        raise file_error(path, f"has version {version}; this foveate reads 1 to {newest}, use a newer one")


def read_bytes(path: str | Path, what: str) -> bytes:
    """Content of a file. Raises InputError, which asks for a `what`, where it cannot be read."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError as error:
        raise file_error(path, f"there is no such file; give the name of a {what}") from error
    except IsADirectoryError as error:
        raise file_error(path, f"is a folder; give the name of a {what}") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL character
        reason = getattr(error, "strerror", None) or error
        raise file_error(path, f"cannot be read ({reason}); give the name of a {what}") from error


def read_text(path: str | Path, what: str) -> str:
    """The text of a UTF-8 file, with or without byte-order mark. Raises InputError where it has none."""
    try:
        return read_bytes(path, what).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise file_error(path, f"byte {error.start} is not UTF-8; save the {what} as UTF-8 text") from error


def read_json(path: str | Path, what: str) -> Any:
    """The content of a JSON file. Raises InputError where it is missing, cut short or not strict JSON."""
    text = read_text(path, what)
    try:
        return json.loads(text, parse_constant=_reject_constant, parse_float=_finite)
    except json.JSONDecodeError as error:
        cut = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated string")
        problem = "is empty or cut short" if cut else "is not JSON"
        place = f"{error.msg} at line {error.lineno}, column {error.colno}"
        raise file_error(path, f"{problem} ({place}); give a complete {what}") from error
    except (ValueError, RecursionError) as error:
        raise file_error(path, f"is not a usable {what}: {error}") from error


def _reject_constant(name: str) -> NoReturn:
    """Reject NaN and the infinities, which Python's parser takes though JSON has none."""
    raise InputError(f"{name} is not JSON; use null where there is no number")


def _finite(digits: str) -> float:
    """Number from its digits. Raises InputError where it is too large for a float."""
    number = float(digits)
    if not math.isfinite(number):
        raise InputError(f"the number {digits:.40} is too large; give one below 1.8e308")
    return number
