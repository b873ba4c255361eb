"""Strict translation between TOML tables and frozen keyword-only dataclasses.

A field may be a bool, int, float, str, Literal, another dataclass, a tuple of any of these (`tuple[X, ...]`
or `tuple[X, Y]`), any of them `| None`, or a union of dataclasses `A | B` with a Literal field of the same name, the
tag, in each. One member may lack the tag or have a default for it, and is selected by a table without it. A dataclass
with other fields raises TypeError, wrong input InputError.
"""

import json
import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from foveate.io.files import check_format, content_digest, file_error, read_text, write_atomic
from foveate.io.records import T, from_table, to_table, with_first_names

VERSION = 1
"""Version of the files that `save_toml` writes."""
MAX_KEY_PARTS = 20
"""Most parts that a dotted key in a file may have; foveate's have three at most."""
MAX_TOML_BYTES = 4 << 20
"""Largest configuration that is read; foveate's have a few thousand bytes."""
_PIECES, _QUOTED = re.compile(r"[=,{}\[\]#\n]"), re.compile(r"[\"'][ \t]*\.|\.[ \t]*[\"']")


def load_toml(cls: type[T], path: str | Path, on_change: Callable[[str], None] | None = None) -> T:
    """Read an instance of the dataclass `cls` from a TOML file. Raises as `read_toml`."""
    return read_toml(cls, path, on_change)[0]


def read_toml(cls: type[T], path: str | Path, on_change: Callable[[str], None] | None = None) -> tuple[T, str]:
    """Read an instance of the dataclass `cls` from a TOML file, and the digest of the file's content.

    The digest stays the same when `cls` gets further fields. Raises InputError of one line, naming file and key, also
    if the content has changed since `save_toml` sealed it: unless there is `on_change`, which is told so.
    """
    text = read_text(path, "configuration file (TOML)", MAX_TOML_BYTES)
    if _has_long_key(text):
        raise file_error(path, f"has a key of more than {MAX_KEY_PARTS} parts; give one as foveate writes it")
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # besides TOMLDecodeError: numbers of thousands of digits
        raise file_error(path, f"is not TOML: {error}") from error
    if not table:
        raise file_error(path, "is empty; give a configuration file with at least one key")
    header = {name: table.pop(name) for name in ("format", "version", "digest") if name in table}
    if header:
        check_format(path, header, cls.__name__.lower(), VERSION)
    instance = from_table(cls, table, str(path))
    content = content_digest(with_first_names(table, instance))[:16]
    if header.get("digest", content) != content:
        if on_change is None:
            hint = "if you changed it yourself, delete its line 'digest = ..'"
            raise file_error(path, f"is cut short, damaged, or was changed: it does not fit its digest; {hint}")
        on_change(f"{path}: was changed since foveate wrote it (its digest does not fit): taken as it is now")
    return instance, content


def _has_long_key(text: str) -> bool:
    """Detect keys on which Python's parser would spend days: its time grows with the square of a key's parts."""
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    is_long = any(piece.count(".") > MAX_KEY_PARTS for piece in _PIECES.split(lines))
    return is_long or len(_QUOTED.findall(lines)) > 10 * MAX_KEY_PARTS


def save_toml(instance: Any, path: str | Path, header: str = "", sealed: bool = True) -> None:
    """Write a dataclass as the text of `document`."""
    write_atomic(path, document(instance, header, sealed).encode())


def document(instance: Any, header: str = "", sealed: bool = True) -> str:
    """Return a dataclass as TOML with its format and version, after `header` as a comment.

    A `sealed` text has a digest, by which `load_toml` detects every change: not for files that people edit.
    """
    # The digest comes first, so that a truncated file still has it.
    seal, hint = [f'digest = "{digest(instance)}"'], ["After a change by hand delete the line that begins with: digest"]
    comment = _comment("\n".join([header, *hint * sealed]).strip())
    name = f'format = "foveate-{type(instance).__name__.lower()}"'
    lines = [*comment, *seal * sealed, name, f"version = {VERSION}", "", dumps_toml(instance)]
    return "\n".join(lines)


def dumps_toml(instance: Any, header: str = "") -> str:
    """Return TOML text that reads back as `instance`, after `header` as a comment. Raises as `to_table`."""
    return "\n".join([*_comment(header), *_toml_lines(to_table(instance), "")]) + "\n"


def _comment(text: str) -> list[str]:
    return [f"# {line}".rstrip() for line in text.splitlines()]


def digest(instance: Any) -> str:
    """Digest of the content of `instance` in 16 hex digits, the same in every process. Raises as `to_table`."""
    return content_digest(with_first_names(to_table(instance), instance))[:16]


def _toml_lines(table: dict[str, Any], path: str) -> Iterator[str]:
    """Lines of a table: plain keys first, since all that follows a heading belongs to the heading."""
    for key, value in sorted(table.items(), key=lambda item: isinstance(item[1], dict)):
        if isinstance(value, dict):
            heading = f"{path}.{_toml_key(key)}" if path else _toml_key(key)
            yield from ("", f"[{heading}]", *_toml_lines(value, heading))
        else:
            yield f"{_toml_key(key)} = {_toml_value(value)}"


def _toml_key(name: str) -> str:
    return name if name.isascii() else _toml_value(name)


def _toml_value(value: Any) -> str:
    """Format a value on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml_key(key)} = {_toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    # JSON writes numbers, truth values and texts as TOML does, except for the one control character it keeps.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
