"""Checks that settings share: each raises a ValueError of one line that names the field, its value and the right."""

import numpy as np

Matrix = tuple[tuple[float, ...], ...]


def require(condition: bool, name: str, value: object, right: str) -> None:
    """Raise ValueError unless the condition holds."""
    if not condition:
        raise ValueError(f"{name} = {value!r}: {right}")


def positive(settings: object, *names: str) -> None:
    """Raise ValueError unless each of these fields is > 0."""
    for name in names:
        require(getattr(settings, name) > 0, name, getattr(settings, name), "expected > 0")


def not_negative(settings: object, *names: str) -> None:
    """Raise ValueError unless each of these fields is >= 0."""
    for name in names:
        require(getattr(settings, name) >= 0, name, getattr(settings, name), "expected >= 0")


def matrix(value: Matrix, name: str, shape: tuple[int | None, int | None]) -> np.ndarray:
    """The matrix that rows of numbers make; None in `shape` is any size."""
    rows = {len(row) for row in value}
    require(len(rows) == 1 and 0 not in rows, name, value, "expected a matrix with rows of one length")
    found = np.array(value, float)
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
        require(bool(smallest > 1e-12 * scale), name, value, "expected positive definite (all eigenvalues > 0)")
    else:
        require(bool(smallest >= -1e-12 * scale), name, value, "a covariance has no negative eigenvalue")
    return found
