"""Assignment of targets to robots, at the least total cost or greedily, in compiled programs. Costs are finite."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int
from optax.assignment import hungarian_algorithm


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
    row, column = hungarian_algorithm(cost)
    return jnp.full(len(cost), -1, int).at[row].set(column.astype(int))
