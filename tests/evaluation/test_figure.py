"""Figure and flat records of an evaluation: marks stand at the means, intervals where they are given."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from foveate.errors import InputError
from foveate.evaluation.figure import draw_summary, flat
from foveate.evaluation.summary import Summary
from foveate.io.figures import new_figure

CELL = Summary(
    method="a", protocol="true", motion="biased", targets=3, mean=2.0, std=0.5, ci95=(1.5, 2.75), seen_fraction=1.0,
    seen_step_fraction=0.5, longest_unseen_s=3.0, rmse_m=0.1, rmse_seen_m=0.1, rmse_unseen_m=None, nees=2.0,
    nees_band=(1.0, 3.0), nees_seen=2.0, nees_seen_band=(1.0, 3.0), nees_unseen=None, nees_unseen_band=None, episodes=9,
)  # fmt: skip


def test_marks_and_intervals():
    summary = [CELL, replace(CELL, targets=5, mean=1.0, episodes=1), replace(CELL, method="b", mean=7.0)]
    axes: Any = draw_summary(summary)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["3 biased", "5 biased"]
    first, second = (container.lines[0].get_ydata() for container in axes.containers)
    np.testing.assert_allclose(first, [2.0, 1.0])
    np.testing.assert_allclose(second, [7.0])
    bars = axes.containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose(np.asarray(bars[0])[:, 1], [1.5, 2.75])
    assert not len(bars[1]) or np.isnan(bars[1]).any(), "a single scene has no interval"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a", "b"]


def test_draws_in_the_axes_of_a_caller():
    own = new_figure(3.0, 3.0).subplots()
    assert draw_summary([CELL, replace(CELL, protocol="surrogate")], own) is own
    assert [text.get_text() for text in own.get_legend().get_texts()] == ["a, true", "a, surrogate"]
    with pytest.raises(InputError, match="no cell to draw"):
        draw_summary([])


def test_records_are_flat():
    row = flat(CELL)
    assert (row["ci95_low"], row["ci95_high"], row["method"]) == (1.5, 2.75, "a")
    assert math.isnan(row["nees_unseen"])
    assert math.isnan(row["nees_unseen_band_low"])
    assert not any(isinstance(value, tuple | list) for value in row.values())
