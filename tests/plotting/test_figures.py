"""Pictures: what is drawn stands where an outside oracle says, files are what they claim to be."""

import dataclasses
import json
import os
import stat
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers.episode_data import TRIANGLE, random_episode
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.text import Text
from PIL import Image
from scipy.linalg import expm

from foveate.errors import InputError
from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.experiment.presets import PRESETS
from foveate.io.figures import new_figure, save
from foveate.plotting import animation, figures
from foveate.plotting import scene as drawing
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, episode_data
from foveate.plotting.replay_figure import _timeline, replay_figure
from foveate.plotting.snapshot import snapshot
from foveate.scenario.scenes import Scene
from foveate.simulation.records import TRUE


def scene(which: EpisodeData, moment: int, **options) -> drawing.PlanarScene:
    shown = drawing.PlanarScene(new_figure(3.0, 3.0).subplots(), which, drawing.limits([which]), **options)
    shown.show(moment)
    return shown


def corners(collection) -> np.ndarray:
    return np.array([path.vertices[:-1] for path in collection.get_paths()])


@pytest.fixture(scope="module")
def real():
    """Three scenes of the paper, padded to the largest, the last one empty, with an untrained policy.

    Problem, suite and traces.
    """
    experiment = PRESETS["paper"]
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    targets = ((3.0, 1.0), (-4.0, 2.0), (1.0, -5.0), (6.0, 6.0))
    scenes = [
        Scene(id=f"{n} targets", agent=(0.0, 1.0, 2.0), targets=targets[:n], drift=((0.1, 0.2),) * n, horizon=steps)
        for n, steps in ((2, 6), (4, 12), (0, 3))
    ]
    ready = prepare(problem, settings, scenes)
    policy = experiment.policy.policy(problem, jax.random.key(0))
    return problem, ready, evaluate_traces(ready, policy, TRUE)


# Episode data


def test_episode_data_cuts_padding_and_inverts_the_information(real):
    problem, ready, traces = real
    trace = jax.tree.map(lambda x: x[0], traces)
    truth = np.asarray(ready.episodes.truth.state[0])
    made = episode_data(problem, trace, truth, 6, 2, "a")
    assert (made.steps, made.targets) == (6, 2)
    assert made.pose.shape == (7, 3)
    np.testing.assert_array_equal(made.truth, truth[:7, :2])
    product = made.covariance @ np.asarray(trace.information)[:7, :2]
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), product.shape), atol=1e-9)
    assert made.score == pytest.approx(float(np.mean(np.asarray(trace.log_det)[5, :2])))
    np.testing.assert_allclose(made.times_s, np.arange(7.0))


def test_episode_data_of_a_longer_state_shows_positions(real):
    problem, _, traces = real
    Z = np.array([[0.0, 2.0]] * 2) * [[1], [0.5]] + np.eye(2)
    turned = dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, Z=jax.numpy.asarray(Z)))
    trace = jax.tree.map(lambda x: x[1], traces)
    made = episode_data(turned, trace, np.asarray(trace.mean), 12, 4, "b")
    np.testing.assert_allclose(made.truth[3, 1], Z @ trace.mean[3, 1], rtol=1e-12)
    inverse = np.linalg.inv(trace.information[5, 2])
    np.testing.assert_allclose(made.covariance[5, 2], Z @ inverse @ Z.T, rtol=1e-9)


def test_score_and_share_count_present_targets():
    present = np.array([[1, 1, 0], [1, 1, 1], [1, 0, 1]], bool)
    visible = np.array([[1, 0, 1], [0, 1, 1]], bool)
    log_det = np.array([[1.0, 2, 3], [4, 50, 6]])
    made = random_episode(2, 3, present=present, visible=visible, log_det=log_det)
    assert made.score == 5.0
    # Steps at both ends of which a target was there: 2 of the first, 1 of the second, 1 of the third.
    assert made.seen_share == 2 / 4
    assert random_episode(3, 0).score is None
    assert random_episode(3, 0).seen_share == 0


def test_times_that_do_not_fit_are_rejected():
    short = random_episode(3, 1)
    with pytest.raises(ValueError, match="times_s has 4 instants: expected 5"):
        dataclasses.replace(short, visible=np.zeros((4, 1), bool), log_det=np.zeros((4, 1)))


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.7, -1.0471975511965976, 3.1, -3.1, 5.0, -9.0])
def test_arc_is_the_exponential_of_a_constant_twist(turn):
    v, w, start = np.array([1.3, -0.4]), turn, np.array([2.0, -1.0, 6.9])

    def matrix(pose):
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        return np.array([[cos, -sin, pose[0]], [sin, cos, pose[1]], [0, 0, 1]])

    twist = np.array([[0, -w, v[0]], [w, 0, v[1]], [0, 0, 0]])
    end = matrix(start) @ expm(twist)
    poses = np.array([start, [end[0, 2], end[1, 2], start[2] + w]])
    arc = random_episode(1, 0, pose=poses).arc()
    assert arc.shape == (SUBSTEPS + 1, 3)
    for i, pose in enumerate(arc):
        np.testing.assert_allclose(matrix(pose), matrix(start) @ expm(twist * i / SUBSTEPS), atol=1e-12)


# The scene


def test_view_is_the_outline_moved_by_the_pose():
    which = random_episode(3, 2, seed=1)
    for instant in range(4):
        x, y, yaw = which.pose[instant]
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        drawn = scene(which, SUBSTEPS * instant).views[0].get_xy()
        np.testing.assert_allclose(drawn, [turn @ point + [x, y] for point in TRIANGLE], atol=1e-12)


def test_colour_follows_the_measurement_of_the_instant():
    which = random_episode(2, 3, visible=np.array([[1, 0, 0], [0, 1, 1]], bool))
    for instant, seen in ((0, []), (1, [0]), (2, [1, 2])):
        shown = scene(which, SUBSTEPS * instant)
        unseen = [j for j in range(3) if j not in seen]
        np.testing.assert_array_equal(shown.seen_means.get_xydata(), which.estimate[instant][seen])
        np.testing.assert_array_equal(shown.unseen_means.get_xydata(), which.estimate[instant][unseen])
        assert len(corners(shown.seen)) == len(seen)
        assert len(corners(shown.unseen)) == len(unseen)


def test_absent_targets_are_not_drawn():
    present = np.ones((4, 3), bool)
    present[:, 1] = False
    present[2:, 2] = False
    which = random_episode(3, 3, present=present)
    far = which.truth.copy()
    far[:, 1] = 1e6
    which = dataclasses.replace(which, truth=far, estimate=far)
    assert np.abs(drawing.limits([which])).max() < 100
    for instant, there in ((0, [0, 2]), (3, [0])):
        shown = scene(which, SUBSTEPS * instant)
        np.testing.assert_array_equal(shown.targets.get_xydata(), which.truth[instant][there])
        assert len(corners(shown.seen)) + len(corners(shown.unseen)) == len(there)
        track = shown.trails.get_xydata()
        assert np.nanmax(np.abs(track)) < 100
    kept = track[np.isfinite(track).all(axis=1)]
    # The first at four instants and now; the third at the two at which it was there.
    assert len(kept) == 5 + 2


def test_between_instants_targets_move_in_line_and_the_trail_is_bounded():
    which = random_episode(5, 2)
    shown = scene(which, 3 * SUBSTEPS + SUBSTEPS // 2, trail=1)
    np.testing.assert_allclose(shown.targets.get_xydata(), (which.truth[3] + which.truth[4]) / 2)
    track = shown.trails.get_xydata().reshape(2, -1, 2)
    np.testing.assert_allclose(track[0, :3], [which.truth[2, 0], which.truth[3, 0], shown.targets.get_xydata()[0]])
    np.testing.assert_allclose(shown.path.get_xydata()[0], which.pose[2, :2])


def test_limits_contain_all_but_vague_beliefs():
    which = random_episode(3, 2)
    vague = dataclasses.replace(which, covariance=1e6 * which.covariance)
    for made, most in ((which, 60.0), (vague, 60.0)):
        low, high = drawing.limits([made])
        points = np.concatenate([made.truth.reshape(-1, 2), made.pose[:, :2]])
        assert (points > low).all()
        assert (points < high).all()
        assert (high - low).max() < most
        np.testing.assert_allclose(*(high - low))


def test_limits_contain_the_first_beliefs():
    which = random_episode(3, 2)
    low, high = drawing.limits([which])
    for mean, covariance in zip(which.estimate[0], which.covariance[0], strict=True):
        reach = np.sqrt(5.991 * np.diagonal(covariance))  # 95 % quantile of chi-square with 2 degrees of freedom
        assert (mean - reach > low).all()
        assert (mean + reach < high).all()


def test_a_region_is_drawn_and_in_sight_unless_far_wider():
    for half, is_whole in ((12.0, True), (1e4, False)):
        region = np.array([[-half, -half], [half, half]])
        which = random_episode(3, 2, region=region)
        shown = scene(which, 0)
        assert any(np.array_equal(line.get_xydata()[[0, 2]], region) for line in shown.axes.lines)
        low, high = drawing.limits([which])
        assert ((low < region[0]).all() and (high > region[1]).all()) == is_whole
        assert [entry.get_label() for entry in drawing.legend_entries([which])][-1] == "region"


def test_names_of_targets_are_their_columns():
    present = np.ones((4, 3), bool)
    present[:, 1] = False
    which = random_episode(3, 3, present=present)
    np.testing.assert_array_equal(snapshot(which, which.arc(), 0).columns, [0, 2])


# Files


def test_trajectories_of_real_episodes(real, tmp_path):
    problem, ready, traces = real
    episodes = []
    for i, scene in enumerate(ready.scenes[:2]):
        trace = jax.tree.map(lambda x, i=i: x[i], traces)
        truth = np.asarray(ready.episodes.truth.state[i])
        episodes.append(episode_data(problem, trace, truth, scene.horizon, len(scene.targets), scene.id))
    figures.trajectory_figure(episodes, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 1350
    assert [file.name for file in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize("title", ["$\\frac{$", "a $x^$ b", "\ud800 $", "[/x] <b> :smile:"])
def test_names_are_drawn_as_they_are(tmp_path, title):
    """Between two "$" matplotlib would look for a formula: these are none."""
    made = random_episode(title=title)
    figures.trajectory_figure([made], tmp_path / "a.png")
    replay_figure({title: made}, tmp_path / "b.png")
    animation.animate(made, tmp_path / "c.gif", size=(400, 300))
    figure = new_figure(2.0, 2.0)
    figure.subplots().set(xscale="log", xlim=(1, 100), title=title)
    save(figure, tmp_path / "d.svg")
    shown = {text.get_text() for text in figure.findobj(Text)}
    assert title.replace("\ud800", "?") in shown
    assert "$\\mathdefault{10^{1}}$" in shown  # which is drawn as a power


def test_a_scene_without_targets(real, tmp_path):
    problem, ready, traces = real
    trace = jax.tree.map(lambda x: x[2], traces)
    made = episode_data(problem, trace, np.asarray(ready.episodes.truth.state[2]), 3, 0, "empty")
    figures.trajectory_figure([made], tmp_path / "a.png")
    replay_figure({"still": made}, tmp_path / "b.png")
    animation.animate(made, tmp_path / "c.gif")
    assert drawing.describe(made) == "empty · no targets"


@pytest.mark.parametrize(("steps", "count"), [(0, 1), (1, 4), (4, 13), (49, 148), (74, 149), (149, 150), (300, 101)])
def test_frames_are_few_evenly_spaced_and_end_at_the_end(steps, count):
    moments = animation.frame_moments(steps, 150)
    assert len(moments) == count
    assert moments[0] == 0
    assert moments[-1] == SUBSTEPS * steps
    assert len(set(np.diff(moments[:-1]))) <= 1


def test_gif_has_its_frames_loops_and_keeps_its_colours(tmp_path):
    which = random_episode(4, 3)
    animation.animate(which, tmp_path / "a.gif", fps=8)
    with Image.open(tmp_path / "a.gif") as picture:
        assert picture.size == (900, 500)
        assert picture.n_frames == 13
        assert picture.info["loop"] == 0
        durations, colors = [], set()
        for i in range(picture.n_frames):
            picture.seek(i)
            durations.append(picture.info["duration"])
            colors |= {color for _, color in picture.convert("RGB").getcolors(1 << 24)}
    # GIF counts in hundredths of a second.
    assert durations == [120] * 12 + [1500]
    assert (255, 255, 255) in colors
    for name in (drawing.SEEN, drawing.UNSEEN, drawing.AGENT):
        wanted = np.array([int(name[i : i + 2], 16) for i in (1, 3, 5)])
        assert min(np.abs(np.array(color) - wanted).max() for color in colors) < 8


def test_last_moment_as_png(tmp_path):
    animation.animate(random_episode(), tmp_path / "a.png", size=(600, 400))
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (600, 400)


def test_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ValueError, match="ffmpeg is missing"):
        animation.animate(random_episode(), tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in for ffmpeg is a script")
def test_mp4_pipes_every_frame(tmp_path, monkeypatch):
    tool = tmp_path / "ffmpeg"
    tool.write_text(f'#!{sys.executable}\nimport sys\nopen(sys.argv[-1], "wb").write(sys.stdin.buffer.read())\n')
    tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(tmp_path) + os.pathsep + os.environ["PATH"])
    animation.animate(random_episode(2, 1), tmp_path / "a.mp4", fps=4, size=(400, 300))
    assert (tmp_path / "a.mp4").stat().st_size == (7 + 6) * 400 * 300 * 3
    tool.write_text(f'#!{sys.executable}\nimport sys\nsys.stdin.buffer.read()\nsys.exit("no such codec")\n')
    with pytest.raises(ValueError, match="ffmpeg failed: no such codec"):
        animation.animate(random_episode(2, 1), tmp_path / "b.mp4", size=(400, 300))


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.avi", {}, r"ends in .gif, .mp4 or .png"),
        ("a.gif", {"size": (301, 300)}, "two even numbers"),
        ("a.gif", {"fps": 0}, "fps = 0: expected from 1 to 50"),
    ],
)
def test_animate_rejects_unsupported_output(tmp_path, name, options, message):
    with pytest.raises(ValueError, match=message):
        animation.animate(random_episode(), tmp_path / name, **options)


def test_empty_input_and_wrong_file_endings_are_rejected(tmp_path):
    with pytest.raises(ValueError, match="no episode to draw"):
        figures.trajectory_figure([], tmp_path / "a.png")
    with pytest.raises(ValueError, match="no episode to draw"):
        replay_figure({}, tmp_path / "a.png")
    with pytest.raises(ValueError, match="no run to draw"):
        figures.learning_curve([], tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"ends in .png, .pdf, .svg"):
        figures.trajectory_figure([random_episode()], tmp_path / "a.bmp")


def test_replay_timeline_and_shares(tmp_path):
    present = np.array([[1, 1, 1, 0, 1], [0, 1, 1, 1, 1]], bool).T
    visible = np.array([[0, 1, 0, 1], [0, 1, 0, 1]], bool).T
    made = random_episode(4, 2, present=present, visible=visible)
    axes = new_figure(3.0, 3.0).subplots()
    _timeline(axes, made, "x")

    def spans(collection):
        return [tuple(path.vertices[:, 0][[0, 2]]) for path in collection.get_paths()]

    there, seen, there_too, seen_too = axes.collections
    assert isinstance(there, type(seen))
    assert not isinstance(there, LineCollection)
    assert sorted(map(sorted, spans(there))) == [[0.0, 1.0]]
    assert sorted(map(sorted, spans(seen))) == [[0.5, 1.0]]
    assert sorted(map(sorted, spans(there_too))) == [[0.5, 2.0]]
    assert sorted(map(sorted, spans(seen_too))) == [[0.5, 1.0], [1.5, 2.0]]
    replay_figure({"one": made, "two": random_episode(4, 2)}, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 1350


# Learning curves


def write_run(folder: Path, events=("", "", "")) -> Path:
    folder.mkdir()
    rows = [
        {"epoch": 10 * (i + 1), "objective": 1.0 * i, "gradient_norm": 1.0, "held_out": 2.0 * i, "at_limit": 0.0,
         "best": i == 1, "epochs_per_s": 9.0, "elapsed_s": 3.0 + i, "event": event}
        for i, event in enumerate(events)
    ]  # fmt: skip
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def test_learning_curves_of_one_run_and_of_several(tmp_path):
    runs = [write_run(tmp_path / "a"), write_run(tmp_path / "b", ("", "", "collapse"))]
    figures.learning_curve(runs[0], tmp_path / "one.png")
    figures.learning_curve([runs[0], runs[1] / "metrics.jsonl"], tmp_path / "two.svg")
    assert "<svg" in (tmp_path / "two.svg").read_text()
    checks = figures.read_validations(runs[1] / "metrics.jsonl")
    assert [(check.epoch, check.best, check.event) for check in checks] == [
        (10, False, ""),
        (20, True, ""),
        (30, False, "collapse"),
    ]


def test_a_cut_line_is_passed_over_a_broken_one_is_not(tmp_path):
    file = write_run(tmp_path / "a") / "metrics.jsonl"
    whole = file.read_text()
    file.write_text(whole[:-20])
    assert len(figures.read_validations(file)) == 2
    file.write_text("{}\n" + whole)
    with pytest.raises(ValueError, match="line 1: not a validation"):
        figures.read_validations(file)
    file.write_text("")
    with pytest.raises(ValueError, match="no validation in it yet"):
        figures.read_validations(file)


def test_the_clock_and_the_timeline_follow_steps_of_any_length():
    """A quarter of a second, then three: half way through the second step it is 1.75 s."""
    data = random_episode(2, 1, times_s=np.array([0.0, 0.25, 3.25]), visible=np.array([[False], [True]]))
    figure = new_figure(9.0, 5.0, layout=None)
    artists, show = animation._scene(figure, data, (900, 500))
    show(SUBSTEPS + SUBSTEPS // 2)
    assert any("t = 1.8 s" in text.get_text() for text in artists if isinstance(text, Text))
    axes = new_figure(4.0, 3.0).subplots()
    _timeline(axes, data, "policy")
    spans = [path.get_extents() for collection in axes.collections for path in collection.get_paths()]
    assert (0.25, 3.25) in [(round(box.x0, 6), round(box.x1, 6)) for box in spans]


# Layout


def extent(text):
    return text.get_window_extent()


@pytest.mark.parametrize("episodes", [1, 3])
def test_titles_do_not_cover_each_other(episodes):
    figure = figures.trajectory_figure([random_episode(seed=seed) for seed in range(episodes)])
    figure.draw_without_rendering()
    for row in figure.subfigs:
        times = [axes.title for axes in row.axes]
        assert len(times) == figures.COLUMNS
        assert all(extent(row._suptitle).y0 >= extent(time).y1 for time in times)
        assert all(one is other or not extent(one).overlaps(extent(other)) for one in times for other in times)


def test_a_figure_for_a_column_has_half_of_the_panels(tmp_path):
    figure = figures.trajectory_figure([random_episode()], tmp_path / "a.png", width=3.5, dpi=300)
    assert len(figure.axes) == figures.COLUMNS // 2
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 1050
    for options, complaint in (({"width": 0.1}, "width 0.1"), ({"dpi": 10**6}, "dpi 1e")):
        with pytest.raises(InputError, match=complaint):
            figures.trajectory_figure([random_episode()], **options)


def test_labels_of_a_frame_are_whole_and_apart():
    """Also where ticks have decimals: a scene of a metre, far from the origin."""
    made = random_episode()
    small = {name: 0.1 * getattr(made, name) - 20.0 for name in ("truth", "estimate", "pose")}
    for data in (made, dataclasses.replace(made, **small, log_det=0.001 * made.log_det - 123.0)):
        figure = new_figure(9.0, 5.0, dpi=100, layout=None)
        animation._scene(figure, data, (900, 500))
        ground, curves = (axes.get_tightbbox() for axes in figure.axes)
        assert ground.x0 >= 0
        assert ground.x1 <= curves.x0
        assert curves.x1 <= 900


def test_a_belief_as_wide_as_the_scene_has_no_fill():
    made = random_episode(3, 2, visible=np.zeros((3, 2), bool))
    wide = made.covariance * np.array([1.0, 1e4])[:, None, None]
    shown = scene(dataclasses.replace(made, covariance=wide), 2 * SUBSTEPS)
    assert [face[3] > 0 for face in shown.unseen.get_facecolor()] == [True, False]
    assert (shown.unseen.get_edgecolor()[:, 3] == 1).all()


def test_a_learning_curve_in_axes_of_a_caller(tmp_path):
    rows = [{"epoch": k, "objective": 1.0, "gradient_norm": 1.0, "held_out": 1.0 * k, "at_limit": 0.0, "best": True,
             "epochs_per_s": 1.0, "elapsed_s": 1.0} for k in (1, 2)]  # fmt: skip
    (tmp_path / "metrics.jsonl").write_text("\n".join(map(json.dumps, rows)), encoding="utf-8")
    axes = new_figure(3.0, 3.0).subplots()
    axes.set_title("$x^2$")
    assert figures.learning_curve(tmp_path, ax=axes) is axes.get_figure()
    assert axes.title.get_parse_math(), "the caller's texts stay as they are"
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), [1.0, 2.0])


@pytest.mark.parametrize(("entries", "rows"), [(4, 1), (9, 2)])
def test_a_legend_wider_than_its_figure_has_more_rows(entries, rows):
    figure = new_figure(9.0, 3.0)
    lines = [Line2D([], [], label="track (95 %), heard") for _ in range(entries)]
    figures.legend_within(figure, lines, 1)
    (legend,) = figure.legends
    assert legend.get_window_extent().width <= figure.bbox.width
    assert figure.get_figheight() == pytest.approx(3.0 + 0.18 * (rows - 1))
