"""Recordings in a robot's map, against shapely and the pixels of its image."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.recordings import ANGLE, DEPTH, TAU, track
from helpers.recordings import recording as made
from PIL import Image

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.io.toml import load_toml
from foveate.recordings.fit import fit
from foveate.recordings.maps import in_obstacles, map_of, under, warnings_of
from foveate.recordings.recording import resample
from foveate.recordings.replay import drive, prepare_replay
from foveate.recordings.starts import agent_starts
from foveate.scenario.obstacles import BaseObstacles, OccupancyObstacles
from foveate.scenario.random_obstacles import CircleObstacles
from foveate.simulation.records import Policy

CELL, LOW = 0.25, (-10.0, -7.5)
WALLS = ((-3.0, -2.0, -2.5, 3.0), (1.0, -5.0, 1.5, -0.5), (4.5, -1.5, 5.5, -0.25))
"""Rectangles of occupied cells, x0, y0, x1, y1 [m]."""
RADIUS_M = BaseObstacles.robot_radius_m


@pytest.fixture(scope="module")
def map_file(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("map")
    pixels = np.full((60, 100), 254, np.uint8)
    for x0, y0, x1, y1 in WALLS:
        columns = [round((x - LOW[0]) / CELL) for x in (x0, x1)]
        rows = [round((y - LOW[1]) / CELL) for y in (y0, y1)]
        pixels[60 - rows[1] : 60 - rows[0], columns[0] : columns[1]] = 0
    Image.fromarray(pixels).save(folder / "map.png")
    text = f"image: map.png\nresolution: {CELL}\norigin: [{LOW[0]}, {LOW[1]}, 0.0]\n"
    (folder / "map.yaml").write_text(text, encoding="utf-8")
    return folder / "map.yaml"


@pytest.fixture(scope="module")
def walls():
    return shapely.union_all([shapely.box(*wall) for wall in WALLS])


class Weaving(Policy):
    """Drives slowly ahead, and turns left and right."""

    def __call__(self, observation, memory, key):
        return jnp.stack([-0.95, jnp.where(observation.step % 16 < 8, 0.15, -0.15)]), memory


def test_a_robot_keeps_out_of_walls_and_sees_nothing_behind_them(scenario, recording, map_file, walls):
    """Each place and look of a robot that drives on; looks near a wall's edge, or the view's, are not judged."""
    inside, warnings = under(recording, scenario, map_file)
    assert warnings == []
    (start,) = agent_starts(recording, inside, [-0.6, -1.4, 0.0], 1, 0)
    ready = prepare_replay(inside, recording, start, 2.0, gate=None)
    row, trace = drive(ready, "weaving", Weaving())
    poses = np.asarray(trace.pose)
    assert shapely.distance(walls, shapely.points(poses[:, :2])).min() >= RADIUS_M - 1e-3
    assert np.ptp(poses[:, 0]) > 1.0

    present = ready.slots.present[1:] & (ready.slots.track_index[1:] == ready.slots.track_index[:-1])
    eyes = np.broadcast_to(poses[1:, None, :2], ready.truth[1:].shape)
    offset = ready.truth[1:] - eyes
    turned = np.arctan2(offset[..., 1], offset[..., 0]) - poses[1:, None, 2]
    off_axis = np.degrees(np.abs((turned + np.pi) % (2 * np.pi) - np.pi))
    away = np.linalg.norm(offset, axis=-1)
    in_view = present & (away < DEPTH - 0.05) & (off_axis < ANGLE / 2 - 1)
    lines = shapely.linestrings(np.stack([eyes, ready.truth[1:]], axis=2))
    hidden, clear = (shapely.intersects(walls.buffer(grown), lines) for grown in (-0.6 * CELL, 0.6 * CELL))
    seen = np.asarray(trace.visible)
    assert not seen[hidden].any()
    assert not seen[(away > DEPTH + 0.05) | (off_axis > ANGLE / 2 + 1)].any()
    assert seen[in_view & ~clear].all()
    assert (in_view & hidden).sum() > 10
    assert (in_view & ~clear).sum() > 3
    assert trace.contacts is not None
    assert row.contacts == trace.contacts[-1] > 0
    assert ready.inside is not None
    assert row.in_obstacles == ready.inside.sum() > 0


def test_a_robot_that_keeps_off_walls_does_so_in_another_map(scenario, recording, map_file, walls):
    """The way of the test above, on which one without a filter has contacts."""
    own = CircleObstacles(maps=1, test_maps=0, keep_off_m=0.1)
    inside, _ = under(recording, replace(scenario, obstacles=own), map_file)
    (start,) = agent_starts(recording, inside, [-0.6, -1.4, 0.0], 1, 0)
    row, trace = drive(prepare_replay(inside, recording, start, 2.0, gate=None), "weaving", Weaving())
    assert row.contacts == 0
    assert shapely.distance(walls, shapely.points(np.asarray(trace.pose)[:, :2])).min() >= RADIUS_M + 0.1 - 1e-3


def test_targets_in_walls_are_counted_and_said(scenario, recording, map_file):
    """By the cells of the map in which the fixes are, where they are not at a cell's edge."""
    inside, _ = under(recording, scenario, map_file)
    slots = resample(recording, TAU)
    found = in_obstacles(inside.problem().obstacles, slots)
    assert found is not None
    x, y = np.moveaxis(slots.positions_m, -1, 0)
    margin = 0.5 * CELL
    within = [(x > x0 + margin) & (x < x1 - margin) & (y > y0 + margin) & (y < y1 - margin) for x0, y0, x1, y1 in WALLS]
    around = [(x > x0 - margin) & (x < x1 + margin) & (y > y0 - margin) & (y < y1 + margin) for x0, y0, x1, y1 in WALLS]
    sure, near = (np.any(each, axis=0) & slots.present for each in (within, around))
    assert sure.sum() > 5
    assert found[sure].all()
    assert not found[~near].any()
    (line,) = warnings_of(found, slots)
    assert f"at {found.sum()} of {slots.present.sum()} instants" in line
    assert warnings_of(np.zeros_like(found), slots) == warnings_of(None, slots) == []


def test_starts_are_outside_of_walls(scenario, recording, map_file, walls):
    inside, _ = under(recording, scenario, map_file)
    given = np.array(agent_starts(recording, inside, None, 40, seed=3))
    before = np.array(agent_starts(recording, scenario, None, 40, seed=3))
    room = shapely.distance(walls, shapely.points(before[:, :2]))
    assert shapely.distance(walls, shapely.points(given[:, :2])).min() > RADIUS_M
    free = room > RADIUS_M + 1.5 * CELL
    np.testing.assert_array_equal(given[free], before[free])
    assert 0 < (~free).sum() < 20
    assert np.linalg.norm((given - before)[:, :2], axis=1).max() < 1.5
    with pytest.raises(InputError, match=r"^agent_start 1\.25,-2,0: is in an obstacle: expected more than 0\.5"):
        agent_starts(recording, inside, [1.25, -2.0, 0.0], 1, 0)


def test_a_fitted_scenario_has_the_map(recording, map_file, tmp_path):
    fitted = fit(recording, map=map_file, tau=TAU)
    fitted.save(tmp_path / "s.toml")
    scenario = load_toml(Experiment, tmp_path / "s.toml").scenario
    assert scenario.obstacles == OccupancyObstacles(file=str(map_file), targets="free")
    assert scenario == replace(fit(recording, tau=TAU).experiment.scenario, obstacles=scenario.obstacles)
    positions = np.concatenate([each.positions_m for each in recording.tracks])
    occupied = shapely.intersects(shapely.union_all([shapely.box(*wall) for wall in WALLS]), shapely.points(positions))
    count = int(repr(fitted).partition(f"map {map_file}: ")[2].split()[0])
    assert count == pytest.approx(occupied.sum(), abs=4)


def test_in_space_walls_hold_the_heights_of_the_recording(map_file):
    flight = made(track(np.arange(9.0), np.linspace([-5.0, 0.0, 1.0], [5.0, 2.0, 4.0], 9)))
    assert map_of(flight, map_file).heights_m == (-1.0, 6.0)
    own = OccupancyObstacles(file="another.yaml", heights_m=(0.0, 2.0), robot_radius_m=0.4, keep_off_m=0.2)
    assert map_of(flight, map_file, own) == replace(own, file=str(map_file), targets="free")


def test_a_recording_is_in_no_random_map(scenario, recording):
    among, warnings = under(recording, replace(scenario, obstacles=CircleObstacles(maps=1, test_maps=0)), None)
    assert among == scenario
    assert "replayed in the open" in warnings[0]


def test_a_map_must_hold_the_recording(scenario, recording, map_file):
    far = made(track([0.0, 1.0], [[0.0, 0.0], [0.0, 8.0]]))
    for read in (lambda: map_of(far, map_file), lambda: fit(far, map=map_file), lambda: under(far, scenario, map_file)):
        with pytest.raises(InputError, match=r"does not hold made up, from \(0, 0\) to \(0, 8\) m: expected the map"):
            read()
    with pytest.raises(InputError, match=r"no\.yaml: there is no such file"):
        map_of(recording, map_file.parent / "no.yaml")
    with pytest.raises(InputError, match="positions have 2 numbers"):
        under(recording, PRESETS["quadrotor"].scenario, map_file)
