"""Pictures of a comparison: steps are counted right, the front is the front, mean and band stand where they should."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from helpers.episode_data import random_episode
from matplotlib.lines import Line2D
from PIL import Image

from foveate.learning.loop import Validation
from foveate.plotting import scene as drawing
from foveate.study import figures as figures_comparison
from foveate.study.comparison import Overall
from foveate.study.figures import Curve, curve_of, duel_figure, learning_curves, pareto_figure, pareto_front

CHECK = Validation(
    epoch=50, objective=1.0, gradient_norm=2.0, held_out=3.0, at_limit=0.0, best=True, epochs_per_s=9.0, elapsed_s=8.0
)


def overall(method, seconds, mean, family="planned", protocol="true") -> Overall:
    return Overall(
        method=method,
        family=family,
        protocol=protocol,
        mean=mean,
        normalised_score=0.5,
        seen_fraction=0.5,
        step_time_s=seconds,
    )


def brute_force_front(points):
    """Names of those whom nobody beats: as fast and better, or faster and as good."""
    return {
        a.method
        for a in points
        if not any(
            b.step_time_s <= a.step_time_s and b.mean >= a.mean and (b.step_time_s, b.mean) != (a.step_time_s, a.mean)
            for b in points
        )
    }


def test_curve_of_a_run(tmp_path):
    checks = [replace(CHECK, env_steps=9900 * i, held_out=2.0 * i, elapsed_s=2.0 + i) for i in (1, 2, 3)]
    (tmp_path / "metrics.jsonl").write_text("".join(json.dumps(asdict(check)) + "\n" for check in checks))
    curve = curve_of(tmp_path)
    np.testing.assert_allclose(curve.steps, [9900, 19800, 29700])
    np.testing.assert_allclose(curve.seconds, [3, 4, 5])
    np.testing.assert_allclose(curve.score, [2, 4, 6])


def test_mean_and_band_over_seeds():
    def line(a, b):
        x = np.linspace(10.0, 100.0, 7)
        return Curve(steps=x, seconds=x, score=a + b * x)

    axes = drawing.new_figure(3.0, 3.0).subplots()
    figures_comparison._mean_curve(axes, [line(0.0, 1.0), line(2.0, 3.0), line(1.0, 5.0)], "steps", drawing.BLUE)
    x, y = axes.lines[0].get_data()
    np.testing.assert_allclose(y, 1.0 + 3.0 * np.asarray(x), rtol=1e-9)
    assert (x[0], x[-1]) == pytest.approx((10.0, 100.0))
    band = axes.collections[0].get_paths()[0].vertices
    assert band[:, 1].min() == pytest.approx(10.0)
    assert band[:, 1].max() == pytest.approx(501.0)


def test_the_front_is_what_nobody_beats():
    rng = np.random.default_rng(0)
    for _ in range(20):
        points = [overall(str(i), *values) for i, values in enumerate(rng.integers(1, 6, (8, 2)).astype(float))]
        found = {(one.step_time_s, one.mean) for one in pareto_front(points)}
        expected = brute_force_front(points)
        assert found == {(one.step_time_s, one.mean) for one in points if one.method in expected}


def test_labels_that_would_cover_each_other_are_moved_apart():
    points = [overall(str(i), 1e-3, value) for i, value in enumerate((1.0, 1.01, 1.0, 5.0))]
    heights = figures_comparison._apart([*points, overall("far", 1.0, 1.0)], 0.2)
    assert min(np.diff(sorted(heights[:4]))) > 0.2 - 1e-9
    assert heights[3:] == [5.0, 1.0]


def test_both_agents_are_drawn_in_their_own_colour():
    axes = drawing.new_figure(3.0, 3.0).subplots()
    films = (random_episode(seed=1), random_episode(seed=2))
    for one, tint in zip(films, figures_comparison.DUEL, strict=True):
        drawing.PlanarScene(axes, one, drawing.limits(films), tint=tint).show(12)
    paths = [line for line in axes.lines if isinstance(line, Line2D) and line.get_color() in figures_comparison.DUEL]
    assert {line.get_color() for line in paths} == set(figures_comparison.DUEL)
    assert drawing.SEEN not in {line.get_color() for line in axes.lines}


def test_figures_are_files_of_readme_width(tmp_path):
    x = np.array([1e4, 2e4, 3e4])
    curves = [Curve(steps=x, seconds=x / 1e3, score=np.array([1.0, 2.0, 3.0]))]
    one = [Curve(steps=x[:1], seconds=x[:1], score=np.array([1.0]))]
    learning_curves({"a": ("true", curves * 2), "b": ("surrogate", one)}, tmp_path / "learning.png")
    pareto_figure(
        [overall("a", 1e-3, 1.0), overall("b", 1e-2, 2.0, "someone's"), overall("o", 1.0, 3.0, "omniscient")],
        tmp_path / "pareto.png",
    )
    duel_figure(("a", "b"), [(random_episode(seed=1), random_episode(seed=2))], tmp_path / "duel.png")
    for path in tmp_path.iterdir():
        with Image.open(path) as picture:
            assert picture.width == 1350


def test_nothing_to_draw_is_rejected(tmp_path):
    with pytest.raises(ValueError, match="no learner"):
        learning_curves({}, tmp_path / "a.png")
    with pytest.raises(ValueError, match="no method"):
        pareto_figure([], tmp_path / "a.png")
    with pytest.raises(ValueError, match="no scene"):
        duel_figure(("a", "b"), [], tmp_path / "a.png")
