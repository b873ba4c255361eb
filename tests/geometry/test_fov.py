"""Signed distances against oracles that share no formula with them, on 20,000 points a shape.

Polyhedra: faces from scipy.spatial.ConvexHull; outside, the least-distance programme of Lawson and Hanson by
NNLS; inside, the least distance to a face. Curved shapes: a numerical search over every boundary patch.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from foveate.geometry.fov import (
    ConvexPolygon,
    ball,
    half_space,
    polygon,
    sector,
    triangle,
    triangle_vertices,
)
from foveate.geometry.fov_spatial import Cone, Frustum, cone, frustum, intersection, prism

POINTS = 20_000
HEPTAGON = [[2.0 + math.cos(t), 0.5 + 0.4 * math.sin(t)] for t in (0.1, 0.9, 2.0, 2.8, 3.9, 4.4, 5.6)]


def frustum_corners(near, far, width_angle, height_angle):
    signs = np.array([[1, j, k] for j in (-1, 1) for k in (-1, 1)])
    rays = signs * [1, math.tan(width_angle / 2), math.tan(height_angle / 2)]
    return np.concatenate([near * rays, far * rays])


FRUSTA = {
    "camera": (0.3, 5.0, 1.2, 0.8),
    "wide": (1.0, 2.0, 2.4, 0.3),
    "pyramid": (0.0, 3.0, 1.0, 1.5),
    "slab": (1.5, 2.1, 0.6, 2.0),
}
POLYHEDRA = {
    "paper": (triangle(2.0, 2 * math.pi / 3), [[0, 0], [2, -2 * math.sqrt(3)], [2, 2 * math.sqrt(3)]]),
    "needle": (triangle(3.0, 0.05), [[0, 0], [3, 3 * math.tan(0.025)], [3, -3 * math.tan(0.025)]]),
    "heptagon": (polygon(HEPTAGON), HEPTAGON),
} | {name: (frustum(*args), frustum_corners(*args)) for name, args in FRUSTA.items()}

# name: shape, near, far, full angle
SECTORS = {
    "wedge": (sector(2.0, 1.0), 0.0, 2.0, 1.0),
    "reflex": (sector(2.0, 5.0), 0.0, 2.0, 5.0),
    "half ring": (sector(2.0, math.pi, 0.5), 0.5, 2.0, math.pi),
    "reflex ring": (sector(3.0, 4.5, 1.0), 1.0, 3.0, 4.5),
}
CONES = {
    "narrow": (cone(0.5, 4.0, 0.6), 0.5, 4.0, 0.6),
    "apex": (cone(0.0, 2.0, 1.5), 0.0, 2.0, 1.5),
    "reflex": (cone(0.4, 2.0, 4.8), 0.4, 2.0, 4.8),
}
ALL = (
    {name: shape for name, (shape, _) in POLYHEDRA.items()}
    | {f"sector {name}": shape for name, (shape, *_) in SECTORS.items()}
    | {f"cone {name}": shape for name, (shape, *_) in CONES.items()}
    | {
        "ball": ball([0.5, -1.0, 0.2], 1.5),
        "disc": ball([0.5, -1.0], 1.5),
        "full disc": sector(1.5, 2 * math.pi),
        "full ring": sector(1.5, 2 * math.pi, 1.2),
        "full shell": cone(0.4, 2.0, 2 * math.pi),
        "half plane": half_space([1.0, 2.0], 0.7),
        "half space": half_space([1.0, 2.0, -2.0], 0.7),
        "prism": prism(triangle(2.0, 1.0)),
        "lens": intersection(ball([0.0, 0.0], 1.0), ball([1.0, 0.0], 1.0), half_space([0.0, 1.0], 0.5)),
        "range-limited camera": intersection(frustum(0.3, 5.0, 1.2, 0.8), ball([0.0, 0.0, 0.0], 4.0)),
    }
)


def size_of(shape):
    depth = float(shape.depth)
    return depth if math.isfinite(depth) else 1.0


@eqx.filter_jit
def jitted_distance(shape, points):
    return shape.signed_distance(points)


def distance(shape, points):
    """Padded to one number of points, so that shapes of a kind are compiled once."""
    padded = jnp.asarray(np.resize(points, (POINTS, shape.dimension)))
    return np.asarray(jitted_distance(shape, padded))[: len(points)]


@eqx.filter_jit
def gradients(shape, points):
    """Signed distances, with their derivatives by the parameters of the shape and by the point."""
    value_and_gradients = jax.value_and_grad(lambda shape, point: shape.signed_distance(point), (0, 1))
    value, (by_shape, by_point) = jax.vmap(value_and_gradients, (None, 0))(shape, points)
    return value, by_shape, by_point


def in_float32(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), tree)


def draw_points(shape, count=POINTS, seed=0):
    """Half of them around the origin, half of them around the shape's outline, where features are small."""
    rng, size = np.random.default_rng(seed), size_of(shape)
    lines = shape.outline(2 * size)
    corners = np.concatenate(lines if isinstance(lines, list) else [lines])
    wide = rng.uniform(-2 * size, 2 * size, (count // 2, shape.dimension))
    return np.concatenate([wide, rng.choice(corners, count // 2) + 0.3 * size * rng.normal(size=wide.shape)])


def halfspace_oracle(points, faces):
    """Signed distance to {x : faces[:, :-1] x + faces[:, -1] <= 0}, unit normals, bounded or not.

    Outside: with z = x - p the least |z| with -N z >= N p + c, as NNLS (Lawson and Hanson, chapter 23).
    """
    normals = faces[:, :-1]
    last = np.zeros(points.shape[1] + 1)
    last[-1] = 1.0
    heights = points @ normals.T + faces[:, -1]
    distance = heights.max(axis=1)
    for i in np.flatnonzero(distance > 0):
        system = np.concatenate([-normals.T, heights[i][None]])
        residual = system @ nnls(system, last)[0] - last
        distance[i] = np.linalg.norm(residual[:-1] / residual[-1])
    return distance


def search_oracle(points, pieces, count):
    """Least distance to pieces of boundary (point by parameter, low, high): `count` tries, compass search."""
    nearest = np.full(len(points), np.inf)
    for piece, low, high in pieces:
        step = (high - low) / (count - 1)
        near = np.linspace(low, high, count)[None]
        for _ in range(38):
            towards = piece(near) - points[:, None]
            square = np.einsum("nki,nki->nk", towards, towards)
            best = np.broadcast_to(near, square.shape)[np.arange(len(points)), square.argmin(axis=1)]
            near = best[:, None] + step * np.array([0, -1, 1, -2, 2])
            step *= 0.65
        nearest = np.minimum(nearest, np.sqrt(square.min(axis=1)))
    return nearest


def sector_boundary(near, far, half):
    """The arcs by bearing, the straight sides by range."""

    def at(radius, bearing):
        return np.stack(np.broadcast_arrays(radius * np.cos(bearing), radius * np.sin(bearing)), axis=-1)

    arcs = [(lambda t, r=r: at(r, np.clip(t, -half, half)), -half, half) for r in (near, far) if r > 0]
    return arcs + [(lambda t, b=b: at(np.clip(t, near, far), b), near, far) for b in (-half, half)]


def cone_boundary(near, far, half, points):
    """By azimuth: the point nearest to the given one on a meridian arc of a cap, on a ruling of the side."""

    def at(radius, bearing, azimuth):
        aside = radius * np.sin(bearing)
        ahead = radius * np.cos(bearing) + 0 * azimuth
        return np.stack([ahead, aside * np.cos(azimuth), aside * np.sin(azimuth)], axis=-1)

    def meridian(radius):
        def piece(t):
            aside = points[:, 1:2] * np.cos(t) + points[:, 2:] * np.sin(t)
            return at(radius, np.clip(np.arctan2(aside, points[:, :1]), 0.0, half), t)

        return piece

    def ruling(t):
        direction = at(1.0, half, t)
        return at(np.clip(np.sum(points[:, None] * direction, axis=-1), near, far), half, t)

    pieces = [meridian(radius) for radius in (near, far) if radius > 0] + [ruling]
    return [(piece, -math.pi, math.pi) for piece in pieces]


@pytest.mark.parametrize("name", POLYHEDRA)
def test_polyhedra_match_least_distance_programming(name):
    shape, corners = POLYHEDRA[name]
    points = draw_points(shape)
    expected = halfspace_oracle(points, ConvexHull(np.asarray(corners, float)).equations)
    assert min((expected < 0).sum(), (expected > 0).sum()) > 100
    np.testing.assert_allclose(distance(shape, points), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", [f"sector {n}" for n in SECTORS] + [f"cone {n}" for n in CONES])
def test_sectors_and_cones_match_a_search_over_their_boundary(name):
    kind, _, key = name.partition(" ")
    shape, near, far, angle = (SECTORS if kind == "sector" else CONES)[key]
    points = draw_points(shape)
    radius = np.linalg.norm(points, axis=1)
    inside = (near <= radius) & (radius <= far) & (np.arccos(points[:, 0] / radius) <= angle / 2)
    expected = []
    for part in np.array_split(points, 40):
        if shape.dimension == 2:
            expected.append(search_oracle(part, sector_boundary(near, far, angle / 2), 41))
        else:  # the azimuths at which a ruling comes nearer than a cone's apex may be few
            expected.append(search_oracle(part, cone_boundary(near, far, angle / 2, part), 241))
    expected = np.concatenate(expected)
    assert min(inside.sum(), (~inside).sum()) > 100
    expected = np.where(inside, -expected, expected)
    np.testing.assert_allclose(distance(shape, points), expected, rtol=0, atol=1e-9 * far)
    np.testing.assert_array_equal(shape.contains(jnp.asarray(points)), inside)


def test_shapes_of_closed_form():
    points = draw_points(ALL["ball"])
    radius = np.linalg.norm(points, axis=1)
    expected = {
        "ball": np.linalg.norm(points - [0.5, -1.0, 0.2], axis=1) - 1.5,
        "full shell": np.maximum(radius - 2.0, 0.4 - radius),
        "half space": halfspace_oracle(points, np.array([[1 / 3, 2 / 3, -2 / 3, -0.7]])),
        "prism": distance(triangle(2.0, 1.0), points[:, :2]),
    }
    planar, radius = points[:, :2], np.linalg.norm(points[:, :2], axis=1)
    expected_planar = {
        "disc": np.linalg.norm(planar - [0.5, -1.0], axis=1) - 1.5,
        "full disc": radius - 1.5,
        "full ring": np.maximum(radius - 1.5, 1.2 - radius),
        "half plane": halfspace_oracle(planar, np.array([[1, 2, -0.7 * math.sqrt(5)]]) / math.sqrt(5)),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(distance(ALL[name], points), value, rtol=0, atol=1e-12, err_msg=name)
    for name, value in expected_planar.items():
        np.testing.assert_allclose(distance(ALL[name], planar), value, rtol=0, atol=1e-12, err_msg=name)


def test_intersection_is_exact_inside_and_a_lower_bound_outside():
    corners = [[0, 0], [3, -3 * math.tan(0.5)], [3, 3 * math.tan(0.5)]]
    shape = intersection(triangle(3.0, 1.0), polygon(HEPTAGON), half_space([1.0, 0.0], 2.2))
    hulls = [ConvexHull(np.asarray(vertices, float)).equations for vertices in (corners, HEPTAGON)]
    points = draw_points(shape)
    exact = halfspace_oracle(points, np.concatenate([*hulls, [[1.0, 0.0, -2.2]]]))
    value = np.asarray(distance(shape, points))
    inside = exact <= 0
    assert inside.sum() > 100
    np.testing.assert_allclose(value[inside], exact[inside], rtol=0, atol=1e-9)
    assert np.all(value[~inside] <= exact[~inside] + 1e-9)
    assert np.all(value[~inside] > 0)
    assert np.any(value[~inside] < exact[~inside] - 0.1)


@pytest.mark.parametrize("name", ALL)
def test_gradient_has_unit_norm_and_matches_central_differences(name):
    shape = ALL[name]
    points, step = draw_points(shape, 2000, seed=1), 1e-6 * size_of(ALL[name])
    found = np.asarray(gradients(shape, jnp.asarray(points))[2])
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=0, atol=1e-7)
    shifts = step * np.eye(shape.dimension)[:, None]
    ends = np.concatenate([points + shifts, points - shifts]).reshape(-1, shape.dimension)
    ahead, behind = distance(shape, ends).reshape(2, shape.dimension, -1)
    expected = (ahead - behind).T / (2 * step)
    smooth = np.abs(np.linalg.norm(expected, axis=1) - 1) < 1e-4  # no kink between the two ends
    assert smooth.mean() > 0.99
    np.testing.assert_allclose(found[smooth], expected[smooth], rtol=0, atol=1e-3)

    single = np.asarray(gradients(in_float32(shape), jnp.asarray(points, jnp.float32))[2])
    assert single.dtype == np.float32
    close = np.abs(single - found).max(axis=1) < 1e-3  # the others lie where the nearest point changes
    assert close.mean() > 0.995
    assert np.mean(np.abs(np.linalg.norm(single, axis=1) - 1) < 1e-3) > 0.999


def special_points(shape):
    """Corners, points of edges and boundary, the apex, the axis of symmetry and beyond, and the middle."""
    size = size_of(shape)
    lines = shape.outline(size)
    lines = lines if isinstance(lines, list) else [lines]
    axis = np.zeros((81, shape.dimension))
    axis[:, 0] = np.linspace(-2 * size, 2 * size, 81)
    middle = np.concatenate(lines).mean(axis=0)
    points = np.concatenate([axis, middle[None], *lines, *[(line[1:] + line[:-1]) / 2 for line in lines]])
    return np.resize(points, (2000, shape.dimension))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("name", ALL)
def test_gradient_is_bounded_where_it_is_not_unique(name, dtype):
    shape = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), ALL[name])
    points = jnp.asarray(special_points(shape), dtype)
    value, by_shape, by_point = gradients(shape, points)
    assert by_point.dtype == dtype
    at_corner = np.abs(value) < 16 * jnp.finfo(dtype).eps * size_of(shape)
    bound = np.where(at_corner, 10.0, 1 + 1e-5)  # there the direction is all rounding
    assert np.all(np.linalg.norm(by_point, axis=1) <= bound)  # NaN fails too
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(by_shape))


def test_gradient_at_hand_computed_places():
    view = triangle(2.0, 2 * math.pi / 3)
    points = jnp.array([[1.9, 0.0], [3.0, 0.0], [-1.0, 0.0], [3.0, 2 * math.sqrt(3) + 1], [0.0, 1.0]])
    half = math.sqrt(0.5)
    expected = [[1.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [half, half], [-math.sqrt(0.75), 0.5]]
    np.testing.assert_allclose(gradients(view, points)[2], expected, atol=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_float32_agrees_with_float64(name):
    shape = ALL[name]
    points = draw_points(shape)
    single = distance(in_float32(shape), jnp.asarray(points, jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, distance(shape, points), rtol=0, atol=2e-6 * size_of(shape))


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


@pytest.mark.parametrize("name", ["paper", "camera", "cone narrow"])
def test_second_derivatives_match_differences_of_first(name):
    shape, step = ALL[name], 1e-6
    points = draw_points(shape, 200, seed=3)
    hessian = jax.jit(jax.vmap(jax.hessian(shape.signed_distance)))(points)
    slope = jax.jit(jax.vmap(jax.vmap(jax.grad(shape.signed_distance))))
    shifts = step * np.eye(shape.dimension)[:, None]
    differences = np.moveaxis(slope(points + shifts) - slope(points - shifts), 0, 1) / (2 * step)
    close = np.abs(hessian - differences).max(axis=(1, 2)) < 1e-4 * (1 + np.abs(hessian).max(axis=(1, 2)))
    assert close.mean() > 0.99  # the others lie where the nearest feature changes


def test_points_may_have_any_leading_axes():
    points = jnp.asarray(draw_points(ALL["camera"], 24)).reshape(2, 3, 4, 3)
    for shape in (ALL["camera"], ALL["cone reflex"], ALL["prism"], ALL["range-limited camera"]):
        nested = jax.jit(jax.vmap(jax.vmap(jax.vmap(shape.signed_distance))))(points)
        np.testing.assert_allclose(jitted_distance(shape, points), nested, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ALL)
def test_outline_lies_on_the_boundary(name):
    shape = ALL[name]
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
    sampled = name in ("lens", "range-limited camera")
    chord = 2e-3 * size_of(shape)  # how far the chords of an arc of 64 pieces lie within it
    np.testing.assert_allclose(distance(shape, points), 0.0, atol=chord if sampled else 1e-9)
    farthest = np.linalg.norm(points, axis=1).max()
    assert farthest <= float(shape.depth) + 1e-9
    if math.isfinite(shape.depth) and not sampled and "ball" not in name:
        assert farthest >= 0.999 * float(shape.depth)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: triangle(-1.0, 1.0), r"^depth must be .* > 0 \[m\], got -1.0$"),
        (lambda: triangle(math.nan, 1.0), "^depth must be .* got nan$"),
        (lambda: triangle(2.0, math.pi), r"^angle must be in \(0, pi\) .* got 3.14"),
        (lambda: polygon([[0, 0], [1, 0]]), r"^vertices must be .* v >= 3, got \(2, 2\)$"),
        (lambda: polygon([[0, 0], [1, 0], [0, math.inf]]), "^vertices must be finite"),
        (lambda: polygon([[0, 0], [1, 0], [2, 0]]), "^vertices must be of non-zero area"),
        (lambda: polygon([[0, 0], [0, 0], [1, 0], [0, 1]]), "^vertices must be free of repetitions"),
        (lambda: polygon([[0, 0], [2, 0], [0.5, 0.5], [0, 2]]), "^vertices must be .* convex"),
        (lambda: polygon([on_star(k) for k in range(5)]), "^vertices must be .* convex"),
        (lambda: sector(0.0, 1.0), "^radius must be .* got 0.0$"),
        (lambda: sector(1.0, 6.3), r"^angle must be in \(0, 2 pi\] .* got 6.3$"),
        (lambda: sector(1.0, 1.0, 1.0), r"^near must be in \[0, radius = 1.0\) .* got 1.0$"),
        (lambda: half_space([0.0, 0.0], 1.0), "^normal must be .* not all 0"),
        (lambda: half_space([1.0, 0.0], math.inf), "^offset must be a finite"),
        (lambda: ball([0.0], 1.0), "^center must be 2 or 3"),
        (lambda: ball([0.0, 0.0], math.nan), "^radius must be .* got nan$"),
        (lambda: cone(2.0, 1.0, 1.0), r"^near must be in \[0, far = 1.0\) .* got 2.0$"),
        (lambda: cone(0.0, math.inf, 1.0), "^far must be a finite"),
        (lambda: cone(0.0, 1.0, 0.0), r"^angle must be in \(0, 2 pi\]"),
        (lambda: frustum(-1.0, 1.0, 1.0, 1.0), "^near must be .* got -1.0$"),
        (lambda: frustum(0.0, -1.0, 1.0, 1.0), "^far must be a finite number > 0"),
        (lambda: frustum(0.0, 1.0, 4.0, 1.0), "^width_angle must be in .* got 4.0$"),
        (lambda: frustum(0.0, 1.0, 1.0, math.nan), "^height_angle must be in .* got nan$"),
        (lambda: prism(ball([0.0, 0.0, 0.0], 1.0)), "^dimension of the prism's base must be 2, got 3$"),
        (lambda: intersection(), "^dimensions of the shapes must be equal"),
        (lambda: intersection(triangle(1.0, 1.0), cone(0.0, 1.0, 1.0)), r"got \[2, 3\]$"),
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
    points = draw_points(square, 1000)
    expected = halfspace_oracle(points, ConvexHull([[0, 0], [0, 1], [1, 1], [1, 0]]).equations)
    np.testing.assert_allclose(distance(square, points), expected, atol=1e-12)
