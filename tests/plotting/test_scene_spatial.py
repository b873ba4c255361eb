"""Pictures of episodes in space: what is drawn stands where an outside oracle says, in whatever the camera shows."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episode_data import random_episode
from PIL import Image
from scipy.linalg import expm
from scipy.spatial.transform import Rotation, Slerp

from foveate.geometry.fov_spatial import frustum
from foveate.geometry.space import SPACES
from foveate.io.figures import new_figure
from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.planning.named import heuristic_policy
from foveate.plotting import animation, figures
from foveate.plotting import scene as drawing
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, episode_data
from foveate.plotting.replay_figure import replay_figure
from foveate.plotting.scene_spatial import DART, SpatialScene, scene_class
from foveate.simulation.records import TRUE, Episode, Truth
from foveate.simulation.rollout import rollout

FRUSTUM = tuple(frustum(0.3, 6.0, 1.4, 1.0).outline())


def hat(twist):
    v, (x, y, z) = twist[:3], twist[3:]
    return np.array([[0, -z, y, v[0]], [z, 0, -x, v[1]], [-y, x, 0, v[2]], [0, 0, 0, 0]])


def made_up(steps=4, n=3, seed=0, **changes) -> EpisodeData:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(steps + 1, n, 3, 3))
    truth = rng.uniform(-6, 6, (n, 3)) + rng.normal(0, 0.3, (steps + 1, n, 3)).cumsum(axis=0)
    pose = [expm(hat(rng.normal(size=6)))]
    for _ in range(steps):
        pose.append(pose[-1] @ expm(hat(rng.normal(0, 0.5, 6))))
    values = {
        "title": "made up",
        "space": SPACES["spatial"],
        "visible": rng.random((steps, n)) < 0.4,
        "log_det": rng.normal(3, 2, (steps, n)),
        "times_s": 0.5 * np.arange(steps + 1),
        "pose": np.array(pose),
        "truth": truth,
        "estimate": truth + rng.normal(0, 0.4, (steps + 1, n, 3)),
        "covariance": root @ root.swapaxes(-1, -2) + 0.1 * np.eye(3),
        "present": np.ones((steps + 1, n), bool),
        "outline": FRUSTUM,
    }
    return EpisodeData(**{**values, **changes})


def scene(which: EpisodeData, moment: int, **options) -> SpatialScene:
    axes = new_figure(3.0, 3.0).add_subplot(axes_class=SpatialScene.axes_class)
    shown = SpatialScene(axes, which, SpatialScene.limits([which]), **options)
    shown.show(moment)
    return shown


def line(drawn) -> np.ndarray:
    return np.array(drawn.get_data_3d()).T


def corners(collection) -> list[np.ndarray]:
    """The lines of a 3-D collection, in the world."""
    return [np.array(part) for part in collection._segments3d]


# The way between two poses


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.7, 3.1, np.pi - 1e-9])
def test_arc_is_the_exponential_of_a_constant_twist(angle):
    rng = np.random.default_rng(3)
    axis = rng.normal(size=3)
    twist = hat(np.append(rng.normal(size=3), angle * axis / np.linalg.norm(axis)))
    start = expm(hat(rng.normal(size=6)))
    arc = made_up(1, 0, pose=np.array([start, start @ expm(twist)])).arc()
    assert arc.shape == (SUBSTEPS + 1, 4, 4)
    for i, pose in enumerate(arc):
        np.testing.assert_allclose(pose, start @ expm(twist * i / SUBSTEPS), atol=1e-12)


def test_arc_turns_evenly_from_instant_to_instant():
    which = made_up(5, 0, seed=2)
    arc, turns = which.arc(), Rotation.from_matrix(which.pose[:, :3, :3])
    np.testing.assert_allclose(arc[::SUBSTEPS], which.pose, atol=1e-12)
    expected = Slerp(np.arange(6), turns)(np.arange(len(arc)) / SUBSTEPS)
    np.testing.assert_allclose(arc[:, :3, :3], expected.as_matrix(), atol=1e-12)


# The scene


def test_view_and_agent_are_moved_by_the_pose():
    which = made_up(3, 2, seed=1)
    for instant in range(4):
        shown, pose, dart = scene(which, 0), which.pose[instant], []
        shown.agent.set_verts = dart.extend
        shown.show(SUBSTEPS * instant)
        for drawn, border in zip(corners(shown.edges), FRUSTUM, strict=True):
            expected = [(pose @ np.append(point, 1.0))[:3] for point in border]
            np.testing.assert_allclose(drawn, expected, atol=1e-12)
        nose = (pose @ np.append(shown.size * DART[0], 1.0))[:3]
        assert np.abs(np.concatenate(dart) - nose).sum(axis=1).min() < 1e-12


def test_drop_lines_end_on_the_ground():
    which = made_up(3, 2)
    shown = scene(which, SUBSTEPS)
    lowest = SpatialScene.limits([which])[0, 2]
    posts = np.append(which.truth[1], which.pose[1, None, :3, 3], axis=0)
    drops = line(shown.drops).reshape(-1, 3, 3)
    np.testing.assert_allclose(drops[:, 0], posts)
    np.testing.assert_allclose(drops[:, 1, :2], posts[:, :2])
    assert (drops[:, 1, 2] == lowest).all()
    np.testing.assert_allclose(line(shown.shadows), drops[:, 1])
    assert (line(shown.path_shadow)[:, 2] == lowest).all()


def test_colour_follows_the_measurement_of_the_instant():
    which = made_up(2, 3, visible=np.array([[1, 0, 0], [0, 1, 1]], bool))
    for instant, seen in ((0, []), (1, [0]), (2, [1, 2])):
        shown = scene(which, SUBSTEPS * instant)
        unseen = [j for j in range(3) if j not in seen]
        np.testing.assert_array_equal(line(shown.seen_means), which.estimate[instant][seen])
        np.testing.assert_array_equal(line(shown.unseen_means), which.estimate[instant][unseen])
        side = np.ptp(SpatialScene.limits([which]), axis=0).max()
        # The widths of a region: 7.815, the 95 % quantile of chi-square with 3 degrees of freedom.
        wide = 2 * np.sqrt(7.815 * np.diagonal(which.covariance[instant], axis1=1, axis2=2)).max(axis=1) > 0.6 * side
        assert len(corners(shown.seen_net)) == 3 * (~wide[seen]).sum()
        assert len(corners(shown.unseen_net)) == 3 * (~wide[unseen]).sum()


def test_absent_targets_are_not_drawn():
    present = np.ones((4, 3), bool)
    present[:, 1] = False
    present[2:, 2] = False
    which = made_up(3, 3, present=present)
    far = which.truth.copy()
    far[:, 1] = 1e6
    which = dataclasses.replace(which, truth=far, estimate=far)
    assert np.abs(SpatialScene.limits([which])).max() < 100
    for instant, there in ((0, [0, 2]), (3, [0])):
        shown = scene(which, SUBSTEPS * instant)
        np.testing.assert_array_equal(line(shown.targets), which.truth[instant][there])
        assert len(shown.seen_means.get_data_3d()[0]) + len(shown.unseen_means.get_data_3d()[0]) == len(there)
        assert len(line(shown.shadows)) == len(there) + 1
        assert np.nanmax(np.abs(line(shown.trails))) < 100


def test_scales_are_equal_and_the_box_stays_in_sight_as_the_camera_swings():
    which = made_up(4, 3)
    box = SpatialScene.limits([which])
    points = np.concatenate([which.truth.reshape(-1, 3), which.pose[:, :3, 3]])
    assert (points > box[0]).all()
    assert (points < box[1]).all()
    figure = new_figure(5.0, 3.0, layout=None)
    axes = figure.add_axes((0.1, 0.0, 0.7, 0.9), axes_class=SpatialScene.axes_class)
    shown = SpatialScene(axes, which, box, trail=40)
    eyes = []
    for moment in (0, 2 * SUBSTEPS, 4 * SUBSTEPS):
        shown.show(moment)
        figure.canvas.draw()
        assert axes.bbox.width == pytest.approx(0.7 * figure.bbox.width)
        x, y, _, w = axes.get_proj() @ np.append(points, np.ones((len(points), 1)), axis=1).T
        pixels = axes.transData.transform(np.stack([x / w, y / w], axis=1))
        assert axes.bbox.padded(1).count_contains(pixels) == len(points)
        # The camera's plane is shown at equal scales, so that a ball is round; so is the box behind it, next.
        across, up = np.diag(axes.transData.get_matrix())[:2]
        assert across == pytest.approx(up)
        eyes.append(axes.eye)
    np.testing.assert_allclose(axes._box_aspect / np.ptp(box, axis=0), axes._box_aspect[0] / np.ptp(box[:, 0]))
    assert np.linalg.norm(eyes[2] - eyes[0]) > 1.0
    assert all(np.abs(axes.get_proj()[[0, 1, 3]] @ np.append(eyes[2], 1.0)) < 1e-9)


def test_a_region_is_drawn_with_its_twelve_edges_and_is_in_sight():
    region = np.array([[-9.0, -10, 0], [9, 10, 6]])
    which = made_up(2, 3, region=region)
    shown = scene(which, 0)
    drawn = [net for net in shown.axes.collections if net is not shown.unseen_net and net is not shown.seen_net]
    edges = [np.asarray(line) for net in drawn for line in getattr(net, "_segments3d", ()) if len(line) == 5]
    assert sorted(np.ptp(edge, axis=0).tolist() for edge in edges)[-2:] == [[18.0, 20.0, 0.0]] * 2
    low, high = SpatialScene.limits([which])
    assert (low < region[0]).all()
    assert (high > region[1]).all()


def test_limits_of_one_point_alone_are_a_box():
    alone = made_up(0, 0, outline=(), visible=np.zeros((0, 0), bool), times_s=np.zeros(1))
    low, high = SpatialScene.limits([alone])
    assert (low < alone.pose[0, :3, 3]).all()
    assert (high > alone.pose[0, :3, 3]).all()


def test_scene_class_follows_the_space():
    assert scene_class(made_up()) is SpatialScene
    assert scene_class(dataclasses.replace(made_up(), space=SPACES["planar"])) is drawing.PlanarScene


# Files


def test_constant_velocity_shows_positions_and_their_covariance(tmp_path):
    eye, none = jnp.eye(3), jnp.zeros((3, 3))
    Z = jnp.hstack([eye, none])
    A = jnp.block([[eye, 0.5 * eye], [none, eye]])
    problem = Problem(
        agent=Agent(SPACES["spatial"], (0, 1, 2, 5), -jnp.ones(4), jnp.ones(4)),
        sensor=Sensor(Z, 0.04 * eye, frustum(0.3, 6.0, 1.4, 1.0)),
        motion=LinearGaussian(A, jnp.zeros((6, 1)), 0.01 * jnp.eye(6), Z),
        tau=jnp.array(0.5),
        prior_information=jnp.eye(6),
    )
    state = jax.random.normal(jax.random.key(1), (4, 2, 6)) + jnp.array([3.0, 0, 0, 0, 0, 0])
    episode = Episode(
        pose=problem.agent.space.identity(),
        mean=state[0],
        present=jnp.ones(2, bool),
        inputs=jnp.zeros((3, 2, 1)),
        horizon=jnp.array(3),
        truth=Truth(state, jnp.zeros((3, 2, 3))),
    )
    trace = rollout(problem, heuristic_policy("nearest", problem, 6.0), episode, TRUE, jax.random.key(0))
    trace = jax.tree.map(np.asarray, trace)
    made = episode_data(problem, trace, np.asarray(state), 3, 2, "a")
    np.testing.assert_allclose(made.truth, state[..., :3])
    np.testing.assert_allclose(made.covariance[2, 1], np.linalg.inv(trace.information[2, 1])[:3, :3])
    animation.animate(made, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (900, 500)


def test_gif_has_its_frames_and_colours(tmp_path):
    animation.animate(made_up(3, 2), tmp_path / "a.gif", size=(600, 400))
    colors = set()
    with Image.open(tmp_path / "a.gif") as picture:
        assert picture.size == (600, 400)
        assert picture.n_frames == 10
        for i in range(picture.n_frames):
            picture.seek(i)
            colors |= {color for _, color in picture.convert("RGB").getcolors(1 << 24)}
    for name in (drawing.SEEN, drawing.UNSEEN, drawing.AGENT):
        expected = np.array([int(name[i : i + 2], 16) for i in (1, 3, 5)])
        assert min(np.abs(np.array(color) - expected).max() for color in colors) < 8


def test_figures_of_space_beside_one_of_the_plane(tmp_path):
    figures.trajectory_figure([made_up(), random_episode()], tmp_path / "a.png")
    replay_figure({"one": made_up(), "two": made_up(seed=1)}, tmp_path / "b.png")
    for name in "ab":
        with Image.open(tmp_path / f"{name}.png") as picture:
            assert picture.width == 1350


def test_an_empty_scene_and_a_vague_belief(tmp_path):
    empty = made_up(2, 0)
    figures.trajectory_figure([empty], tmp_path / "a.png")
    replay_figure({"still": empty}, tmp_path / "b.png")
    animation.animate(empty, tmp_path / "c.png")
    vague = made_up(2, 2)
    animation.animate(dataclasses.replace(vague, covariance=1e6 * vague.covariance), tmp_path / "d.png")
    assert len(list(tmp_path.iterdir())) == 4


def test_wrong_endings_are_rejected(tmp_path):
    with pytest.raises(ValueError, match=r"ends in .gif, .mp4 or .png"):
        animation.animate(made_up(), tmp_path / "a.avi")
    with pytest.raises(ValueError, match=r"ends in .png, .pdf, .svg"):
        figures.trajectory_figure([made_up()], tmp_path / "a.bmp")


@pytest.mark.parametrize(("steps", "count"), [(24, 73), (33, 100), (40, 81), (99, 100), (300, 76)])
def test_frames_of_space_are_fewer(steps, count):
    assert len(animation.frame_moments(steps, SpatialScene.max_frames)) == count
