"""Figures of several methods: mean and band stand where they should, both agents have their colours."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.episode_data import random_episode
from matplotlib.lines import Line2D
from PIL import Image

from foveate.experiment.run_folder import Validation
from foveate.io.figures import BLUE, new_figure
from foveate.plotting import scene as drawing
from foveate.study import comparison_figures as figures
from foveate.study.comparison_figures import duel_figure, learning_curves

CHECK = Validation(
    epoch=50, objective=1.0, gradient_norm=2.0, held_out=3.0, at_limit=0.0, best=True, epochs_per_s=9.0, elapsed_s=8.0
)


def test_mean_and_band_over_seeds():
    def line(a, b):
        return [replace(CHECK, env_steps=int(x), held_out=a + b * x) for x in np.linspace(10, 100, 10)]

    axes = new_figure(3.0, 3.0).subplots()
    figures._mean_curve(axes, [line(0.0, 1.0), line(2.0, 3.0), line(1.0, 5.0)], BLUE)
    x, y = axes.lines[0].get_data()
    np.testing.assert_allclose(y, 1.0 + 3.0 * np.asarray(x), rtol=1e-9)
    assert (x[0], x[-1]) == pytest.approx((10.0, 100.0))
    band = axes.collections[0].get_paths()[0].vertices
    assert band[:, 1].min() == pytest.approx(10.0)
    assert band[:, 1].max() == pytest.approx(501.0)


def test_both_agents_are_drawn_in_their_own_colour():
    axes = new_figure(3.0, 3.0).subplots()
    episodes = (random_episode(seed=1), random_episode(seed=2))
    for one, tint in zip(episodes, figures.DUEL, strict=True):
        drawing.PlanarScene(axes, one, drawing.limits(episodes), tint=tint).show(12)
    paths = [line for line in axes.lines if isinstance(line, Line2D) and line.get_color() in figures.DUEL]
    assert {line.get_color() for line in paths} == set(figures.DUEL)
    assert drawing.SEEN not in {line.get_color() for line in axes.lines}


def test_figures_are_files_of_readme_width(tmp_path):
    run = [replace(CHECK, env_steps=9900 * i, held_out=2.0 * i, elapsed_s=2.0 + i) for i in (1, 2, 3)]
    learning_curves({"a": ("true", [run, run]), "b": ("surrogate", [run[:1]])}, tmp_path / "learning.png")
    duel_figure(("a", "b"), [(random_episode(seed=1), random_episode(seed=2))], tmp_path / "duel.png")
    for path in tmp_path.iterdir():
        with Image.open(path) as picture:
            assert picture.width == 1350


def test_empty_input_is_rejected(tmp_path):
    with pytest.raises(ValueError, match="no learner"):
        learning_curves({}, tmp_path / "a.png")
    with pytest.raises(ValueError, match="no scene"):
        duel_figure(("a", "b"), [], tmp_path / "a.png")
