"""The robots of a team in a spatial scene: all in its box, each where it is, with lines between those that hear."""

import numpy as np
from helpers.episode_data import late_sightings
from scipy.spatial.transform import Rotation

from foveate.io.figures import new_figure
from foveate.plotting.episode_data import SUBSTEPS
from foveate.plotting.mates_spatial import DART
from foveate.plotting.scene_spatial import SpatialScene, limits

RNG = np.random.default_rng(3)
POSES = np.tile(np.eye(4), (5, 2, 1, 1))
POSES[..., :3, 3] = RNG.normal(0, 9.0, (5, 2, 3))
POSES[..., :3, :3] = Rotation.random(10, random_state=RNG).as_matrix().reshape(5, 2, 3, 3)
HEARD = np.zeros((4, 3, 3), bool)
HEARD[2, 0, 1] = HEARD[2, 1, 0] = HEARD[2, 2, 0] = True


def test_every_robot_is_where_it_is_and_linked_to_whom_it_has_heard():
    views = tuple(tuple(scale * line for line in late_sightings(3).outline) for scale in (2.0, 0.5))
    data = late_sightings(3, mates=POSES, heard=HEARD, mate_outlines=views)
    box = limits([data])
    assert np.all((box[0] <= POSES[..., :3, 3]) & (POSES[..., :3, 3] <= box[1]))
    scene = SpatialScene(new_figure(3.0, 3.0).add_subplot(axes_class=SpatialScene.axes_class), data, box)
    scene.show(3 * SUBSTEPS)
    mates = scene.mates
    for i in range(2):
        pose = POSES[3, i]
        nose = pose[:3, :3] @ (scene.size * DART[0]) + pose[:3, 3]
        np.testing.assert_allclose(np.asarray(mates.bodies[i]._faces)[0, 0], nose, atol=1e-9)
        np.testing.assert_allclose(np.array(mates.paths[i].get_data_3d()).T[-1], pose[:3, 3], atol=1e-9)
        corner = pose[:3, :3] @ views[i][0][1] + pose[:3, 3]
        np.testing.assert_allclose(np.asarray(mates.edges[i]._segments3d[0])[1], corner, atol=1e-9)
    places = [data.pose[3, :3, 3], *POSES[3, :, :3, 3]]
    np.testing.assert_allclose(np.array(mates.both.get_data_3d()).T[:2], [places[0], places[1]])
    np.testing.assert_allclose(np.array(mates.one.get_data_3d()).T[:2], [places[0], places[2]])
    scene.show(0)
    assert np.array(mates.both.get_data_3d()).size == 0
