"""Figures of a comparison: the front is the front, and what is drawn is what the verdicts say."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.points import DOUBLING, random_points
from PIL import Image

from foveate.io.figures import new_figure
from foveate.study import figures
from foveate.study.comparison import Overall
from foveate.study.figures import pareto_figure, pareto_front, robustness_figure
from foveate.study.robustness import verdicts


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
    """Names of the Pareto-optimal: none is as fast and better, or faster and as good."""
    return {
        a.method
        for a in points
        if not any(
            b.step_time_s <= a.step_time_s and b.mean >= a.mean and (b.step_time_s, b.mean) != (a.step_time_s, a.mean)
            for b in points
        )
    }


def test_the_front_is_the_undominated_methods():
    rng = np.random.default_rng(0)
    for _ in range(20):
        points = [overall(str(i), *values) for i, values in enumerate(rng.integers(1, 6, (8, 2)).astype(float))]
        found = {(one.step_time_s, one.mean) for one in pareto_front(points)}
        expected = brute_force_front(points)
        assert found == {(one.step_time_s, one.mean) for one in points if one.method in expected}


def test_the_pareto_figure_is_a_file_of_readme_width(tmp_path):
    pareto_figure(
        [overall("a", 1e-3, 1.0), overall("b", 1e-2, 2.0, "someone's"), overall("o", 1.0, 3.0, "omniscient")],
        tmp_path / "pareto.png",
    )
    with Image.open(tmp_path / "pareto.png") as picture:
        assert picture.width == 1350
    with pytest.raises(ValueError, match="no method"):
        pareto_figure([], tmp_path / "a.png")


def test_the_omniscient_planner_is_never_drawn_below_a_method(tmp_path):
    low, high = overall("o", 1.0, 1.5, "omniscient"), overall("o", 1.0, 3.0, "omniscient")
    methods = [overall("a", 1e-3, 1.0), overall("b", 1e-2, 2.0)]
    assert figures.shown_references([*methods, low]) == []
    assert figures.shown_references([*methods, high]) == [high]
    axes, found = new_figure(3.0, 3.0).subplots(), verdicts(DOUBLING, random_points())
    above = [replace(one, mean=1e3) if one.method == "net" and one.value == found[0].value else one for one in found]
    figures._panel(axes, DOUBLING, above, {"net": figures.STYLES[0], "omniscient": figures.DASHED})
    (dashed,) = [line for line in axes.lines if line.get_linestyle() == "--"]
    drawn = dict(np.asarray(dashed.get_xydata(), float).tolist())
    assert np.isnan(drawn[found[0].value])


def test_lines_stand_at_the_means():
    axes, found = new_figure(3.0, 3.0).subplots(), verdicts(DOUBLING, random_points())
    styles = {"net": figures.STYLES[0], "omniscient": figures.DASHED}
    figures._panel(axes, DOUBLING, found, styles)
    drawn = {(line.get_color(), line.get_linestyle()): line for line in axes.lines}
    net = [one for one in found if one.method == "net"]
    color, line = styles["net"]["color"], styles["net"]["linestyle"]
    expected = [(one.value, one.mean) for one in net]
    np.testing.assert_allclose(np.asarray(drawn[color, line].get_xydata(), float), expected)
    segments = axes.collections[0].get_segments()
    np.testing.assert_allclose([segment[:, 1] for segment in segments], [one.ci95 for one in net])
    assert axes.get_xlabel() == "f"


def test_the_robustness_figure_is_a_file_of_readme_width(tmp_path):
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
