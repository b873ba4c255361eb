"""Assignment of targets to robots, at the least total cost or greedily, in compiled programs.

`optimal` is the Hungarian method with potentials (Kuhn 1955; in the form of Jonker & Volgenant 1987): robots are added
one by one, each along the shortest augmenting path. Costs are any finite numbers.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


def greedy(cost: Float[Array, "rows columns"]) -> Int[Array, " rows"]:
    """The column of each row, where pairs are taken by their cost, the least first; -1 for rows that are left over."""
    rows, columns = cost.shape

    def take(_, carry):
        left, column_of = carry
        row, column = jnp.unravel_index(jnp.argmin(left), left.shape)
        left = left.at[row].set(jnp.inf).at[:, column].set(jnp.inf)
        return left, column_of.at[row].set(column)

    first = jnp.full(rows, -1, int)
    return jax.lax.fori_loop(0, min(rows, columns), take, (cost, first))[1]


def optimal(cost: Float[Array, "rows columns"]) -> Int[Array, " rows"]:
    """The column of each row in an assignment of the least total cost; -1 for rows that are left over."""
    rows, columns = cost.shape
    if rows > columns:
        row_of = optimal(cost.T)
        return jnp.full(rows, -1, int).at[row_of].set(jnp.arange(columns))
    return jax.lax.fori_loop(0, rows, lambda row, found: _added(cost, row, found), _nothing(cost)).column_of


class _Found(NamedTuple):
    """A partial assignment: the row of each column (-1: free), the column of each row, and the potentials."""

    row_of: Int[Array, " columns"]
    column_of: Int[Array, " rows"]
    row_price: Float[Array, " rows"]
    column_price: Float[Array, " columns"]


class _Search(NamedTuple):
    """A search for the shortest path to a free column: its distances, ways back, and the columns it has settled."""

    row: Int[Array, ""]
    sink: Int[Array, ""]
    distance: Float[Array, " columns"]
    before: Int[Array, " columns"]
    settled: Bool[Array, " columns"]
    rows_seen: Bool[Array, " rows"]
    least: Float[Array, ""]


def _nothing(cost: Float[Array, "rows columns"]) -> _Found:
    rows, columns = cost.shape
    zero = jnp.zeros(1, cost.dtype)
    return _Found(
        jnp.full(columns, -1, int), jnp.full(rows, -1, int), jnp.repeat(zero, rows), jnp.repeat(zero, columns)
    )


def _added(cost: Float[Array, "rows columns"], row: Int[Array, ""], found: _Found) -> _Found:
    """The assignment with one more row."""
    columns = cost.shape[1]

    def scan(search: _Search) -> _Search:
        reduced = search.least + cost[search.row] - found.row_price[search.row] - found.column_price
        is_nearer = ~search.settled & (reduced < search.distance)
        distance = jnp.where(is_nearer, reduced, search.distance)
        before = jnp.where(is_nearer, search.row, search.before)
        column = jnp.argmin(jnp.where(search.settled, jnp.inf, distance))
        owner = found.row_of[column]
        return _Search(
            row=jnp.where(owner < 0, search.row, owner),
            sink=jnp.where(owner < 0, column, -1),
            distance=distance,
            before=before,
            settled=search.settled.at[column].set(True),
            rows_seen=search.rows_seen.at[jnp.where(owner < 0, search.row, owner)].set(True),
            least=distance[column],
        )

    begun = _Search(
        row=row,
        sink=jnp.full((), -1, int),
        distance=jnp.full(columns, jnp.inf, cost.dtype),
        before=jnp.full(columns, -1, int),
        settled=jnp.zeros(columns, bool),
        rows_seen=jnp.zeros(cost.shape[0], bool).at[row].set(True),
        least=jnp.zeros((), cost.dtype),
    )
    search = jax.lax.while_loop(lambda search: search.sink < 0, scan, begun)
    # Potentials, by which the reduced costs stay non-negative: those of rows by the distance of their columns.
    own = jnp.where(found.column_of >= 0, search.distance[found.column_of], 0.0)
    row_price = found.row_price + jnp.where(search.rows_seen, search.least - own, 0.0)
    change = jnp.where(search.settled, search.least - search.distance, 0.0)
    row_of, column_of = _augmented(found, search, row)
    return _Found(row_of, column_of, row_price, found.column_price - change)


def _augmented(found: _Found, search: _Search, first: Int[Array, ""]) -> tuple[Array, Array]:
    """Owners after every row on the path to the free column has taken the next one."""

    def back(carry):
        column, row_of, column_of, _ = carry
        row = search.before[column]
        following = column_of[row]
        return following, row_of.at[column].set(row), column_of.at[row].set(column), row == first

    begun = (search.sink, found.row_of, found.column_of, jnp.array(False))
    return jax.lax.while_loop(lambda carry: ~carry[3], back, begun)[1:3]
