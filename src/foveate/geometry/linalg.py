"""Small symmetric positive definite matrices: inverse, log determinant, Cholesky factor, products, packing.

Target states are small (2 to 9 numbers), so one LAPACK call a matrix costs more than the arithmetic. Up to 6 x 6
the factorisation is written out in elementwise operations, which XLA fuses over targets and episodes (480 matrices
of 6 x 6 on one core: 57 us where LAPACK takes 410); above that the library's Cholesky is used. Derivatives are the
textbook ones and reuse the inverse: d(M^-1) = -M^-1 dM M^-1 and d log det M = tr(M^-1 dM).
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

from foveate.errors import InputError

UNROLLED = 6
"""Largest size whose factorisation is written out."""


def symmetrise(matrix: Float[Array, "*b n n"]) -> Float[Array, "*b n n"]:
    """(M + M^T) / 2: rounding makes a product of symmetric matrices drift off symmetry."""
    return 0.5 * (matrix + jnp.swapaxes(matrix, -1, -2))


def _pivots(m: Float[Array, "*b n n"]) -> tuple[list, list]:
    """LDL^T of a small matrix by elimination: rows of the unit lower factor L, and the pivots D."""
    size = m.shape[-1]
    lower: list[list] = [[None] * size for _ in range(size)]
    pivots: list = []
    for i in range(size):
        for j in range(i):
            rest = m[..., i, j] - sum(lower[i][k] * lower[j][k] * pivots[k] for k in range(j))
            lower[i][j] = rest / pivots[j]
        pivots.append(m[..., i, i] - sum(lower[i][k] ** 2 * pivots[k] for k in range(i)))
    return lower, pivots


def _unit_lower_inverse(lower: list) -> list:
    """Inverse of a unit lower triangular matrix given as rows (its strict part only is filled)."""
    size = len(lower)
    inverse: list[list] = [[None] * size for _ in range(size)]
    for i in range(size):
        for j in range(i):
            inverse[i][j] = -(lower[i][j] + sum(lower[i][k] * inverse[k][j] for k in range(j + 1, i)))
    return inverse


@jax.custom_jvp
def inverse_spd(matrix: Float[Array, "*b n n"]) -> Float[Array, "*b n n"]:
    """M^-1 of a symmetric positive definite matrix; the result is symmetric."""
    size = matrix.shape[-1]
    if size > UNROLLED:
        factor = jnp.linalg.cholesky(matrix, symmetrize_input=False)
        eye = jnp.broadcast_to(jnp.eye(size, dtype=matrix.dtype), matrix.shape)
        root = jax.lax.linalg.triangular_solve(factor, eye, left_side=True, lower=True)
        return jnp.matmul(jnp.swapaxes(root, -1, -2), root, precision="highest")
    lower, pivots = _pivots(matrix)
    root = _unit_lower_inverse(lower)
    rows: list[list] = [[None] * size for _ in range(size)]
    for i in range(size):
        for j in range(i + 1):
            terms = [
                (root[k][i] if k > i else 1.0) * (root[k][j] if k > j else 1.0) / pivots[k] for k in range(i, size)
            ]
            rows[i][j] = rows[j][i] = sum(terms[1:], start=terms[0])
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


@inverse_spd.defjvp
def _inverse_spd_jvp(primals: tuple, tangents: tuple) -> tuple:
    inverse = inverse_spd(*primals)
    # XLA would fuse one product into the other and compute each element of the first as often as the second reads it.
    first = jax.lax.optimization_barrier(multiply(inverse, tangents[0]))
    return inverse, -multiply(first, inverse)


@jax.custom_jvp
def log_det_spd(matrix: Float[Array, "*b n n"]) -> Float[Array, "*b"]:
    """log det M of a symmetric positive definite matrix; NaN where it is not definite."""
    if matrix.shape[-1] > UNROLLED:
        factor = jnp.linalg.cholesky(matrix, symmetrize_input=False)
        return 2.0 * jnp.sum(jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
    _, pivots = _pivots(matrix)
    return sum(map(jnp.log, pivots[1:]), start=jnp.log(pivots[0]))


@log_det_spd.defjvp
def _log_det_spd_jvp(primals: tuple, tangents: tuple) -> tuple:
    return log_det_spd(*primals), jnp.sum(inverse_spd(*primals) * tangents[0], axis=(-2, -1))


def cholesky_spd(matrix: Float[Array, "*b n n"]) -> Float[Array, "*b n n"]:
    """The lower triangular R with R R^T = M, for a symmetric positive definite M."""
    size = matrix.shape[-1]
    if size > UNROLLED:
        return jnp.linalg.cholesky(matrix, symmetrize_input=False)
    lower, pivots = _pivots(matrix)
    roots = [jnp.sqrt(pivot) for pivot in pivots]
    zero, one = jnp.zeros_like(pivots[0]), jnp.ones_like(pivots[0])
    entries = [[lower[i][j] if j < i else (one if j == i else zero) for j in range(size)] for i in range(size)]
    rows = [jnp.stack([entries[i][j] * roots[j] for j in range(size)], axis=-1) for i in range(size)]
    return jnp.stack(rows, axis=-2)


def inverse_upper(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """M^-1 of a small upper triangular matrix; what lies below the diagonal is not read."""
    size, zero = len(matrix), jnp.zeros_like(matrix[0, 0])
    rows: list[list] = [[zero] * size for _ in range(size)]
    for i in reversed(range(size)):
        rows[i][i] = 1.0 / matrix[i, i]
        for j in range(i + 1, size):
            rows[i][j] = -sum(matrix[i, k] * rows[k][j] for k in range(i + 1, j + 1)) * rows[i][i]
    return jnp.stack([jnp.stack(row) for row in rows])


def root_semidefinite(matrix: Float[Array, "*b n n"]) -> Float[Array, "*b n n"]:
    """The lower triangular R with R R^T = M, for a small symmetric positive *semi*definite M.

    R is unique, where a root by eigenvectors is not if eigenvalues are equal: it would follow rounding, and so differ
    from machine to machine. A pivot that is rounding alone is zero, and so is its column. There is no derivative where
    M is singular.
    """
    size, zero = matrix.shape[-1], jnp.zeros_like(matrix[..., 0, 0])
    rounding = 4.0 * size * jnp.finfo(matrix.dtype).eps
    rows: list[list] = [[zero] * size for _ in range(size)]
    for j in range(size):
        pivot = matrix[..., j, j] - sum(rows[j][k] ** 2 for k in range(j))
        is_zero = pivot <= rounding * matrix[..., j, j]
        root = jnp.sqrt(jnp.where(is_zero, 1.0, pivot))
        rows[j][j] = jnp.where(is_zero, 0.0, root)
        for i in range(j + 1, size):
            rest = matrix[..., i, j] - sum(rows[i][k] * rows[j][k] for k in range(j))
            rows[i][j] = jnp.where(is_zero, 0.0, rest / root)
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def multiply(a: Float[Array, "*b n m"], b: Float[Array, "*c m k"]) -> Float[Array, "*d n k"]:
    """a b, the batch axes broadcast; over few terms (m) as an elementwise sum of outer products.

    In large batches that fuses with its neighbours, where `a @ b` is a separate batched product that the CPU runs one
    matrix at a time.
    """
    if a.shape[-1] != b.shape[-2]:
        raise InputError(f"a product of {a.shape} and {b.shape}: expected as many columns as rows")
    if not 0 < a.shape[-1] <= UNROLLED:
        return jnp.matmul(a, b, precision="highest")
    rank, dtype = max(a.ndim, b.ndim), jnp.result_type(a, b)
    a, b = (jnp.expand_dims(x, tuple(range(rank - x.ndim))).astype(dtype) for x in (a, b))
    return _product.bind(a, b)


def _outer_products(a: Array, b: Array) -> Array:
    """a b of equal ranks, whose batch axes are equal or 1."""
    first, *others = [a[..., :, k, None] * b[..., None, k, :] for k in range(a.shape[-1])]
    return sum(others, start=first)


def _product_type(a: ShapedArray, b: ShapedArray) -> ShapedArray:
    batch = jax.lax.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    return a.update(shape=(*batch, a.shape[-2], b.shape[-1]), weak_type=False)


# A primitive, so that the derivatives of a product are such products too. JAX's own derivatives, which transpose each
# broadcast into a small reduction and each slice into a pad, cost 15 times the product on the CPU. It can go when
# `jax.custom_derivatives.linear_call`, by which a function names its transpose, also has a batching rule and can be
# differentiated by its residuals (jax 0.10 has neither): then a `custom_jvp` with two such calls does the same.
_product = Primitive("small_product")
_product.def_impl(_outer_products)
_product.def_abstract_eval(_product_type)
mlir.register_lowering(_product, mlir.lower_fun(_outer_products, multiple_results=False))


def _batched(arguments: Sequence[Array], axes: Sequence[int | None]) -> tuple[Array, int]:
    a, b = (x[None] if axis is None else jnp.moveaxis(x, axis, 0) for x, axis in zip(arguments, axes, strict=True))
    return _product.bind(a, b), 0


batching.primitive_batchers[_product] = _batched


def _summed(cotangent: Array, shape: tuple[int, ...]) -> Array:
    """Sum over the axes along which an argument of this shape was broadcast."""
    axes = tuple(i for i, (wide, narrow) in enumerate(zip(cotangent.shape, shape, strict=True)) if wide != narrow)
    return jnp.sum(cotangent, axis=axes, keepdims=True) if axes else cotangent


ad.defbilinear(
    _product,
    lambda g, a, b: _summed(multiply(g, jnp.swapaxes(b, -1, -2)), a.aval.shape),
    lambda g, a, b: _summed(multiply(jnp.swapaxes(a, -1, -2), g), b.aval.shape),
)


def vech(matrix: Float[Array, "*b n n"]) -> Float[Array, "*b p"]:
    """Half-vectorisation: the lower triangle, row by row, p = n (n + 1) / 2."""
    rows, columns = jnp.tril_indices(matrix.shape[-1])
    return matrix[..., rows, columns]
