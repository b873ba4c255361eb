"""Series of the exponential map near zero rotation, smooth in value and derivative."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

SERIES_TERMS = 9  # the first term left out is below x^9 / 19! = 8e-18 at the switch, x = 1


def taylor(order: int, x: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """The Stumpff function c_k(x) = sum_j (-x)^j / (2 j + k)!, for 0 <= x <= 1."""
    total = jnp.zeros_like(x)
    for j in reversed(range(SERIES_TERMS)):
        total = 1.0 / math.factorial(2 * j + order) - x * total
    return total


def sinc(angle: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """sin(a) / a, smooth at zero."""
    square = angle * angle
    small = square < 1.0
    series = taylor(1, jnp.where(small, square, 0.0))
    return jnp.where(small, series, jnp.sin(angle) / jnp.where(small, 1.0, angle))


def stumpff(x: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], ...]:
    """c_1..c_4 of x = a^2: sin(a)/a, (1 - cos a)/a^2, (a - sin a)/a^3, (a^2/2 - 1 + cos a)/a^4."""
    small = x < 1.0
    square = jnp.where(small, 1.0, x)
    angle = jnp.sqrt(square)
    small_x = jnp.where(small, x, 0.0)
    series_3, series_4 = taylor(3, small_x), taylor(4, small_x)
    closed_1, closed_2 = jnp.sin(angle) / angle, (1.0 - jnp.cos(angle)) / square
    return (
        jnp.where(small, 1.0 - small_x * series_3, closed_1),
        jnp.where(small, 0.5 - small_x * series_4, closed_2),
        jnp.where(small, series_3, (1.0 - closed_1) / square),
        jnp.where(small, series_4, (0.5 - closed_2) / square),
    )
