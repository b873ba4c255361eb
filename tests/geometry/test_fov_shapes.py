"""All fields of view alike: batches of points, outlines to draw, and one-line errors for wrong parameters."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.fov_cases import INTERSECTIONS, SHAPES, distance
from helpers.fov_oracles import polyhedron_oracle

from foveate.geometry.fov import ball, half_space
from foveate.geometry.fov_planar import polygon, sector, triangle
from foveate.geometry.fov_spatial import cone, frustum, intersection, prism


def test_points_may_have_any_leading_axes():
    points = jnp.asarray(np.random.default_rng(0).uniform(-6, 6, (24, 3))).reshape(2, 3, 4, 3)
    for shape in (SHAPES[name] for name in ("frustum camera", "cone reflex", "prism", "range-limited camera")):
        nested = jax.jit(jax.vmap(jax.vmap(jax.vmap(shape.signed_distance))))(points)
        np.testing.assert_allclose(
            jax.jit(lambda points, shape=shape: shape.signed_distance(points))(points), nested, rtol=0, atol=1e-14
        )


@pytest.mark.parametrize("name", SHAPES)
def test_outline_lies_on_the_boundary(name):
    shape = SHAPES[name]
    lines = shape.outline(4.0)
    if shape.dimension == 2:
        np.testing.assert_allclose(lines[0], lines[-1], rtol=0, atol=1e-12)
    lines = lines if isinstance(lines, list) else [lines]
    assert all(line.ndim == 2 and line.shape[1] == shape.dimension for line in lines)
    points = np.concatenate(lines)
    if name == "half plane":
        assert np.sum(np.abs(distance(shape, points)) < 1e-9) == 3
        assert np.all(np.linalg.norm(points, axis=1) >= 4.0)
        return
    sampled = name in INTERSECTIONS
    chord = 2e-3 * float(shape.depth)  # how far the chords of an arc of 64 pieces lie within it
    np.testing.assert_allclose(distance(shape, points), 0.0, atol=chord if sampled else 1e-9)
    farthest = np.linalg.norm(points, axis=1).max()
    assert farthest <= float(shape.depth) + 1e-9
    if math.isfinite(shape.depth) and not sampled and "ball" not in name:
        assert farthest >= 0.999 * float(shape.depth)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: triangle(-1.0, 1.0), r"^depth = -1\.0: expected .* > 0 \[m\]$"),
        (lambda: triangle(math.nan, 1.0), "^depth = nan: expected"),
        (lambda: triangle(2.0, math.pi), r"^angle = 3\.14.*: expected a number in \(0, pi\)"),
        (lambda: polygon([[0, 0], [1, 0]]), r"^shape of vertices = \(2, 2\): expected .* v >= 3$"),
        (lambda: polygon([[0, 0], [1, 0], [0, math.inf]]), "^vertices = .* expected finite"),
        (lambda: polygon([[0, 0], [1, 0], [2, 0]]), "^vertices = .* expected a non-zero area"),
        (lambda: polygon([[0, 0], [0, 0], [1, 0], [0, 1]]), "^vertices = .* expected no vertex repeated"),
        (lambda: polygon([[0, 0], [2, 0], [0.5, 0.5], [0, 2]]), "^vertices = .* convex"),
        (lambda: polygon([on_star(k) for k in range(5)]), "^vertices = .* convex"),
        (lambda: sector(0.0, 1.0), r"^radius = 0\.0: expected"),
        (lambda: sector(1.0, 6.3), r"^angle = 6\.3: expected a number in \(0, 2 pi\]"),
        (lambda: sector(1.0, 1.0, 1.0), r"^near = 1\.0: expected a number in \[0, radius = 1\.0\)"),
        (lambda: half_space([0.0, 0.0], 1.0), "^normal = .* not all 0"),
        (lambda: half_space([1.0, 0.0], math.inf), "^offset = inf: expected a finite"),
        (lambda: ball([0.0], 1.0), r"^center = \[0\.0\]: expected 2 or 3"),
        (lambda: ball([0.0, 0.0], math.nan), "^radius = nan: expected"),
        (lambda: cone(2.0, 1.0, 1.0), r"^near = 2\.0: expected a number in \[0, far = 1\.0\)"),
        (lambda: cone(0.0, math.inf, 1.0), "^far = inf: expected a finite"),
        (lambda: cone(0.0, 1.0, 0.0), r"^angle = 0\.0: expected a number in \(0, 2 pi\]"),
        (lambda: frustum(-1.0, 1.0, 1.0, 1.0), r"^near = -1\.0: expected"),
        (lambda: frustum(0.0, -1.0, 1.0, 1.0), r"^far = -1\.0: expected a finite number > 0"),
        (lambda: frustum(0.0, 1.0, 4.0, 1.0), r"^width_angle = 4\.0: expected"),
        (lambda: frustum(0.0, 1.0, 1.0, math.nan), "^height_angle = nan: expected"),
        (lambda: prism(ball([0.0, 0.0, 0.0], 1.0)), "^dimension of the prism's base = 3: expected 2$"),
        (lambda: intersection(), r"^dimensions of the shapes = \[\]: expected equal"),
        (lambda: intersection(triangle(1.0, 1.0), cone(0.0, 1.0, 1.0)), r"^dimensions of the shapes = \[2, 3\]: "),
    ],
)
def test_errors_name_parameter_value_and_remedy(build, message):
    with pytest.raises(ValueError, match=message) as error:
        build()
    assert "\n" not in str(error.value)


def on_star(k):
    return [math.cos(4 * math.pi * k / 5), math.sin(4 * math.pi * k / 5)]


def test_polygon_accepts_either_sense_and_straight_angles():
    square = polygon([[0, 0], [0, 1], [1, 1], [1, 0.5], [1, 0]])
    points = np.random.default_rng(0).uniform(-1, 2, (1000, 2))
    points[:50, 1] = 0.5  # where the straight angle is nearest
    expected = polyhedron_oracle(points, [[0, 0], [0, 1], [1, 1], [1, 0]]).distance
    np.testing.assert_allclose(distance(square, points), expected, atol=1e-12)
