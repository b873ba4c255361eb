"""Check arguments of a command before they are parsed, for errors of one line with the nearest name."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from foveate.errors import InputError
from foveate.io.records import suggestion


def check_arguments(given: Sequence[str], commands: Mapping[str, type], repeatable: Sequence[str] = ()) -> None:
    """Raise InputError for an unknown command, option or choice, and for an option that is given twice.

    Of an option given twice the parser would take the last, unless it is `repeatable`.
    """
    if not given or given[0].startswith("-"):
        return
    if given[0] not in commands:
        raise InputError(f"{given[0]}: no such command; {suggestion(given[0], commands)}")
    choices = _options(commands[given[0]])
    names = [argument.partition("=")[0].replace("_", "-") for argument in given if argument.startswith("--")]
    for name in names:
        if name not in choices and name != "--help" and not name.startswith("--tyro-"):
            raise InputError(f"{name}: no such option of foveate {given[0]}; {suggestion(name, choices)}")
        if names.count(name) > 1 and name not in repeatable:
            raise InputError(f"{name}: is given twice: expected once, followed by all its values")
    for argument, after in zip(given, [*given[1:], ""], strict=True):
        name, is_joined, value = argument.partition("=")
        value = value if is_joined else after
        known = choices.get(name.replace("_", "-"), ())
        if known and value not in known:
            raise InputError(f"{name} {value}: expected one of {', '.join(known)}; {suggestion(value, known)}")


def _options(kind: type) -> dict[str, tuple[str, ...]]:
    """Names of the options of a command, aliases included, each with its choices if it takes one of a list."""
    found: dict[str, tuple[str, ...]] = {}
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        name, hint = field.name.replace("_", "-"), hints[field.name]
        extras = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        plain = get_args(hint)[0] if extras else hint
        names = [getattr(extra, "name", None) or name for extra in extras] or [name]
        aliases = [alias for extra in extras for alias in getattr(extra, "aliases", None) or ()]
        for each in {f"--{name}", *(f"--{each}" for each in names), *aliases}:
            found[each] = _choices(plain)
            if plain is bool:
                found[f"--no-{each.removeprefix('--')}"] = ()
    return found


def _choices(hint: Any) -> tuple[str, ...]:
    parts = [part for part in get_args(hint) if part is not NoneType]
    if get_origin(hint) is Literal:
        return get_args(hint)
    return get_args(parts[0]) if len(parts) == 1 and get_origin(parts[0]) is Literal else ()
