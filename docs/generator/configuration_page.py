"""Generate the page of all configuration keys from the dataclasses that read them and their docstrings."""

import ast
import inspect
import re
import textwrap
import types
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.io.toml import dumps_toml

INTRODUCTION = """# Configuration

All keys of a run's `config.toml`, which `foveate train --config` reads and `foveate fit` writes. For one to change,
write `foveate config PRESET > mine.toml`; to change single keys, `foveate train --set scenario.view.depth_m=5`. Keys
have defaults unless marked *required*. An unknown or mistyped key is rejected in one line that names the key, its value
and what would be right. In Python, `foveate.Experiment`, `foveate.Scenario` and the
[records in them](api/scenarios.md) have the same names.

If a table has several kinds, its first key selects one (`kind`, `shape` or `algorithm`). A matrix is a list of rows.
Presets are configurations too; the last section shows one.
"""
EXAMPLE = """## Example: the preset `quadrotor`

```toml
{preset}
```
"""
TAGS = ("kind", "shape", "algorithm")
NUMBERS = str.maketrans("23456789", "²³⁴⁵⁶⁷⁸⁹")
UNIT = re.compile(r"(?:_(per))?_(m|s|rad|deg)(\d?)((?:_s\d?)*)$")


def page() -> str:
    """Return the whole page as Markdown."""
    preset = dumps_toml(PRESETS["quadrotor"]).strip()
    return "\n\n".join([INTRODUCTION, *_sections(), EXAMPLE.format(preset=preset)])


def unit(name: str) -> str:
    """Return the unit at the end of a key, in the usual notation: m/s for `v_max_m_s`; "" for a key without a unit."""
    found = UNIT.search(name)
    if found is None:
        return ""
    per, first, power, rest = found.groups()
    top = f"{first}{power.translate(NUMBERS)}"
    below = "".join(f"/{part.translate(NUMBERS)}" for part in rest.split("_")[1:])
    return f"1/{top}{below}" if per else f"{top}{below}"


def said_of(cls: type) -> dict[str, str]:
    """Return the docstring below each field of a dataclass and of its bases."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__[:-1]):
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for field, text in zip(body.body, body.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and _text(text):
                found[field.target.id] = " ".join(inspect.cleandoc(_text(text)).split())
    return found


def untold(cls: type) -> list[str]:
    """Return the keys that neither the docstrings of the class and its bases nor a docstring of their own explain."""
    prose = " ".join(base.__doc__ or "" for base in cls.__mro__[:-1])
    hints, known = get_type_hints(cls), (*said_of(cls), *TAGS)
    keys = [field.name for field in fields(cls) if not _dataclasses(hints[field.name])]
    return [key for key in keys if key not in known and f"`{key}`" not in prose]


def tables(cls: type = Experiment, path: str = "") -> Iterator[tuple[str, type]]:
    """Yield dotted path and dataclass of every table of a configuration, in each of its kinds, outer tables first."""
    hints = get_type_hints(cls)
    for field in fields(cls):
        for kind in _dataclasses(hints[field.name]):
            here = f"{path}.{field.name}" if path else field.name
            yield here, kind
            yield from tables(kind, here)


def _sections() -> Iterator[str]:
    """Yield the sections of all tables; a kind that occurs in several is explained in the first."""
    explained: dict[type, str] = {}
    kinds: dict[str, list[type]] = {}
    for path, kind in tables():
        kinds.setdefault(path, []).append(kind)
    for path, several in kinds.items():
        yield f"## `[{path}]`"
        if all(kind in explained for kind in several):
            yield f"As `[{explained[several[0]]}]`: {', '.join(filter(None, map(_tag, several)))}."
            continue
        keys = [field.name for kind in several for field in fields(kind) if field.name in TAGS]
        for kind in several:
            explained[kind] = path
            if len(several) > 1:
                yield f"### {_tag(kind) or f'Without `{keys[0]}`'}"
            yield _section(kind)


def _tag(cls: type) -> str:
    """Return the TOML line that selects this kind of table, or "" if the kind has no such key."""
    found = next((field for field in fields(cls) if field.name in TAGS), None)
    return "" if found is None else f'`{found.name} = "{get_args(get_type_hints(cls)[found.name])[0]}"`'


def _section(cls: type) -> str:
    """Format one kind of table: its meaning and its keys."""
    hints, said = get_type_hints(cls), said_of(cls)
    optional = [f for f in fields(cls) if f.name in TAGS and f.default is not MISSING and not f.metadata.get("tag")]
    usual = [f"Default if `{f.name}` is left out." for f in optional]
    rows = [
        f"| `{f.name}` | {_type(hints[f.name])} | {_default(f)} | {unit(f.name)} | {said.get(f.name, '')} |"
        for f in fields(cls)
        if f.name not in TAGS and not _dataclasses(hints[f.name])
    ]
    table = ["| key | type | default | unit | |\n|---|---|---|---|---|\n" + "\n".join(rows)] if rows else []
    return "\n\n".join([*_prose(cls), *usual, *table])


def _prose(cls: type) -> list[str]:
    """Return the docstrings of the class and its bases, the most general first."""
    kinds = [kind for kind in reversed(cls.__mro__) if is_dataclass(kind)]
    return [inspect.cleandoc(kind.__doc__ or "") for kind in kinds]


def _text(node: ast.stmt) -> str:
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return str(node.value.value) if is_text else ""  # pyright: ignore[reportAttributeAccessIssue]


def _dataclasses(hint: Any) -> list[type]:
    """Return the kinds of table that a type allows; none for a plain value."""
    parts = get_args(hint)
    if not parts:
        return [hint] if is_dataclass(hint) and isinstance(hint, type) else []
    return [kind for part in parts for kind in _dataclasses(part)]


def _type(hint: Any) -> str:
    """Name a type in TOML's terms."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal:
        return " or ".join(f"`{part!r}`".replace("'", '"') for part in parts)
    if origin in (Union, types.UnionType):
        return _type(next(part for part in parts if part is not type(None)))
    if origin is not tuple:
        return {float: "number", int: "whole number", bool: "true or false", str: "text"}[hint]
    inner = _type(parts[0])
    if parts[-1] is not Ellipsis:
        return "[" + ", ".join(map(_type, parts)) + "]"
    return "matrix" if get_origin(parts[0]) is tuple and parts[0] == tuple[float, ...] else f"list of {inner}"


def _default(field: "Field[Any]") -> str:
    if field.default is MISSING:
        return "*required*"
    value = field.default
    if value is None:
        return "left out"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bool):
        return str(value).lower()
    return f'`"{value}"`' if isinstance(value, str) else str(_lists(value))


def _lists(value: Any) -> Any:
    return list(map(_lists, value)) if isinstance(value, tuple) else value
