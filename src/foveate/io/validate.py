"""Checks of values from users: each raises an InputError of one line, "name = value: expected ..."."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from foveate.errors import InputError

SMALLEST, LARGEST = 1e-18, 1e12
"""Sizes of numbers whose squares float32 still represents."""


MOST_THINGS = 1_000_000
"""Most episodes, starts or iterations that can be asked for: all are held in memory at once, and counted in int32."""


Matrix = tuple[tuple[float, ...], ...]


def require(condition: bool | np.bool, name: str, value: object, right: str) -> None:
    """Raise InputError "name = value: right" unless the condition holds."""
    if not condition:
        raise InputError(f"{name} = {value!r}: {right}")


def positive(settings: object, *names: str) -> None:
    """Raise InputError unless each of these fields is > 0."""
    for name in names:
        require(getattr(settings, name) > 0, name, getattr(settings, name), "expected > 0")


def not_negative(settings: object, *names: str) -> None:
    """Raise InputError unless each of these fields is >= 0."""
    for name in names:
        require(getattr(settings, name) >= 0, name, getattr(settings, name), "expected >= 0")


def seed_number(seed: int, name: str) -> None:
    """Raise InputError unless the seed is in 0 .. 2^32 - 1."""
    if not 0 <= seed < 2**32:
        raise InputError(f"{name} {seed}: expected a whole number from 0 to {2**32 - 1}")


def check_count(value: int | None, name: str) -> None:
    """Raise InputError for a number of things that is given, and is not from 1 to MOST_THINGS."""
    if value is not None and value < 1:
        raise InputError(f"{name} {value}: expected >= 1")
    if value is not None and value > MOST_THINGS:
        raise InputError(f"{name} {value}: expected <= {MOST_THINGS}")


def representable(settings: Any, path: str = "", least: float = SMALLEST) -> None:
    """Raise InputError unless float32 can represent all numbers in settings, and their squares.

    Numbers are 0, or from 1e-18 to 1e12 in size. An element of a matrix may be smaller: beside the others it is 0.
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
    """Matrix from rows of numbers; None in `shape` stands for any size. Raises InputError where it does not fit."""
    rows = {len(row) for row in value}
    require(len(rows) == 1 and 0 not in rows, name, value, "expected a matrix with rows of one length")
    array = np.array(value, float)
    require(np.isfinite(array).all(), name, value, "expected finite numbers")
    fits = all(want is None or have == want for have, want in zip(array.shape, shape, strict=True))
    wanted = " x ".join("any" if size is None else str(size) for size in shape)
    require(fits, name, value, f"expected shape {wanted}, got {array.shape[0]} x {array.shape[1]}")
    return array


def covariance(value: Matrix, name: str, size: int, definite: bool) -> np.ndarray:
    """Covariance matrix from rows of numbers: symmetric, semidefinite, or positive `definite`. Raises InputError."""
    array = matrix(value, name, (size, size))
    scale = np.abs(array).max()
    require(np.abs(array - array.T).max() <= 1e-9 * scale, name, value, "a covariance is symmetric")
    smallest = np.linalg.eigvalsh(array).min()
    if definite:
        require(_is_definite(array), name, value, "expected positive definite (all eigenvalues > 0), also in float32")
    else:
        require(smallest >= -1e-12 * scale, name, value, "a covariance has no negative eigenvalue")
    return array


def _is_definite(array: np.ndarray) -> bool:
    """Test that float32 holds the correlations as definite; different scales of the axes cost no digits."""
    variances = np.diag(array)
    if variances.min() <= 0:
        return False
    correlations = (array / np.sqrt(np.outer(variances, variances))).astype(np.float32).astype(float)
    return bool(np.linalg.eigvalsh(correlations).min() > 1e-6)
