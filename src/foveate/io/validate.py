"""Checks of values from users: each raises InputError of one line, "name = value: expected ..."."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from foveate.errors import InputError

SMALLEST, LARGEST = 1e-18, 1e12
"""Range of absolute values whose squares float32 represents."""
MAX_COUNT = 1_000_000
"""Most episodes, starts or iterations of a run: all are held in memory at once, and counted in int32."""
Matrix = tuple[tuple[float, ...], ...]


def require(condition: bool | np.bool, name: str, value: object, right: str) -> None:
    """Raise InputError "name = value: right" unless the condition holds."""
    if not condition:
        raise InputError(f"{name} = {value!r}: {right}")


def positive(settings: object, *names: str) -> None:
    """Raise InputError unless each of these fields is > 0."""
    for name in names:
        require(getattr(settings, name) > 0, name, getattr(settings, name), "expected > 0")


def at_least(least: int, settings: object, *names: str) -> None:
    """Raise InputError unless each of these fields is None or >= `least`."""
    for name in names:
        value = getattr(settings, name)
        require(value is None or value >= least, name, value, f"expected >= {least}")


def seed_number(seed: int, name: str) -> None:
    """Raise InputError unless the seed is in 0 .. 2^32 - 1."""
    if not _is_whole(seed) or not 0 <= seed < 2**32:
        raise InputError(f"{name} {seed}: expected a whole number from 0 to {2**32 - 1}")


def check_count(value: int | None, name: str) -> None:
    """Raise InputError unless a count is None or from 1 to MAX_COUNT."""
    if value is not None and not _is_whole(value):
        raise InputError(f"{name} {value}: expected a whole number")
    if value is not None and not 1 <= value <= MAX_COUNT:
        raise InputError(f"{name} {value}: expected {'>= 1' if value < 1 else f'<= {MAX_COUNT}'}")


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def representable(settings: Any, path: str = "", least: float = SMALLEST) -> None:
    """Raise InputError unless float32 can represent the numbers in settings, and their squares.

    Numbers are 0 or of absolute value 1e-18 to 1e12. Elements of a matrix may be smaller: beside the others they are 0.
    """
    if is_dataclass(settings):
        for field in fields(settings):
            representable(getattr(settings, field.name), f"{path}.{field.name}".lstrip("."))
    elif isinstance(settings, tuple):
        for i, item in enumerate(settings):
            representable(item, f"{path}[{i}]", 0.0)
    elif isinstance(settings, int | float):
        fits = settings == 0 or least <= abs(settings) <= LARGEST
        require(fits, path, settings, f"expected 0 or a size from {SMALLEST:g} to {LARGEST:g}")


def matrix(value: Matrix, name: str, shape: tuple[int | None, int | None]) -> np.ndarray:
    """Return rows of numbers as an array of this shape; None stands for any size. Raises InputError if they differ."""
    rows = {len(row) for row in value}
    require(len(rows) == 1 and 0 not in rows, name, value, "expected a matrix with rows of one length")
    array = np.array(value, float)
    require(np.isfinite(array).all(), name, value, "expected finite numbers")
    fits = all(right in (None, size) for size, right in zip(array.shape, shape, strict=True))
    expected = " x ".join("any" if size is None else str(size) for size in shape)
    require(fits, name, value, f"expected shape {expected}, got {array.shape[0]} x {array.shape[1]}")
    return array


def covariance(value: Matrix, name: str, size: int, definite: bool) -> np.ndarray:
    """Return rows of numbers as a covariance matrix. Raises InputError unless it is semidefinite, or `definite`."""
    array = matrix(value, name, (size, size))
    scale = np.abs(array).max()
    require(np.abs(array - array.T).max() <= 1e-9 * scale, name, value, "a covariance is symmetric")
    if definite:
        require(_is_definite(array), name, value, "expected positive definite (all eigenvalues > 0), also in float32")
    else:
        is_semidefinite = np.linalg.eigvalsh(array).min() >= -1e-12 * scale
        require(is_semidefinite, name, value, "a covariance has no negative eigenvalue")
    return array


def _is_definite(array: np.ndarray) -> bool:
    """Test that the correlations are definite in float32; different scales of the axes cost no digits."""
    variances = np.diag(array)
    if variances.min() <= 0:
        return False
    correlations = (array / np.sqrt(np.outer(variances, variances))).astype(np.float32).astype(float)
    return bool(np.linalg.eigvalsh(correlations).min() > 1e-6)
