"""Strict translation between TOML tables and frozen keyword-only dataclasses.

A field may be a bool, int, float, str, Literal, another dataclass, a tuple of any of these (`tuple[X, ...]`
or `tuple[X, Y]`), any of them `| None`, or a union of dataclasses `A | B` that are told apart by a Literal
field of the same name in each; one of them may lack it or have a default, and is meant where a table has none.
TypeError marks a dataclass with other fields, InputError wrong input.
"""

import hashlib
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from foveate.io.files import check_format, file_error, read_text, write_atomic
from foveate.io.records import T, from_table, to_table

VERSION = 1
"""Version of the files that `save_toml` writes."""


MAX_KEY_PARTS = 20
"""Largest number of parts of a dotted key that is read; ours have three at most."""


_PIECES, _QUOTED = re.compile(r"[=,{}\[\]#\n]"), re.compile(r"[\"'][ \t]*\.|\.[ \t]*[\"']")


def load_toml(cls: type[T], path: str | Path) -> T:
    """Instance of the dataclass `cls` from a TOML file. Raises InputError of one line, naming file and key."""
    return read_toml(cls, path)[0]


def read_toml(cls: type[T], path: str | Path) -> tuple[T, str]:
    """Instance of the dataclass `cls` from a TOML file, and the digest of the file's content.

    The digest stays the same when `cls` gets further fields. Raises InputError of one line, naming file and key: also
    where `save_toml` wrote the file and its content has changed since.
    """
    text = read_text(path, "configuration file (TOML)")
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
    instance, content = from_table(cls, table, str(path)), _digest(table)
    if header.get("digest", content) != content:
        hint = "if you changed it yourself, delete its line 'digest = ..'"
        raise file_error(path, f"is cut short, damaged, or was changed: it does not fit its digest; {hint}")
    return instance, content


def _has_long_key(text: str) -> bool:
    """True for text that Python's parser would take too long for: its time grows with the square of a key's parts.

    A key of half a million parts would take days.
    """
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    return len(_QUOTED.findall(lines)) > 10 * MAX_KEY_PARTS or any(
        part.count(".") > MAX_KEY_PARTS for part in _PIECES.split(lines)
    )


def save_toml(instance: Any, path: str | Path, header: str = "", sealed: bool = True) -> None:
    """Write `instance` as TOML with its format and version, for `load_toml` of this and later versions.

    Args:
        instance: A dataclass.
        path: The file.
        header: Text of a comment at the top.
        sealed: Add a digest, by which `load_toml` notices every change; not for files that people are to edit.
    """
    # The digest comes first, so that a file that was cut short still has it.
    seal, hint = [f'digest = "{digest(instance)}"'], ["After a change by hand delete the line that begins with: digest"]
    comment = "\n".join([header, *hint * sealed]).strip()
    known = [f'format = "foveate-{type(instance).__name__.lower()}"', f"version = {VERSION}"]
    lines = [*_comment(comment), *seal * sealed, *known, "", dumps_toml(instance)]
    write_atomic(path, "\n".join(lines).encode())


def dumps_toml(instance: Any, header: str = "") -> str:
    """TOML text that reads back as `instance`, after `header` as a comment. Raises as `to_table`."""
    return "\n".join([*_comment(header), *_toml_lines(to_table(instance), "")]) + "\n"


def _comment(text: str) -> list[str]:
    return [f"# {line}".rstrip() for line in text.splitlines()]


def digest(instance: Any) -> str:
    """Sixteen hex digits for the content of `instance`, the same in every process. Raises as `to_table`."""
    return _digest(to_table(instance))


def _digest(table: dict[str, Any]) -> str:
    canonical = json.dumps(table, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:16]


def _toml_lines(table: dict[str, Any], path: str) -> Iterator[str]:
    """The lines of a table: plain keys first, since all that follows a heading belongs to it."""
    for key, value in table.items():
        if not isinstance(value, dict):
            yield f"{_toml_key(key)} = {_toml_value(value)}"
    for key, value in table.items():
        if isinstance(value, dict):
            heading = f"{path}.{_toml_key(key)}" if path else _toml_key(key)
            yield from ("", f"[{heading}]")
            yield from _toml_lines(value, heading)


def _toml_key(name: str) -> str:
    return name if name.isascii() else _toml_value(name)


def _toml_value(value: Any) -> str:
    """One value on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml_key(key)} = {_toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    # JSON writes numbers, truth values and texts as TOML does, except for the one control character it keeps.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
