"""Strict JSON: keys once, finite numbers, bounded depth."""

import json
import math
from typing import Any, NoReturn

from foveate.errors import InputError

MAX_DEPTH = 64
"""Most lists and objects in one another; foveate's files have ten at most."""


def parse_json(text: str) -> Any:
    """Parse JSON.

    Raises json.JSONDecodeError where it is not JSON, and InputError for what Python's parser takes beyond: a key given
    twice (the last would win), NaN, infinities, numbers that become infinite, whole numbers of thousands of digits, and
    more than `MAX_DEPTH` levels, which functions that walk through the content could not follow.
    """
    try:
        parsed = json.loads(
            text, parse_constant=_reject_constant, parse_float=_finite, parse_int=_whole, object_pairs_hook=_once
        )
    except RecursionError:
        raise _too_deep() from None
    level = [parsed]
    for _ in range(MAX_DEPTH + 1):
        inside = (part.values() if isinstance(part, dict) else part for part in level if isinstance(part, dict | list))
        level = [item for items in inside for item in items]
        if not level:
            return parsed
    raise _too_deep()


def _too_deep() -> InputError:
    return InputError(f"has more than {MAX_DEPTH} lists and objects in one another")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Reject a key that is given twice: which of its values is meant, only its writer knows."""
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in table if names.count(name) > 1)
        raise InputError(f"the key {twice!r:.60} is given twice; give it once")
    return table


def _reject_constant(name: str) -> NoReturn:
    raise InputError(f"{name} is not JSON; use null where there is no number")


def _finite(digits: str) -> float:
    number = float(digits)
    if not math.isfinite(number):
        raise InputError(f"the number {digits:.40} is too large; give one below 1.8e308")
    return number


def _whole(digits: str) -> int:
    if len(digits) > 4000:  # Python itself reads 4300 at most
        raise InputError(f"the number {digits:.40} .. is too large; give one below 1.8e308")
    return int(digits)
