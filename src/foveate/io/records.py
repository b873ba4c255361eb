"""Strict translation between tables of TOML and frozen keyword-only dataclasses, as toml.py says."""

import difflib
import sys
from collections.abc import Iterable
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from foveate.errors import InputError
from foveate.io.files import file_error

T = TypeVar("T")
_DESCRIPTIONS = {int: "a whole number", float: "a finite number", bool: "true or false", str: "a text in quotes"}


@dataclass(frozen=True, kw_only=True)
class At:
    """Place in a file or table, or in an object `in_python`, for error messages."""

    source: str
    path: str = ""
    in_python: bool = False

    def key(self, name: str) -> "At":
        """Place of a key here."""
        return replace(self, path=f"{self.path}.{name}" if self.path else name)

    def item(self, index: int) -> "At":
        """Place of an item of the list here."""
        return replace(self, path=f"{self.path}[{index}]")

    def error(self, problem: str) -> InputError:
        """Error of a problem here."""
        return file_error(self.source, f"{self.path}: {problem}" if self.path else problem)

    def invalid(self, value: Any, problem: str) -> InputError:
        """Error of the value here."""
        place = f"{self.path} = " if self.path else ""
        return file_error(self.source, f"{place}{_quoted(value)}: {problem}")


def from_table(cls: type[T], table: dict[str, Any], where: str) -> T:
    """Return an instance of the dataclass `cls` from a table; missing keys take the class's defaults.

    Keys in the ClassVar `RENAMED` of a dataclass may have their old name, and those in `REMOVED`, which have lost their
    meaning, are ignored; a static method `inherited` then completes its table. InputError is one line that names the
    source `where`, the dotted path of the key, its value and what would be right: for unknown, mistyped and missing
    keys, numbers that are not finite, and whatever `__post_init__` rejects.
    """
    return _record(cls, table, At(source=where))


def to_table(instance: Any) -> dict[str, Any]:
    """Return the table that `from_table` reads back as `instance`, without fields that are None.

    Raises InputError for numbers that are not finite, and None in a field with another default.
    """
    at = At(source=type(instance).__name__)
    # Read back once: whole numbers in float fields become floats, so that equal instances give equal tables.
    read_back = _record(type(instance), _plain(instance, at), at)
    if read_back != instance:
        raise at.error("would read back otherwise; None can be written only where it is the default")
    return _plain(read_back, at)


def with_first_names(table: dict[str, Any], instance: Any) -> dict[str, Any]:
    """Name every key of the table of `instance` as it was named first, so that a digest outlives a renaming."""
    renamed = getattr(instance, "RENAMED", {})
    first = {new: old for old, new in renamed.items()}
    named = {}
    for key, value in table.items():
        name = renamed.get(key, key)
        part = getattr(instance, name, None)  # None for a removed key
        is_table = is_dataclass(part) and isinstance(value, dict)
        named[first.get(name, name)] = with_first_names(value, part) if is_table else value
    return named


def suggestion(name: str, known: Iterable[str]) -> str:
    """Hint for an unknown name: the closest of the known names, or the first nine."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {near[0]}?" if near else f"known are {', '.join(names[:9])}{', ..' * (len(names) > 9)}"


def _record(cls: Any, table: Any, at: At) -> Any:
    if at.in_python:
        return _object([cls], table, at)
    if not isinstance(table, dict):
        raise at.invalid(table, "expected a table")
    table = getattr(cls, "inherited", dict)(_with_current_names(cls, table, at))
    hints = get_type_hints(cls)
    settable = {field.name: field for field in fields(cls) if field.init}
    for key in table:
        if key not in settable:
            raise at.key(key).invalid(table[key], f"unknown key; {suggestion(key, settable)}")
    values = {name: converted(hints[name], table[name], at.key(name)) for name in settable if name in table}
    for name, field in settable.items():
        if name in table or _has_default(field):
            continue
        if NoneType not in get_args(hints[name]):
            raise at.key(name).error(f"is missing; expected {_description(hints[name])}")
        values[name] = None
    try:
        return cls(**values)
    except InputError as error:
        raise at.error(str(error)) from error


def _with_current_names(cls: Any, table: dict[str, Any], at: At) -> dict[str, Any]:
    """Replace the keys in the ClassVar `RENAMED` of a dataclass by their current names; drop those in `REMOVED`."""
    renamed = getattr(cls, "RENAMED", {})
    for old in table.keys() & renamed.keys():
        if renamed[old] in table:
            raise at.key(old).invalid(table[old], f"is the former name of {renamed[old]}: give one of them")
    removed = getattr(cls, "REMOVED", ())
    return {renamed.get(key, key): value for key, value in table.items() if key not in removed}


def converted(hint: Any, value: Any, at: At) -> Any:
    """Convert `value`, plain or, in Python, an object of the right class, to the type `hint`."""
    origin = get_origin(hint)
    if is_dataclass(hint):
        return _record(hint, value, at)
    if origin in (Union, UnionType):
        return _member(hint, value, at)
    if origin is Literal:
        return _choice(get_args(hint), value, at)
    if origin is tuple:
        return _tuple(hint, value, at)
    if hint not in _DESCRIPTIONS:
        raise TypeError(f"{at.path}: a configuration cannot hold {hint}")
    fits = isinstance(value, int | float if hint is float else hint) and (hint is bool or not isinstance(value, bool))
    if not fits or (hint is float and not abs(value) <= sys.float_info.max):
        raise at.invalid(value, f"expected {_DESCRIPTIONS[hint]}")
    return float(value) if hint is float else value


def _tuple(hint: Any, value: Any, at: At) -> tuple[Any, ...]:
    """Convert a list to a tuple, of any length for `tuple[X, ...]`."""
    parts = get_args(hint)
    if not isinstance(value, list | tuple):
        raise at.invalid(value, f"expected {_description(hint)}")
    if len(parts) == 2 and parts[1] is Ellipsis:
        parts = (parts[0],) * len(value)
    if len(value) != len(parts):
        raise at.invalid(value, f"expected {_description(hint)}, not {len(value)}")
    return tuple(converted(part, value[i], at.item(i)) for i, part in enumerate(parts))


def _choice(options: Iterable[Any], value: Any, at: At) -> Any:
    """Return the option that equals `value`, in type too, since True == 1."""
    for option in options:
        if type(option) is type(value) and option == value:
            return option
    raise at.invalid(value, f"expected {_one_of(options)}")


def _member(hint: Any, value: Any, at: At) -> Any:
    """Convert `value` to the member of a union that its tag selects."""
    members = [member for member in get_args(hint) if member is not NoneType]
    if value is None and NoneType in get_args(hint):
        return None
    if len(members) == 1:
        return converted(members[0], value, at)
    if at.in_python:
        return _object(members, value, at)
    tag, selected = _tag(members)
    if not isinstance(value, dict):
        raise at.invalid(value, "expected a table")
    if tag in value:
        options = [option for option in selected if option is not None]
        return _record(selected[_choice(options, value[tag], at.key(tag))], value, at)
    # A table without the tag selects the member that lacks the field, or has a default for it.
    lacking = [m for m in members if all(field.name != tag or _has_default(field) for field in fields(m))]
    if len(lacking) != 1:
        raise at.key(tag).error(f"is missing; expected {_one_of(selected)}")
    return _record(lacking[0], value, at)


def _object(classes: list[Any], value: Any, at: At) -> Any:
    """Return `value`, an object of one of the classes."""
    if not isinstance(value, tuple(classes)):
        raise at.invalid(value, f"expected {' or '.join(cls.__name__ for cls in classes)}")
    return value


def _tag(members: list[Any]) -> tuple[str, dict[Any, Any]]:
    """Return the Literal field by which dataclasses differ, and the member that each of its values selects.

    None selects the member without the field, so that a second kind can join one whose tables have no tag.
    """
    hints = [get_type_hints(member) for member in members] if all(map(is_dataclass, members)) else []
    for name in dict.fromkeys(name for hint in hints for name in hint):
        types = [hint.get(name) for hint in hints]
        if None in types and any(field.name == name and _has_default(field) for m in members for field in fields(m)):
            continue
        are_literals = all(each is None or get_origin(each) is Literal for each in types)
        literals = [get_args(each) or (None,) for each in types]
        selected = {tag: member for tags, member in zip(literals, members, strict=True) for tag in tags}
        if are_literals and len(selected) == sum(map(len, literals)):
            return name, selected
    raise TypeError(f"no Literal field tells {', '.join(map(str, members))} apart")


def _has_default(field: Field[Any]) -> bool:
    """True if tables may leave the field out."""
    return (field.default is not MISSING or field.default_factory is not MISSING) and not field.metadata.get("tag")


def _plain(value: Any, at: At) -> Any:
    """Convert `value` to types that TOML has."""
    if is_dataclass(value):
        items = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
        return {name: _plain(item, at.key(name)) for name, item in items.items() if item is not None}
    if isinstance(value, tuple):
        return [_plain(item, at.item(i)) for i, item in enumerate(value)]
    if not isinstance(value, bool | int | float | str):
        raise at.invalid(value, "expected a number, text, truth value, tuple or dataclass")
    return value


def _description(hint: Any) -> str:
    """Describe the values of a field of type `hint`."""
    parts = [part for part in get_args(hint) if part not in (NoneType, Ellipsis)]
    if get_origin(hint) is Literal:
        return _one_of(parts)
    words = " or ".join(dict.fromkeys(map(_description, parts)))
    if get_origin(hint) is tuple:
        count = "" if Ellipsis in get_args(hint) else f"{len(parts)} "
        return f"a list of {count}values, each {words}"
    return words or _DESCRIPTIONS.get(hint, "a table")


def _one_of(options: Iterable[Any]) -> str:
    names = [repr(option) for option in options]
    return names[0] if len(names) == 1 else f"one of {', '.join(names)}"


def _quoted(value: Any) -> str:
    """Python's text of `value`, cut to fit in a line."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print whole numbers of more than 4300 digits
        return "a number of thousands of digits"
    except RecursionError:
        return "a table in a table, hundreds deep"
    return text if len(text) <= 60 else text[:57] + "..."
