"""Base of the settings: their types are checked when they are made, in Python as in a file."""

from dataclasses import field, fields
from functools import cache
from typing import Any, get_type_hints

import numpy as np

from foveate.io.records import At, converted


def tag(name: str) -> Any:
    """Default of the field that names a kind: a program chooses the class, but a table must give the name."""
    return field(default=name, metadata={"tag": True})


class Settings:
    """Checks the types of all fields, and makes whole numbers, lists and arrays those that the fields hold.

    A `__post_init__` of a subclass calls this one first. Raises InputError of one line with the class, the field, its
    value and what would be right.
    """

    def __post_init__(self) -> None:
        at, hints = At(source=type(self).__name__, in_python=True), _hints(type(self))
        for each in fields(self):  # type: ignore[arg-type]  # of a dataclass, as every subclass is
            value = getattr(self, each.name)
            # So that equal settings have equal digests, and all can be hashed.
            held = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
            held = converted(hints[each.name], held, at.key(each.name))
            if held is not value:
                object.__setattr__(self, each.name, held)


@cache
def _hints(cls: type) -> dict[str, Any]:
    return get_type_hints(cls)
