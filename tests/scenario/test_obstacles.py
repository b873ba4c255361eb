"""Settings of obstacles: random maps of each kind, files, and one line for what cannot be."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from PIL import Image
from scipy.ndimage import label

from foveate.errors import InputError
from foveate.geometry.sight import margin
from foveate.io.toml import digest, dumps_toml, load_toml
from foveate.scenario.agent import Quadrotor
from foveate.scenario.field_of_view import FrustumView
from foveate.scenario.obstacle_grids import MAX_NODES
from foveate.scenario.obstacles import OccupancyObstacles, ShapeObstacles
from foveate.scenario.random_obstacles import CircleObstacles, ForestObstacles, RoomObstacles, StreetObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import LinearTarget

HALL = SceneSettings(
    targets_min=2, targets_max=3, half_side_m=(8.0, 8.0), half_side_per_target_m=0.0, agent_spread=1.0, steps=6
)
BOX = ((-8.0, -8.0), (8.0, 8.0))
SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))
FEW = {"maps": 3, "test_maps": 2}
AIR = replace(HALL, centre_m=(0.0, 0.0, 2.0), half_side_m=(8.0, 8.0, 2.0), drift_m_s=(0.0,) * 3)


def rng():
    return np.random.default_rng(0)


def test_circles_have_their_density_and_sizes():
    settings = CircleObstacles(density_per_m2=0.05, radius_m=(0.5, 2.0))
    shapes = settings.shapes_in(rng(), np.full(2, -50.0), np.full(2, 50.0))
    assert len(shapes) == pytest.approx(500, abs=5 * 500**0.5)
    radii = np.array([shape.radius for shape in shapes])
    assert 0.5 <= radii.min() < 0.6 < 1.9 < radii.max() <= 2.0


@pytest.mark.parametrize("seed", range(4))
def test_every_room_can_be_reached(seed):
    """The ground that is free for the agent is one piece, but for nothing, on the grid itself."""
    settings = RoomObstacles(robot_radius_m=0.2, seed=seed, maps=2, test_maps=1)
    obstacles = settings.obstacles(BOX, 5.0)
    needed = float(margin(obstacles.grid, jnp.asarray(0.2)))
    for distance in settings.nodes(BOX).distance:
        edge = 5  # cells of the border around the hall
        pieces, count = label(distance[edge:-edge, edge:-edge] > needed)
        sizes = np.bincount(pieces.ravel())[1:]
        assert count >= 1
        assert sizes.max() / sizes.sum() > 0.98


def test_walls_have_doors_of_their_width_and_the_hall_is_closed():
    settings = RoomObstacles(door_m=1.6, wall_m=0.3)
    walls = shapely.union_all([shapely.Polygon(s.corners) for s in settings.shapes_in(rng(), *map(np.array, BOX))])
    outside = shapely.difference(shapely.box(-10, -10, 10, 10), walls)
    assert shapely.get_num_geometries(outside) == 2  # all rooms together, and the world around them
    narrower = shapely.difference(shapely.box(-8, -8, 8, 8), walls.buffer(0.75, join_style="mitre"))
    wider = shapely.difference(shapely.box(-8, -8, 8, 8), walls.buffer(0.85, join_style="mitre"))
    assert shapely.get_num_geometries(narrower) == 1 < shapely.get_num_geometries(wider)


def test_streets_are_as_wide_as_they_say():
    blocks = StreetObstacles(block_m=4.0, street_m=3.0).shapes_in(rng(), np.full(2, -20.0), np.full(2, 20.0))
    boxes = [shapely.Polygon(block.corners) for block in blocks]
    assert len(boxes) > 15
    gaps = [a.distance(b) for i, a in enumerate(boxes) for b in boxes[:i]]
    assert min(gaps) == pytest.approx(3.0)


def test_trunks_stand_on_the_ground():
    trunks = ForestObstacles(height_m=(5.0, 10.0)).shapes_in(rng(), np.array([-9.0, -9.0, 1.0]), np.full(3, 9.0))
    assert {trunk.low for trunk in trunks} == {1.0}
    assert all(6.0 <= trunk.high <= 11.0 for trunk in trunks)


def test_maps_depend_on_their_number_and_not_on_how_many_there_are():
    few, more = (CircleObstacles(maps=n, test_maps=n).nodes(BOX).distance for n in (2, 3))
    assert few.shape[1:] == more.shape[1:]
    np.testing.assert_array_equal(few[:2], more[:2])
    np.testing.assert_array_equal(few[2:], more[3:5])
    assert len({each.tobytes() for each in more}) == 6


@pytest.mark.parametrize(
    ("obstacles", "message"),
    [
        (CircleObstacles(maps=10**12), "resolution_m = 0.2: expected a larger cell, or fewer maps"),
        (CircleObstacles(density_per_m2=1e9), r"density_per_m2 = 1000000000.0: expected at most 39.1: 10000 obstacles"),
        (ForestObstacles(density_per_m2=1e9), r"density_per_m2 = 1000000000.0: expected at most 39.1: 10000 obstacles"),
    ],
)
def test_what_would_take_for_ever_is_said_at_once(obstacles, message):
    box = BOX if obstacles.dimension == 2 else tuple((*corner, z) for corner, z in zip(BOX, (0.0, 5.0), strict=True))
    with pytest.raises(InputError, match=message):
        obstacles.nodes(box)


def test_a_box_without_an_area_has_no_circles():
    """All starts in one place: no density is too much there."""
    assert CircleObstacles().shapes_in(rng(), np.zeros(2), np.zeros(2)) == []


@pytest.mark.parametrize(
    ("obstacles", "scenes"),
    [
        (RoomObstacles(**FEW), HALL),
        (StreetObstacles(**FEW), HALL),
        (CircleObstacles(**FEW), HALL),
        (ShapeObstacles(polygons=(SQUARE,), circles=((4.0, 4.0, 1.0),), boxes=((-3.0, -3.0, -2.0, -1.0),)), HALL),
        (ForestObstacles(**FEW), AIR),
        (
            ShapeObstacles(
                polygons=(SQUARE,),
                heights_m=((0.0, 2.0),),
                boxes=((-3.0, -3.0, 0.0, -2.0, -1.0, 1.0),),
                resolution_m=0.5,
            ),
            AIR,
        ),
    ],
)
def test_a_scenario_is_written_and_read_back(tmp_path, obstacles, scenes):
    robot = {"agent": Quadrotor(), "view": FrustumView()} if scenes is AIR else {}
    scenario = Scenario(obstacles=obstacles, scenes=scenes, **robot)
    (tmp_path / "s.toml").write_text(dumps_toml(scenario), encoding="utf-8")
    assert load_toml(Scenario, tmp_path / "s.toml") == scenario
    assert digest(scenario) != digest(replace(scenario, obstacles=None))
    built = scenario.problem().obstacles
    assert built is not None
    assert built.grid.maps == sum(obstacles.map_counts)
    assert built.training == obstacles.map_counts[0]


def map_file(folder, size=(40, 40), origin=(-10.0, -10.0)):
    pixels = np.full(size, 254, np.uint8)
    pixels[18:22, 5:30] = 0
    Image.fromarray(pixels).save(folder / "map.png")
    text = f"image: map.png\nresolution: 0.5\norigin: [{origin[0]}, {origin[1]}, 0.0]\n"
    (folder / "map.yaml").write_text(text, encoding="utf-8")
    return str(folder / "map.yaml")


def test_a_robots_map_becomes_obstacles(tmp_path):
    """A wall from x = -7.5 to 5 and y = -1 to 1, in a hall of 20 m; in space it is two metres high."""
    file = map_file(tmp_path)
    walls = shapely.box(-7.5, -1.0, 5.0, 1.0)
    flat = Scenario(obstacles=OccupancyObstacles(file=file), scenes=HALL).problem().obstacles
    places = np.random.default_rng(0).uniform(-8.0, 8.0, (500, 2))
    expected = shapely.distance(walls, shapely.points(places))
    edge = 10.0 - np.abs(places).max(axis=1)
    outside = expected > 0
    found = np.asarray(flat.grid(jnp.asarray(places)))
    np.testing.assert_allclose(found[outside], np.minimum(expected, edge)[outside], atol=0.25)
    assert (found[~outside] < 0.25).all()

    high = OccupancyObstacles(file=file, heights_m=(0.0, 2.0))
    tall = Scenario(obstacles=high, scenes=AIR, agent=Quadrotor(), view=FrustumView()).problem().obstacles
    assert float(tall.grid(jnp.array([0.0, 0.0, 3.2]))) == pytest.approx(1.2, abs=0.3)
    assert float(tall.grid(jnp.array([0.0, 0.0, 1.0]))) < 0


EYE = ((1.0, 0.0), (0.0, 1.0))
TURNED = LinearTarget(kind="linear", A=EYE, B=EYE, W=EYE, Z=EYE[::-1], prior=EYE)
BAD = {
    "nothing": (lambda: ShapeObstacles(), "polygons = (): expected at least one obstacle"),
    "clockwise": (lambda: ShapeObstacles(polygons=(SQUARE[::-1],)), "expected a convex polygon, counterclockwise"),
    "a flat circle": (lambda: ShapeObstacles(circles=((0.0, 0.0, 0.0),)), "expected x, y, radius > 0"),
    "an empty box": (lambda: ShapeObstacles(boxes=((0.0, 0.0, 1.0, 0.0),)), "expected 4 numbers"),
    "a box of five": (lambda: ShapeObstacles(boxes=((0.0,) * 5,)), "expected 4 numbers"),
    "heights short": (lambda: ShapeObstacles(polygons=(SQUARE,) * 2, heights_m=((0.0, 1.0),)), "or 2 pairs"),
    "heights crossed": (lambda: ShapeObstacles(polygons=(SQUARE,), heights_m=((1.0, 0.0),)), "expected low < high"),
    "flat in space": (
        lambda: ShapeObstacles(polygons=(SQUARE,), boxes=((0.0, 0.0, 0.0, 1.0, 1.0, 1.0),)),
        "expected heights of polygons and circles in space",
    ),
    "thin": (lambda: ShapeObstacles(boxes=((0.0, 0.0, 0.05, 4.0),)), "resolution_m = 0.1: expected at most 0.05"),
    "fine": (
        lambda: Scenario(obstacles=ShapeObstacles(polygons=(SQUARE,), resolution_m=1e-3), scenes=HALL),
        f"at most {MAX_NODES}",
    ),
    "no number": (lambda: CircleObstacles(resolution_m=float("nan")), "resolution_m = nan: expected a finite number"),
    "a giant": (
        lambda: Scenario(obstacles=CircleObstacles(robot_radius_m=50.0, **FEW), scenes=HALL),
        "robot_radius_m = 50",
    ),
    "a wall all over": (
        lambda: Scenario(obstacles=ShapeObstacles(boxes=((-9.0, -9.0, 9.0, 9.0),)), scenes=HALL),
        "obstacles.kind: a map has no place outside of obstacles in the box",
    ),
    "too far off": (
        lambda: Scenario(obstacles=CircleObstacles(keep_off_m=50.0, **FEW), scenes=HALL),
        "keep_off_m = 50",
    ),
    "a corner twice": (lambda: ShapeObstacles(polygons=(SQUARE[:1] + SQUARE,)), "none twice and no three in a line"),
    "doors that it keeps off": (lambda: RoomObstacles(keep_off_m=0.5), "door_m = 1.6: expected > 1.9"),
    "small circles": (lambda: CircleObstacles(radius_m=(0.01, 1.0)), "radius_m = (0.01, 1.0): expected 0.1 <= low"),
    "no maps": (lambda: CircleObstacles(maps=0), "maps = 0: expected >= 1"),
    "paper walls": (lambda: RoomObstacles(wall_m=0.1), "wall_m = 0.1: expected >= a cell, 0.2"),
    "narrow doors": (lambda: RoomObstacles(door_m=0.8), "door_m = 0.8: expected > 0.9"),
    "small rooms": (lambda: RoomObstacles(room_m=2.0), "room_m = 2.0: expected > 1.5"),
    "narrow streets": (lambda: StreetObstacles(street_m=0.5), "street_m = 0.5: expected > 0.9"),
    "another space": (lambda: Scenario(obstacles=ForestObstacles()), "expected obstacles in 2 dimensions"),
    "no position": (
        lambda: Scenario(target=TURNED, obstacles=CircleObstacles(**FEW), scenes=replace(HALL, drift_m_s=(0.0, 0.0))),
        "obstacles.targets = 'around': expected 'free'",
    ),
    "births": (
        lambda: Scenario(scenes=replace(HALL, birth_and_death=True), obstacles=CircleObstacles(**FEW)),
        "expected 'free' with scenes.birth_and_death",
    ),
    "no file": (lambda: Scenario(obstacles=OccupancyObstacles(file="nowhere.yaml"), scenes=HALL), "nowhere.yaml"),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_one_line(name):
    make, words = BAD[name]
    with pytest.raises(InputError) as caught:
        make()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_map_that_does_not_hold_the_scene_is_one_line(tmp_path):
    file = map_file(tmp_path, origin=(-2.0, -10.0))
    with pytest.raises(InputError, match=r"obstacles\.file = .* does not hold the scene, from \(-8, -8\)") as caught:
        Scenario(obstacles=OccupancyObstacles(file=file), scenes=HALL)
    assert "\n" not in str(caught.value)
