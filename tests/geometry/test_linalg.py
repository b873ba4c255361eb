"""Small symmetric matrices against LAPACK through numpy, in float64 and float32, with their derivatives."""

import functools
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.geometry.linalg import (
    cholesky_spd,
    inverse_spd,
    inverse_upper,
    log_det_spd,
    multiply,
    root_semidefinite,
    symmetrise,
    vech,
)

SIZES = pytest.mark.parametrize("size", [*range(1, 7), 9, 10])
DTYPES = pytest.mark.parametrize("dtype", [np.float64, np.float32])


def definite(size, count=(), condition=10.0, seed=0):
    """Random symmetric positive definite matrices with eigenvalues from 1/sqrt(condition) to sqrt(condition)."""
    rng = np.random.default_rng([seed, size])
    turn, _ = np.linalg.qr(rng.normal(size=(*count, size, size)))
    values = np.exp(rng.uniform(-0.5, 0.5, (*count, size)) * np.log(condition))
    values[..., 0] = condition**-0.5
    values[..., -1] = condition**0.5
    return np.einsum("...ij,...j,...kj->...ik", turn, values, turn)


GROUPS = {"good": slice(0, 6), "1e6": slice(6, 8), "1e10": slice(8, 10), "scaled": slice(10, 12)}


@functools.cache
def matrices(size):
    """(3, 4) matrices: good ones, badly conditioned ones, and good ones with badly scaled axes."""
    scale = np.logspace(0, -4, size)
    kinds = [
        definite(size, (6,)),
        definite(size, (2,), 1e6, 1),
        definite(size, (2,), 1e10, 2),
        scale[:, None] * definite(size, (2,), seed=3) * scale,
    ]
    return np.concatenate(kinds).reshape(3, 4, size, size)


@functools.cache
def results(size, dtype):
    """Matrices as rounded, inverses and log determinants: one compilation for a size and precision."""
    given = matrices(size).astype(dtype)
    inverse, log_det, root = jax.jit(lambda m: (inverse_spd(m), log_det_spd(m), cholesky_spd(m)))(given)
    assert inverse.dtype == log_det.dtype == root.dtype == dtype
    good = given.reshape(12, size, size)[GROUPS["good"]]
    np.testing.assert_allclose(
        np.reshape(root, (12, size, size))[GROUPS["good"]],
        np.linalg.cholesky(good.astype(float)),
        atol=1e-10 if dtype is np.float64 else 1e-5,
    )
    assert inverse.shape == given.shape
    assert log_det.shape == given.shape[:2]
    flat = (12, size, size)
    return given.astype(float).reshape(flat), np.asarray(inverse, float).reshape(flat), np.ravel(log_det).astype(float)


@SIZES
@DTYPES
def test_inverse_and_log_det(size, dtype):
    given, inverse, log_det = (x[GROUPS["good"]] for x in results(size, dtype))
    tolerance = 1e-10 if dtype is np.float64 else 1e-4
    np.testing.assert_allclose(inverse, np.linalg.inv(given), rtol=0, atol=tolerance)
    np.testing.assert_allclose(log_det, np.linalg.slogdet(given)[1], rtol=0, atol=tolerance)
    # What the filter relies on: the result is symmetric, to the last bits.
    np.testing.assert_allclose(inverse, np.swapaxes(inverse, -1, -2), rtol=0, atol=20 * np.finfo(dtype).eps)


@pytest.mark.parametrize("size", [1, 2, 4, 9])
def test_inverse_of_upper_triangular_matrices(size):
    matrix = np.triu(np.random.default_rng(size).normal(size=(size, size))) + 2.0 * np.eye(size)
    below = np.tril(np.full((size, size), np.nan), -1)
    np.testing.assert_allclose(jax.jit(inverse_upper)(matrix + below), np.linalg.inv(matrix), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(("size", "rank"), [(1, 0), (2, 2), (4, 2), (4, 4), (6, 3), (9, 5)])
def test_root_of_semidefinite_matrices(size, rank, dtype):
    factor = np.random.default_rng([size, rank]).normal(size=(size, rank))
    factor[:1] = 0.0  # an axis without noise
    matrix = (factor @ factor.T).astype(dtype)
    root = np.asarray(jax.jit(root_semidefinite)(matrix))
    assert root.dtype == dtype
    np.testing.assert_array_equal(root, np.tril(root))
    np.testing.assert_allclose(root @ root.T, matrix, atol=2e3 * np.finfo(dtype).eps)


@SIZES
@pytest.mark.parametrize("condition", ["1e6", "1e10"])
def test_ill_conditioned_matrices(size, condition):
    """A backward stable method errs, relative to the norm, by about the condition times the unit roundoff."""
    given, inverse, log_det = (x[GROUPS[condition]] for x in results(size, np.float64))
    expected, bound = np.linalg.inv(given), 20 * size * float(condition) * 2.3e-16
    error = np.linalg.norm(inverse - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
    assert error.max() < bound
    np.testing.assert_allclose(log_det, np.log(np.linalg.eigvalsh(given)).sum(axis=1), atol=bound)


@SIZES
@DTYPES
def test_badly_scaled_axes_cost_no_digits(size, dtype):
    """Positions beside something 10^4 times smaller: D M D with a diagonal D is as good as M."""
    given, inverse, _ = (x[GROUPS["scaled"]] for x in results(size, dtype))
    expected = np.linalg.inv(given)
    diagonal = np.einsum("bii->bi", expected)
    error = np.abs(inverse - expected) / np.sqrt(diagonal[:, :, None] * diagonal[:, None, :])
    assert error.max() < (1e-10 if dtype is np.float64 else 2e-4)


@SIZES
def test_float32_of_condition_a_million_keeps_the_scale(size):
    """Six of seven digits are gone, but nothing breaks: the determinant is right to some per cent."""
    given, inverse, log_det = (x[GROUPS["1e6"]] for x in results(size, np.float32))
    np.testing.assert_allclose(log_det, np.linalg.slogdet(given)[1], atol=0.3)
    assert (np.linalg.eigvalsh(inverse) > 0).all()


@pytest.mark.parametrize("size", [1, 3, 4])
def test_log_det_of_an_indefinite_matrix_is_no_number(size):
    matrix = definite(size)
    matrix[-1, -1] = -1.0
    assert np.isnan(jax.jit(log_det_spd)(matrix))


@SIZES
def test_derivatives_by_central_differences(size):
    """Along symmetric directions, on which both functions are defined."""
    matrix, rng, step = definite(size), np.random.default_rng(size), 1e-5
    weights, directions = rng.normal(size=(size, size)), rng.normal(size=(3, size, size))
    directions += np.swapaxes(directions, 1, 2)

    @jax.jit
    def values_and_gradients(m):
        def weighted(m):
            return jnp.sum(weights * inverse_spd(m))

        shifted = jnp.concatenate([m + step * directions, m - step * directions])
        values = [jax.vmap(f)(shifted) for f in (log_det_spd, weighted)]
        return values, [jax.grad(f)(m) for f in (log_det_spd, weighted)]

    values, gradients = values_and_gradients(matrix)
    for value, gradient in zip(values, gradients, strict=True):
        difference = (np.asarray(value)[:3] - np.asarray(value)[3:]) / (2 * step)
        np.testing.assert_allclose(np.sum(gradient * directions, axis=(1, 2)), difference, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("size", [2, 5])
def test_second_derivative_of_log_det(size):
    """d^2 log det along D is -tr(M^-1 D M^-1 D): the derivative of a derivative rule must be one too."""
    matrix, direction = definite(size), definite(size, seed=8)
    second = jax.jit(jax.grad(jax.grad(lambda t: log_det_spd(matrix + t * direction))))(0.0)
    product = np.linalg.inv(matrix) @ direction
    assert float(second) == pytest.approx(-np.trace(product @ product), rel=1e-9)


@pytest.mark.parametrize("shape", [(2, 3, 1), (3, 2, 3), (4, 2, 3), (6, 6, 6)])
def test_multiply(shape):
    n, m, k = shape
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(3, n, m)), rng.normal(size=(3, m, k))
    both, first, second = jax.jit(lambda a, b: (multiply(a, b), multiply(a, b[0]), multiply(a[0], b)))(a, b)
    np.testing.assert_allclose(both, a @ b, atol=1e-13)
    np.testing.assert_allclose(first, a @ b[0], atol=1e-13)
    np.testing.assert_allclose(second, a[0] @ b, atol=1e-13)


@SIZES
def test_vech_and_symmetrise(size):
    matrix = np.random.default_rng(1).normal(size=(2, size, size))
    packed, half = jax.jit(lambda m: (vech(m), symmetrise(m)))(matrix)
    lower = [[m[i, j] for i in range(size) for j in range(i + 1)] for m in matrix]
    np.testing.assert_array_equal(packed, lower)
    np.testing.assert_array_equal(half, np.swapaxes(half, -1, -2))
    np.testing.assert_allclose(half, (matrix + np.swapaxes(matrix, -1, -2)) / 2, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "shapes", [((4, 3, 3), (3, 3)), ((2, 1, 6, 6), (5, 6, 2)), ((7, 3), (4, 3, 3)), ((0, 2, 2), (2, 2))]
)
def test_derivatives_of_products_are_those_of_matmul(shapes):
    """First, second, forward and mapped, with batch axes that broadcast."""
    rng = np.random.default_rng(len(shapes[0]))
    a, b = (jnp.asarray(rng.normal(size=shape)) for shape in shapes)

    def total(product):
        return lambda a, b: jnp.sum(jnp.sin(product(a, b)))

    def derivatives(product, a, b):
        f = total(product)
        first, second = jax.grad(f, (0, 1))(a, b), jax.jacfwd(jax.grad(f, 1), 1)(a, b)
        mapped = jax.vmap(jax.grad(f, 1), (None, 0))(a, jnp.stack([b, 2 * b]))
        return jax.tree.leaves((f(a, b), first, second, mapped))

    compiled = jax.jit(derivatives, static_argnums=0)
    for ours, theirs in zip(compiled(multiply, a, b), compiled(jnp.matmul, a, b), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("rows", [2, 4, 7])
def test_products_of_sizes_that_do_not_fit_are_rejected(rows):
    """Also where shapes are not checked, as they are while tests run: slices would be cut off or repeated."""
    with pytest.raises(ValueError, match="as many columns as rows"):
        inspect.unwrap(multiply)(jnp.ones((2, 3)), jnp.ones((rows, 3)))
