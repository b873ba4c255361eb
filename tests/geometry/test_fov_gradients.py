"""Derivatives of the signed distance, by the point and by the shape: against oracles, differences, and each other."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.fov_cases import CASES, EVERY, INTERSECTIONS, answered, cast, distance, gradients

from foveate.geometry.fov_planar import ConvexPolygon, triangle, triangle_vertices
from foveate.geometry.fov_spatial import Cone, Frustum


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", CASES)
def test_gradient(name, dtype):
    """Of norm 1 at all but a rounding error from the boundary and in folds, finite there; towards the nearest point.

    The latter where there is only one, and it is known: the search for it is good to 1e-8. Float32 is held to float64
    with the same inputs, since the rounding of an angle near pi alone moves the corners of a view. Compiled, a
    difference of coordinates may be rounded once for a length and otherwise for its derivative (a fused product), so
    that close to a corner the norm is uncertain by a rounding error over the distance.
    """
    case = CASES[name]
    points, answer = answered(name)
    expected, gap, size = answer.gradient[::EVERY], answer.gap[::EVERY], case.size
    shape, inputs = cast(case.shape, dtype), jnp.asarray(points[::EVERY], dtype)
    value, reverse, forward, by_shape = gradients(shape, inputs)
    assert reverse.dtype == dtype
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((by_shape, forward)))

    norm = np.linalg.norm(reverse, axis=1)
    rounding = np.finfo(dtype).eps * np.maximum(size, np.linalg.norm(inputs, axis=1))
    blur = 16 * rounding  # of rounded coordinates
    assert np.all(norm < 1 + 4e-7)  # NaN fails too
    center = np.all(np.asarray(getattr(shape, "center", 0.0)) == np.asarray(inputs), axis=1)
    regular = (np.abs(value) > blur) & ~(inputs[:, 1:] == 0).any(axis=1) & ~center
    assert regular.mean() > 0.5
    exact = 4e-7 if dtype == np.float32 else 1e-14
    assert np.all(np.abs(norm - 1)[regular] < exact + rounding[regular] / np.abs(value)[regular])

    if dtype == np.float32:
        expected = gradients(cast(shape, np.float64), inputs.astype(np.float64))[1]
    error = blur + 1e-8 * size
    known = (np.minimum(gap, np.abs(value)) > 100 * error) & regular
    assert known.mean() > (0.1 if dtype == np.float32 else 0.4)
    off = np.linalg.norm(reverse - expected, axis=1)
    assert np.all(off[known] < 4 * error[known] / np.abs(value[known]) + 1e-6)
    np.testing.assert_allclose(forward[known], reverse[known], rtol=0, atol=8 * np.finfo(dtype).eps)


ANGLES = ("angle", "width_angle", "height_angle", "normal")


def scaled(shape, scale):
    """The shape with its lengths multiplied."""
    return jax.tree_util.tree_map_with_path(lambda path, leaf: leaf if path[-1].name in ANGLES else leaf * scale, shape)


@pytest.mark.parametrize("name", CASES)
def test_no_length_is_special(name):
    """A shape of 1 mm and one of 100 km, scaled by powers of two, have the same digits and the same gradients."""
    shape, points = cast(CASES[name].shape, np.float64), answered(name)[0]
    single, few = cast(shape, np.float32), points[::EVERY].astype(np.float32)
    exact, (value, *directions, _) = distance(shape, points), gradients(single, few)
    clear = np.minimum(np.abs(value), np.linalg.norm(few, axis=1)) > 1e-14  # the squares are normal numbers
    for scale in (2.0**-10, 2.0**17):
        np.testing.assert_array_equal(distance(scaled(shape, scale), points * scale), exact * scale)
        value_there, *there, _ = gradients(scaled(single, scale), few * np.float32(scale))
        np.testing.assert_array_equal(value_there, value * scale)
        for direction_there, direction in zip(there, directions, strict=True):
            np.testing.assert_array_equal(direction_there[clear], direction[clear])


@pytest.mark.parametrize("name", INTERSECTIONS)
def test_gradient_of_an_intersection_is_a_central_difference(name):
    shape, step, d = INTERSECTIONS[name], 1e-6, INTERSECTIONS[name].dimension
    points = np.random.default_rng(1).uniform(-6, 6, (2000, d))
    found = gradients(shape, points)[1]
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=0, atol=1e-12)
    shifts = step * np.eye(d)[:, None]
    ends = np.concatenate([points + shifts, points - shifts]).reshape(-1, d)
    ahead, behind = distance(shape, ends).reshape(2, d, -1)
    expected = (ahead - behind).T / (2 * step)
    smooth = np.abs(np.linalg.norm(expected, axis=1) - 1) < 1e-4  # no kink between the two ends
    assert smooth.mean() > 0.99
    np.testing.assert_allclose(found[smooth], expected[smooth], rtol=0, atol=1e-4)


def test_gradient_at_hand_computed_places():
    view = triangle(2.0, 2 * math.pi / 3)
    points = jnp.array([[1.9, 0.0], [3.0, 0.0], [-1.0, 0.0], [3.0, 2 * math.sqrt(3) + 1], [0.0, 1.0]])
    half = math.sqrt(0.5)
    expected = [[1.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [half, half], [-math.sqrt(0.75), 0.5]]
    np.testing.assert_allclose(gradients(view, points)[1], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("build", "dimension"),
    [
        (lambda depth, angle: ConvexPolygon(triangle_vertices(depth, angle)), 2),
        (lambda far, angle: Cone(jnp.asarray(0.3), far, angle), 3),
        (lambda far, angle: Frustum(jnp.asarray(0.3), far, angle, angle / 2), 3),
    ],
)
def test_parameters_may_be_traced(build, dimension):
    lengths, angles = jnp.array([1.0, 2.0, 3.0]), jnp.array([0.5, 1.0, 2.0])
    points = jnp.asarray(np.random.default_rng(2).uniform(-3, 3, (40, dimension)))

    @jax.jit
    @jax.vmap
    def total(length, angle):
        return jnp.sum(build(length, angle).signed_distance(points))

    step = 1e-6
    by_length = (total(lengths + step, angles) - total(lengths - step, angles)) / (2 * step)
    by_angle = (total(lengths, angles + step) - total(lengths, angles - step)) / (2 * step)
    found = jax.jit(jax.grad(lambda *parameters: jnp.sum(total(*parameters)), (0, 1)))(lengths, angles)
    np.testing.assert_allclose(found, [by_length, by_angle], rtol=1e-5, atol=1e-6)
    one_by_one = [np.sum(distance(build(*pair), points)) for pair in zip(lengths, angles, strict=True)]
    np.testing.assert_allclose(total(lengths, angles), one_by_one, rtol=1e-12)


@pytest.mark.parametrize("name", ["triangle paper", "frustum camera", "cone narrow"])
def test_second_derivatives_match_differences_of_first(name):
    shape, step = CASES[name].shape, 1e-6
    points = np.random.default_rng(3).uniform(-6, 6, (200, shape.dimension))
    hessian = jax.jit(jax.vmap(jax.hessian(shape.signed_distance)))(points)
    ends = points + step * np.concatenate([np.eye(shape.dimension), -np.eye(shape.dimension)])[:, None]
    slopes = gradients(shape, ends.reshape(-1, shape.dimension))[1]
    ahead, behind = slopes.reshape(2, shape.dimension, *points.shape)
    differences = np.moveaxis(ahead - behind, 0, 1) / (2 * step)
    close = np.abs(hessian - differences).max(axis=(1, 2)) < 1e-4 * (1 + np.abs(hessian).max(axis=(1, 2)))
    assert close.mean() > 0.99  # the others lie where the nearest feature changes
