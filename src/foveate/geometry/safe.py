"""Functions with kinks whose derivatives stay right at every precision and scale, compiled or not."""

from functools import reduce

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def larger(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    """max(a, b) with the derivative of one of them.

    That of jnp.maximum (min and clip alike) tests a and b for equality with the result; XLA may have rounded it
    differently, and then the weights do not sum to 1.
    """
    return jnp.where(a > b, a, b)


def clipped(value: Float[Array, "..."], low: Float[Array, "..."], high: Float[Array, "..."]) -> Float[Array, "..."]:
    """jnp.clip, differentiated as `larger`."""
    return jnp.where(value < low, low, jnp.where(value > high, high, value))


@jax.custom_jvp
def length(*components: Float[Array, "..."]) -> Float[Array, "..."]:
    """Euclidean length of a vector given by its components; its derivative is 0 at zero.

    Elsewhere the derivative is the unit vector at every scale: no threshold separates lengths from rounding errors, so
    that views of a millimetre and of 100 km behave alike in float32.
    """
    return jnp.sqrt(reduce(jnp.add, [component * component for component in components]))


@length.defjvp
def _length_jvp(
    components: tuple[Float[Array, "..."], ...], tangents: tuple[Float[Array, "..."], ...]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    value = length(*components)
    inverse = jnp.where(value > 0, 1 / jnp.where(value > 0, value, 1.0), 0.0)
    pairs = zip(components, tangents, strict=True)
    return value, reduce(jnp.add, [component * inverse * tangent for component, tangent in pairs])
