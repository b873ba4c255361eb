"""Strict translation between tables (of TOML or JSON) and frozen keyword-only dataclasses."""

import difflib
import math
from collections.abc import Iterable
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from foveate.errors import InputError
from foveate.io.files import file_error

T = TypeVar("T")


_DESCRIPTIONS = {int: "a whole number", float: "a finite number", bool: "true or false", str: "a text in quotes"}


@dataclass(frozen=True, kw_only=True)
class _At:
    """Place in a source, for error messages."""

    source: str
    path: str = ""

    def key(self, name: str) -> "_At":
        return replace(self, path=f"{self.path}.{name}" if self.path else name)

    def item(self, index: int) -> "_At":
        return replace(self, path=f"{self.path}[{index}]")

    def error(self, problem: str) -> InputError:
        return file_error(self.source, f"{self.path}: {problem}" if self.path else problem)

    def wrong(self, value: Any, problem: str) -> InputError:
        place = f"{self.path} = " if self.path else ""
        return file_error(self.source, f"{place}{_shown(value)}: {problem}")


def from_table(cls: type[T], table: dict[str, Any], where: str) -> T:
    """Instance of the dataclass `cls` from a table; keys left out take the defaults of their own class.

    Args:
        cls: A frozen, keyword-only dataclass.
        table: As TOML or JSON give it. Keys that the ClassVar `RENAMED` of a dataclass lists may have their old name.
        where: The source, for messages.

    Raises:
        InputError: In one line that names the source, the dotted path of the key, its value and what would be right:
            for unknown, mistyped and missing keys, numbers that are not finite, and whatever `__post_init__` rejects.
    """
    return _record(cls, table, _At(source=where))


def to_table(instance: Any) -> dict[str, Any]:
    """Table that `from_table` reads back as `instance`; fields that are None are left out.

    Raises InputError where no table can hold it: a number that is not finite, None where that is no default.
    """
    cls, at = type(instance), _At(source=type(instance).__name__)
    # Read back once: whole numbers in float fields become floats, so that equal instances give equal tables.
    read_back = _record(cls, _plain(instance, at), at)
    if read_back != instance:
        raise at.error("would read back otherwise; None can be written only where it is the default")
    return _plain(read_back, at)


def suggestion(name: str, known: Iterable[str]) -> str:
    """Hint for an unknown name: the closest known one, or the first of all."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {near[0]}?" if near else f"known are {', '.join(names[:9])}{', ..' * (len(names) > 9)}"


def _record(cls: Any, table: Any, at: _At) -> Any:
    """An instance of the dataclass `cls` from its table."""
    if not isinstance(table, dict):
        raise at.wrong(table, "wanted a table")
    table = _with_current_names(cls, table, at)
    hints = get_type_hints(cls)
    known = {field.name: field for field in fields(cls) if field.init}
    for key in table:
        if key not in known:
            raise at.key(key).wrong(table[key], f"unknown key; {suggestion(key, known)}")
    values = {name: _value(hints[name], table[name], at.key(name)) for name in known if name in table}
    for name, field in known.items():
        if name in table or _has_default(field):
            continue
        if NoneType not in get_args(hints[name]):
            raise at.key(name).error(f"is missing; wanted {_description(hints[name])}")
        values[name] = None
    try:
        return cls(**values)
    except InputError as error:
        raise at.error(str(error)) from error


def _with_current_names(cls: Any, table: dict[str, Any], at: _At) -> dict[str, Any]:
    """Table with old keys, those that the ClassVar `RENAMED` of a dataclass lists, under their current names."""
    renamed = getattr(cls, "RENAMED", {})
    for old in table.keys() & renamed.keys():
        if renamed[old] in table:
            raise at.key(old).wrong(table[old], f"is the former name of {renamed[old]}: give one of them")
    return {renamed.get(key, key): value for key, value in table.items()}


def _value(hint: Any, value: Any, at: _At) -> Any:
    """`value` as the type `hint`."""
    if is_dataclass(hint):
        return _record(hint, value, at)
    origin = get_origin(hint)
    if origin in (Union, UnionType):
        return _member(hint, value, at)
    if origin is Literal:
        return _choice(get_args(hint), value, at)
    if origin is tuple:
        return _tuple(hint, value, at)
    if hint is float:
        return _float(value, at)
    if hint not in _DESCRIPTIONS:
        raise TypeError(f"{at.path}: a configuration cannot hold {hint}")
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise at.wrong(value, f"wanted {_DESCRIPTIONS[hint]}")
    return value


def _float(value: Any, at: _At) -> float:
    """A finite number, whole or not."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    try:
        number = float(value) if is_number else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise at.wrong(value, f"wanted {_DESCRIPTIONS[float]}")
    return number


def _tuple(hint: Any, value: Any, at: _At) -> tuple[Any, ...]:
    """A tuple from a list, of any length for `tuple[X, ...]`."""
    parts = get_args(hint)
    if not isinstance(value, list | tuple):
        raise at.wrong(value, f"wanted {_description(hint)}")
    if len(parts) == 2 and parts[1] is Ellipsis:
        parts = (parts[0],) * len(value)
    if len(value) != len(parts):
        raise at.wrong(value, f"wanted {_description(hint)}, not {len(value)}")
    return tuple(_value(part, value[i], at.item(i)) for i, part in enumerate(parts))


def _choice(options: tuple[Any, ...], value: Any, at: _At) -> Any:
    """The one of `options` that equals `value` in type too, since True == 1."""
    for option in options:
        if type(option) is type(value) and option == value:
            return option
    raise at.wrong(value, f"wanted {_one_of(options)}")


def _member(hint: Any, value: Any, at: _At) -> Any:
    """`value` as the member of a union that its tag selects."""
    members = [member for member in get_args(hint) if member is not NoneType]
    if value is None and NoneType in get_args(hint):
        return None
    if len(members) == 1:
        return _value(members[0], value, at)
    tag, selected = _tag(members)
    if not isinstance(value, dict):
        raise at.wrong(value, "wanted a table")
    if tag not in value:
        defaults = [member for member in members if _is_default(member, tag)]
        if len(defaults) == 1:
            return _record(defaults[0], value, at)
        raise at.key(tag).error(f"is missing; wanted {_one_of(selected)}")
    options = tuple(option for option in selected if option is not None)
    return _record(selected[_choice(options, value[tag], at.key(tag))], value, at)


def _tag(members: list[Any]) -> tuple[str, dict[Any, Any]]:
    """The Literal field that tells dataclasses apart, and the member that each of its values selects.

    None selects the member that lacks the field: so a second kind can join one whose tables were written without a tag.
    Raises TypeError where no field does.
    """
    hints = [get_type_hints(member) for member in members] if all(map(is_dataclass, members)) else []
    for name in dict.fromkeys(name for hint in hints for name in hint):
        types = [hint.get(name) for hint in hints]
        if None in types and any(field.name == name and _has_default(field) for m in members for field in fields(m)):
            continue
        literals = [get_args(each) if get_origin(each) is Literal else (each,) for each in types]
        selected = {tag: member for tags, member in zip(literals, members, strict=True) for tag in tags}
        are_literals = all(each is None or get_origin(each) is Literal for each in types)
        if are_literals and len(selected) == sum(map(len, literals)):
            return name, selected
    raise TypeError(f"no Literal field tells {', '.join(map(str, members))} apart")


def _is_default(member: Any, tag: str) -> bool:
    """True where a table without the tag may mean this member: it lacks the field, or has a default for it."""
    return all(field.name != tag or _has_default(field) for field in fields(member))


def _has_default(field: Field[Any]) -> bool:
    return field.default is not MISSING or field.default_factory is not MISSING


def _plain(value: Any, at: _At) -> Any:
    """`value` in the types that TOML has."""
    if is_dataclass(value):
        items = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
        return {name: _plain(item, at.key(name)) for name, item in items.items() if item is not None}
    if isinstance(value, tuple):
        return [_plain(item, at.item(i)) for i, item in enumerate(value)]
    if not isinstance(value, bool | int | float | str):
        raise at.wrong(value, "wanted a number, text, truth value, tuple or dataclass")
    return value


def _description(hint: Any) -> str:
    """Values of a field of type `hint`, in words."""
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


def _shown(value: Any) -> str:
    """`value` as Python writes it, cut to a length that fits in a line."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print whole numbers of more than 4300 digits
        return "a number of thousands of digits"
    except RecursionError:
        return "a table in a table, hundreds deep"
    return text if len(text) <= 60 else text[:57] + "..."
