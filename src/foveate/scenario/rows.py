"""Numbers of a scene as a file has them: lists, checked one by one."""

from typing import Any

from foveate.errors import InputError
from foveate.geometry.space import Space
from foveate.io.validate import require

MAX_LENGTH = 1e9
"""Largest length [m]: beyond it no precision has digits left for the agent's view."""


def table_of(value: Any, where: str, width: int) -> tuple[tuple[float, ...], ...]:
    """A list of rows of `width` numbers. Raises InputError for anything else."""
    require(isinstance(value, list), where, value, f"expected a list of rows of {width} numbers")
    return tuple(_row(row, f"{where}[{i}]", width) for i, row in enumerate(value))


def pose_of(value: Any, where: str, space: Space) -> tuple[float, ...]:
    """The numbers of a pose in `space`. Raises InputError for anything else."""
    pose = _row(value, where, None)
    try:
        space.from_numbers(pose)
    except InputError as error:
        raise InputError(f"{where} = {list(pose)}: {error}") from None
    return pose


def poses_of(value: Any, where: str, space: Space) -> tuple[tuple[float, ...], ...]:
    """The numbers of several poses. Raises InputError for anything else."""
    require(isinstance(value, list), where, value, "expected a list of poses")
    return tuple(pose_of(pose, f"{where}[{i}]", space) for i, pose in enumerate(value))


def _row(value: Any, where: str, width: int | None) -> tuple[float, ...]:
    fits = isinstance(value, list) and (width is None or len(value) == width)
    numbers = fits and all(type(x) in (int, float) for x in value)
    require(numbers, where, value, f"expected {'' if width is None else f'{width} '}numbers in a list")
    in_range = all(abs(x) <= MAX_LENGTH for x in value)
    require(in_range, where, value, f"expected finite numbers up to {MAX_LENGTH:g}")
    return tuple(float(x) for x in value)
