"""Change settings of an experiment by their dotted keys, as `foveate train --set scenario.view.depth_m=5`."""

import tomllib
from collections.abc import Sequence
from typing import Any

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.io.records import from_table, to_table

TAGS = ("kind", "shape", "algorithm")
"""Keys that select the kind of their table: another kind has other keys, so the old ones go."""


def with_changes(experiment: Experiment, changes: Sequence[str]) -> Experiment:
    """Apply changes "KEY=VALUE", with the key as in a TOML file of tables, and a value as there.

    Quotes around a text may be left out; "KEY=" leaves out a key that need not be there. Raises InputError as for a
    TOML file with these changes.
    """
    table = to_table(experiment)
    parted = [_parted(change) for change in changes]
    # What selects a kind comes first, since it clears its table.
    for keys, value in sorted(parted, key=lambda change: change[0][-1] not in TAGS):
        _put(table, keys, value)
    return from_table(Experiment, table, "--set") if changes else experiment


def _parted(change: str) -> tuple[list[str], Any]:
    """Split a change into the parts of its key, and its value."""
    key, equals, text = change.partition("=")
    keys = [part.strip() for part in key.split(".")]
    if not equals or not all(keys):
        raise InputError(f"--set {change}: expected KEY=VALUE, as scenario.view.depth_m=5")
    if not text.strip():
        return keys, None
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        parsed = {}
    return keys, parsed["value"] if list(parsed) == ["value"] else text.strip()


def _put(table: dict[str, Any], keys: Sequence[str], value: Any) -> None:
    """Set a value in nested tables."""
    *path, last = keys
    for part in path:
        inner = table.get(part)
        table[part] = inner if isinstance(inner, dict) else {}
        table = table[part]
    if last in TAGS and table.get(last) != value:
        table.clear()
    table[last] = value
