"""Checks that settings share: each raises a ValueError of one line that names the field, its value and the right."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from foveate.errors import InputError

LEAST, MOST = 1e-18, 1e12


MOST_THINGS = 1_000_000
"""Most episodes, starts or iterations that can be asked for: all are held in memory at once, and counted in int32."""


Matrix = tuple[tuple[float, ...], ...]


def require(condition: bool, name: str, value: object, right: str) -> None:
    """Raise ValueError unless the condition holds."""
    if not condition:
        raise InputError(f"{name} = {value!r}: {right}")


def positive(settings: object, *names: str) -> None:
    """Raise ValueError unless each of these fields is > 0."""
    for name in names:
        require(getattr(settings, name) > 0, name, getattr(settings, name), "expected > 0")


def not_negative(settings: object, *names: str) -> None:
    """Raise ValueError unless each of these fields is >= 0."""
    for name in names:
        require(getattr(settings, name) >= 0, name, getattr(settings, name), "expected >= 0")


def seed_number(seed: int, name: str) -> None:
    """Raise ValueError for a seed that is no seed."""
    if not 0 <= seed < 2**32:
        raise InputError(f"{name} {seed}: expected a whole number from 0 to {2**32 - 1}")


def check_count(value: int | None, name: str) -> None:
    """Raise InputError for a number of things that is given, and is not from 1 to MOST_THINGS."""
    if value is not None and value < 1:
        raise InputError(f"{name} {value}: expected >= 1")
    if value is not None and value > MOST_THINGS:
        raise InputError(f"{name} {value}: expected <= {MOST_THINGS}")


def representable(settings: Any, path: str = "", least: float = LEAST) -> None:
    """Raise ValueError unless float32 knows all numbers in it, and squares: 0, or from 1e-18 to 1e12 in size.

    An element of a matrix may be smaller than that: beside the others it is 0.
    """
    if is_dataclass(settings):
        for field in fields(settings):
            representable(getattr(settings, field.name), f"{path}.{field.name}".lstrip("."))
    elif isinstance(settings, tuple):
        for i, item in enumerate(settings):
            representable(item, f"{path}[{i}]", 0.0)
    elif isinstance(settings, int | float):
        fits = bool(settings == 0 or least <= abs(settings) <= MOST)
        require(fits, path, settings, f"expected 0 or a size from {LEAST:g} to {MOST:g}")


def matrix(value: Matrix, name: str, shape: tuple[int | None, int | None]) -> np.ndarray:
    """The matrix that rows of numbers make; None in `shape` is any size."""
    rows = {len(row) for row in value}
    require(len(rows) == 1 and 0 not in rows, name, value, "expected a matrix with rows of one length")
    found = np.array(value, float)
    require(bool(np.isfinite(found).all()), name, value, "expected finite numbers")
    fits = all(want is None or have == want for have, want in zip(found.shape, shape, strict=True))
    wanted = " x ".join("any" if size is None else str(size) for size in shape)
    require(fits, name, value, f"expected shape {wanted}, got {found.shape[0]} x {found.shape[1]}")
    return found


def covariance(value: Matrix, name: str, size: int, definite: bool) -> np.ndarray:
    """A symmetric matrix without negative eigenvalues, or `definite`: with positive ones only."""
    found = matrix(value, name, (size, size))
    scale = np.abs(found).max()
    require(bool(np.abs(found - found.T).max() <= 1e-9 * scale), name, value, "a covariance is symmetric")
    smallest = np.linalg.eigvalsh(found).min()
    if definite:
        require(_is_definite(found), name, value, "expected positive definite (all eigenvalues > 0), also in float32")
    else:
        require(bool(smallest >= -1e-12 * scale), name, value, "a covariance has no negative eigenvalue")
    return found


def _is_definite(found: np.ndarray) -> bool:
    """Whether the correlations are definite as float32 holds them; what scales the axes have costs no digits."""
    variances = np.diag(found)
    if variances.min() <= 0:
        return False
    correlations = (found / np.sqrt(np.outer(variances, variances))).astype(np.float32).astype(float)
    return bool(np.linalg.eigvalsh(correlations).min() > 1e-6)
