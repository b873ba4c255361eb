"""Pictures of detections without ids: tracks by their existence, the map of undetected targets, numbers over time."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.episode_data import random_episode
from helpers.worlds_of_detections import HALL

from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.io.figures import new_figure
from foveate.planning.named import heuristic_in
from foveate.plotting import animation
from foveate.plotting import scene as drawing
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, suite_data
from foveate.plotting.live.chart import facts
from foveate.plotting.live.scene import PIXELS, LiveScene
from foveate.plotting.replay_figure import replay_figure
from foveate.plotting.track_data import TrackData
from foveate.plotting.undetected import DARKEST, draw_counts
from foveate.scenario.scenes import Scene
from foveate.simulation.records import TRUE

STEPS = 4
EXISTENCE = np.array([0.9, 0.3, 0.0, 0.6, 0.05])
"""Two confirmed tracks, a tentative one, an empty slot, and one that no policy is told of."""


@pytest.fixture
def episode() -> EpisodeData:
    """Three targets, five slots of tracks, a map of 2 x 3 cells of which one alone expects targets, and more."""
    known = random_episode(STEPS, 5)
    cells = np.zeros((STEPS + 1, 2, 3))
    cells[:, 1, 0], cells[0, 0, 2] = 1.5, 3.0
    tracks = TrackData(
        existence=np.tile(EXISTENCE, (STEPS + 1, 1)),
        confirmed=np.tile(EXISTENCE > 0.5, (STEPS + 1, 1)),
        tell=0.1,
        gospa_m=2.345,
        box=np.array([[-6.0, -6.0], [6.0, 3.0]]),
        undetected=cells,
    )
    truth = {"truth": known.truth[:, :3], "visible": known.visible[:, :3], "present": known.present[:, :3]}
    beliefs = {"estimate": known.estimate, "covariance": known.covariance, "log_det": known.log_det}
    return random_episode(STEPS, 3, **truth, **beliefs, tracks=tracks)


def test_tracks_are_drawn_by_their_existence_over_the_map(episode):
    shown = drawing.PlanarScene(new_figure(3.0, 3.0).subplots(), episode, drawing.limits([episode]))
    shown.show(SUBSTEPS * STEPS)
    for areas, which in ((shown.seen, [0, 3]), (shown.unseen, [1])):
        middles = [path.vertices[:-1].mean(axis=0) for path in areas.get_paths()]
        np.testing.assert_allclose(middles, episode.estimate[-1, which], atol=0.05)
        np.testing.assert_allclose(areas.get_edgecolor()[:, 3], EXISTENCE[which])
    assert shown.map is not None
    picture = np.asarray(shown.map.image.get_array())
    assert picture.shape == (3, 2, 4), "rows are y, columns are x"
    np.testing.assert_allclose(picture[..., 3], DARKEST * np.array([[0, 0.5], [0, 0], [0, 0]]))
    assert list(shown.map.image.get_extent()) == [-6.0, 6.0, -6.0, 3.0]
    labels = [entry.get_label() for entry in drawing.legend_entries([episode])]
    assert {"track (95 %), confirmed", "not confirmed", "undetected"} <= set(labels)
    assert drawing.describe(episode) == "made up · up to 3 targets at once · GOSPA 2.35 m"
    assert episode.score is None


def test_numbers_of_targets_are_drawn_up_to_a_moment(episode):
    axes = new_figure(3.0, 3.0).subplots()
    lines, show = draw_counts(axes, episode)
    show(SUBSTEPS * 2)
    for line, number in zip(lines, (3, 2, EXISTENCE.sum() + 1.5), strict=True):
        np.testing.assert_allclose(line.get_ydata()[1:], number)
        assert len(line.get_xdata()) == 3
    assert animation.picture(episode, SUBSTEPS).shape == (500, 900, 3)


def test_a_figure_of_a_replay_compares_by_gospa(episode):
    figure = replay_figure({"a": episode, "b": episode})
    titles = [axes.get_title("left") for axes in figure.get_axes()]
    assert titles[-1] == "mean GOSPA [m], less is better"
    assert [text.get_text() for text in figure.get_axes()[-1].texts] == ["2.35", "2.35"]


@pytest.mark.slow
def test_the_map_is_that_of_the_filter_that_ran():
    """Its sum is the expected number of undetected targets that the simulation itself recorded."""
    problem, still = HALL.problem(), heuristic_in(HALL, "still")
    scene = Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((3.0, 1.0), (-2.0, 4.0)), horizon=12)
    suite = prepare(problem, HALL.scenes, [scene])
    (data,) = suite_data(suite, still, "true", "still")
    trace = evaluate_traces(suite, still, TRUE)
    assert data.tracks is not None
    assert data.tracks.undetected is not None
    np.testing.assert_allclose(data.tracks.undetected.sum(axis=(1, 2)), trace.undetected[0], rtol=1e-4)
    np.testing.assert_array_equal(data.present, np.asarray(suite.episodes.scans.alive)[0])


def test_the_live_view_shows_tracks_and_cells(episode):
    """In a scene that keeps what it is given: bodies of five slots and three targets, cells where the map has them."""
    kept = KeptScene()
    live = LiveScene(kept, episode)
    live.show(SUBSTEPS * STEPS)
    visible = [kept.nodes[f"/belief/{i}"].visible for i in range(5)]
    assert visible == [True, True, True, False, False]
    opacity = [kept.nodes[f"/belief/{i}"].opacity for i in range(3)]
    np.testing.assert_allclose(opacity, 0.35 * EXISTENCE[[0, 1, 3]])
    for i in range(3):
        np.testing.assert_allclose(kept.nodes[f"/target/{i}"].position[:2], episode.truth[-1, i])
    plan = kept.nodes["/undetected"]
    assert plan.image.shape == (3 * PIXELS, 2 * PIXELS, 3), "rows along y, which viser draws from the first on"
    np.testing.assert_array_equal(plan.position[:2], [0.0, -1.5])
    dark = plan.image[::PIXELS, ::PIXELS].sum(axis=-1) < 3 * 255
    np.testing.assert_array_equal(dark, [[False, True], [False, False], [False, False]])
    assert facts(episode, SUBSTEPS * STEPS)["confirmed tracks"] == "2"


class KeptScene:
    """A scene of viser without a server: every node keeps the numbers that it is given."""

    def __init__(self) -> None:
        self.nodes: dict[str, SimpleNamespace] = {}

    def __getattr__(self, name: str):
        def add(path: str = "", *arrays, **options) -> SimpleNamespace:
            node = SimpleNamespace(points=arrays[0] if arrays else None, colors=arrays[1] if len(arrays) > 1 else None)
            node.__dict__.update(options)
            return self.nodes.setdefault(path, node)

        return add
