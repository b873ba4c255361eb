"""The figure of changed worlds: what is drawn is what the verdicts say."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.points import DOUBLING, random_points
from PIL import Image

from foveate.plotting.scene import new_figure
from foveate.study import figures_robustness
from foveate.study.figures_robustness import robustness_figure
from foveate.study.robustness import verdicts


def test_lines_stand_at_the_means():
    axes, found = new_figure(3.0, 3.0).subplots(), verdicts(DOUBLING, random_points())
    styles = {"net": figures_robustness.STYLES[0], "omniscient": figures_robustness.DASHED}
    figures_robustness._panel(axes, DOUBLING, found, styles)
    drawn = {(line.get_color(), line.get_linestyle()): line for line in axes.lines}
    net = [one for one in found if one.method == "net"]
    color, _, line = styles["net"]
    expected = [(one.value, one.mean) for one in net]
    np.testing.assert_allclose(np.asarray(drawn[color, line].get_xydata(), float), expected)
    segments = axes.collections[0].get_segments()
    np.testing.assert_allclose([segment[:, 1] for segment in segments], [one.ci95 for one in net])
    assert axes.get_xlabel() == "f"


def test_the_figure_is_a_file_of_readme_width(tmp_path):
    factors = [replace(DOUBLING, name=name, values=values) for name, values in (("f", (1.0, 2.0)), ("g", (1.0, 2.0)))]
    found = {factor.name: verdicts(DOUBLING, random_points()) for factor in factors}
    robustness_figure(factors * 3, found, tmp_path / "robustness.png", "true score")
    with Image.open(tmp_path / "robustness.png") as picture:
        assert picture.width == 1350
    with pytest.raises(ValueError, match="no factor"):
        robustness_figure([], {}, tmp_path / "none.png", "true score")


def test_a_factor_of_one_value_is_drawn(tmp_path):
    alone = replace(DOUBLING, values=(1.0,))
    found = verdicts(alone, [point for point in random_points() if point.value == 1.0])
    robustness_figure([alone], {"f": found}, tmp_path / "one.png", "true score")
    assert (tmp_path / "one.png").stat().st_size > 1000
