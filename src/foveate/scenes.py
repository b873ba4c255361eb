"""Scenes: where agent and targets start and how the targets drift. In memory and in files."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foveate.files import content_digest, read_document, write_document
from foveate.geometry.space import Space
from foveate.scenario import SceneSettings

VERSION = 1
MAX_HORIZON = 100_000
MAX_LENGTH = 1e9
"""Larger lengths [m] have no digits left for the agent's view, in any precision."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One scene as in a scenes file. Lengths in metres, drift in m/s, one row a target."""

    id: str
    agent: tuple[float, ...]
    targets: tuple[tuple[float, ...], ...]
    drift: tuple[tuple[float, ...], ...]
    horizon: int

    @property
    def motion(self) -> str:
        """`unbiased` where every drift is 0, else `biased`."""
        return "biased" if any(any(row) for row in self.drift) else "unbiased"


def write_scenes(path: Path, scenes: Sequence[Scene]) -> None:
    """Write a scenes file."""
    write_document(path, "scenes", VERSION, {"scenes": [asdict(scene) for scene in scenes]})


def scenes_digest(scenes: Sequence[Scene]) -> str:
    """What tells these scenes from all others."""
    return content_digest([asdict(scene) for scene in scenes])[:16]


def checked(scenes: Sequence[Scene], space: Space, settings: SceneSettings) -> list[Scene]:
    """The scenes, for an agent that lives in `space`. Raises ValueError as `read_scenes`."""
    # As they would stand in a file; whoever makes them may have put arrays into them.
    rows = json.dumps([asdict(scene) for scene in scenes], default=lambda array: np.asarray(array).tolist())
    return _scenes(json.loads(rows), "scenes", space, settings)


def read_scenes(path: Path, space: Space, settings: SceneSettings) -> list[Scene]:
    """Read a scenes file for an agent that lives in `space`; a missing horizon is the scenario's.

    Raises ValueError in one line that names file, scene, field and what would be right.
    """
    data = read_document(path, "scenes", VERSION, "scenes file")
    if unknown := sorted(set(data) - {"scenes"}):
        raise ValueError(f"{path}: unknown key {unknown[0]!r}: expected digest, format, scenes, version")
    return _scenes(data.get("scenes"), f"{path}: scenes", space, settings)


def _scenes(rows: Any, where: str, space: Space, settings: SceneSettings) -> list[Scene]:
    if not isinstance(rows, list) or not rows:
        raise ValueError(f"{where}: expected a list of at least one scene")
    scenes = [_scene(row, f"{where}[{i}]", space, settings) for i, row in enumerate(rows)]
    if twice := [name for name, count in Counter(scene.id for scene in scenes).items() if count > 1]:
        raise ValueError(f"{where}: id {twice[0]!r} is given twice: expected one scene an id")
    return scenes


def _scene(row: Any, where: str, space: Space, settings: SceneSettings) -> Scene:
    if not isinstance(row, dict):
        raise ValueError(f"{where}: expected an object with id, agent, targets")
    known = ("id", "agent", "targets", "drift", "horizon")
    for name in known[:3]:
        if name not in row:
            raise ValueError(f"{where}: no {name!r}: expected id, agent and targets")
    if unknown := sorted(set(row) - set(known)):
        raise ValueError(f"{where}: unknown key {unknown[0]!r}: expected {', '.join(known)}")
    if not isinstance(row["id"], str) or not row["id"]:
        raise ValueError(f"{where}: id = {row['id']!r}: expected a non-empty text")
    where = f"{where} ({row['id']!r})"
    agent = _row(row["agent"], f"{where}: agent", None)
    try:
        space.from_numbers(agent)
    except ValueError as error:
        raise ValueError(f"{where}: agent = {list(agent)}: {error}") from None
    targets = _rows(row["targets"], f"{where}: targets", space.dimension)
    drift = ((0.0,) * space.dimension,) * len(targets)
    if row.get("drift") is not None:
        drift = _rows(row["drift"], f"{where}: drift", space.dimension)
    if len(drift) != len(targets):
        raise ValueError(f"{where}: drift has {len(drift)} rows: expected {len(targets)}, one a target")
    horizon = row.get("horizon", settings.horizon(len(targets)))
    if isinstance(horizon, bool) or not isinstance(horizon, int) or not 1 <= horizon <= MAX_HORIZON:
        raise ValueError(f"{where}: horizon = {horizon!r}: expected a whole number from 1 to {MAX_HORIZON}")
    return Scene(id=row["id"], agent=agent, targets=targets, drift=drift, horizon=horizon)


def _rows(value: Any, where: str, width: int) -> tuple[tuple[float, ...], ...]:
    if not isinstance(value, list):
        raise ValueError(f"{where} = {value!r}: expected a list of rows of {width} numbers")
    return tuple(_row(row, f"{where}[{i}]", width) for i, row in enumerate(value))


def _row(value: Any, where: str, width: int | None) -> tuple[float, ...]:
    fits = isinstance(value, list) and (width is None or len(value) == width)
    if not fits or not all(isinstance(x, int | float) and not isinstance(x, bool) for x in value):
        wanted = "" if width is None else f"{width} "
        raise ValueError(f"{where} = {value!r}: expected {wanted}numbers in a list")
    if not all(abs(x) <= MAX_LENGTH for x in value):
        raise ValueError(f"{where} = {value!r}: expected finite numbers up to {MAX_LENGTH:g}")
    return tuple(float(x) for x in value)
