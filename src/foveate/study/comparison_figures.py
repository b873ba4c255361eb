"""Figures of several methods: learning curves by learner, and two methods in the same scenes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter

from foveate.errors import InputError
from foveate.experiment.run_folder import Validation
from foveate.io.figures import (
    BLACK,
    BLUE,
    CYCLE,
    DPI,
    GREY,
    LEGEND,
    PALE,
    TITLE,
    VERMILLION,
    WIDTH,
    new_figure,
    save,
    tidy,
)
from foveate.plotting.episode_data import EpisodeData
from foveate.plotting.figures import COLUMNS, draw_scene, row_heights
from foveate.plotting.scene import DASHED, limits

GRID = 200
"""Points along a mean curve."""

DUEL, DUEL_SCALES = (BLUE, VERMILLION), (1.5, 0.8)
"""Colours and symbol sizes of two methods in the same scene."""

Curves = tuple[str, Sequence[Sequence[Validation]]]
"""Protocol of the held-out score of a learner, and the validations of each of its trainings."""


def learning_curves(
    learners: Mapping[str, Curves], path: Path | str | None = None, *, width: float = WIDTH, dpi: int = DPI
) -> Figure:
    """Draw held-out score against environment steps: mean over seeds, in a band from worst to best.

    One panel for each protocol of the learners' scores. Wall time is no axis: it begins with a compilation that differs
    from seed to seed. Returns the figure, written to a path, if any. Raises InputError without learners.
    """
    if not learners:
        raise InputError("no learner to draw: expected at least one")
    protocols = list(dict.fromkeys(protocol for protocol, _ in learners.values()))
    figure = new_figure(width, 3.6, dpi)
    panels = figure.subplots(1, len(protocols), squeeze=False)[0]
    colors = dict(zip(learners, CYCLE * len(learners), strict=False))
    for axes, protocol in zip(panels, protocols, strict=True):
        for name, (own_protocol, runs) in learners.items():
            if own_protocol == protocol:
                _mean_curve(axes, runs, colors[name])
        log_axis(axes)
        tidy(axes, "environment steps", f"held-out {protocol} score\n[nat per target]")
    entries = [
        Line2D([], [], color=colors[name], lw=2, label=f"{name} ({len(runs)} seed{'s' * (len(runs) != 1)})")
        for name, (_, runs) in learners.items()
    ]
    figure.legend(handles=entries, ncols=4, fontsize=9, **LEGEND)
    return save(figure, path)


def _mean_curve(axes: Axes, runs: Sequence[Sequence[Validation]], color: str) -> None:
    """Draw the mean of all runs and a band from the lowest to the highest, over the range that they share."""
    across = [np.array([float(validation.env_steps) for validation in run]) for run in runs]
    scores = [np.array([validation.held_out for validation in run], float) for run in runs]
    first, last = max(x[0] for x in across), min(x[-1] for x in across)
    grid = np.geomspace(first, last, GRID) if last > first else np.array([first])
    values = np.array([np.interp(grid, x, score) for x, score in zip(across, scores, strict=True)])
    axes.fill_between(grid, values.min(axis=0), values.max(axis=0), color=color, alpha=0.18, lw=0)
    axes.plot(grid, values.mean(axis=0), color=color, lw=2, marker="o" if len(grid) == 1 else "")


def log_axis(axes: Axes, subs: Sequence[float] = (1.0, 2.0, 5.0), right: float = 1.6) -> None:
    """Make the x axis logarithmic, with plain numbers at `subs` times powers of ten and room on the `right`."""
    low, high = axes.dataLim.intervalx
    axes.set_xscale("log")
    axes.set_xlim(low / 1.6, high * right)
    axes.xaxis.set_major_locator(LogLocator(subs=tuple(subs)))
    axes.xaxis.set_major_formatter(EngFormatter(sep="") if high > 1e3 else FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def duel_figure(
    names: tuple[str, str],
    scenes: Sequence[tuple[EpisodeData, EpisodeData]],
    path: Path | str | None = None,
    *,
    width: float = WIDTH,
    dpi: int = DPI,
) -> Figure:
    """Draw two methods in the same scenes, a row each: the start, a third, two thirds and the end.

    Each method has one colour: path, view (triangle), and the 95 % ellipses of its beliefs, solid if it measures the
    target at that instant, else dashed; the first is drawn broader, so that it shows where both are the same. Targets
    are squares. Returns the figure, written to a path, if any. Raises InputError without scenes.
    """
    if not scenes:
        raise InputError("no scene to draw: expected at least one")
    heights = row_heights([1.0] * len(scenes), width, COLUMNS)
    figure = new_figure(width, sum(heights) + 0.33, dpi)
    rows = figure.subfigures(len(scenes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for row, pair in zip(rows, scenes, strict=True):
        first, box = pair[0], limits(pair)
        scores = ["" if data.score is None else f"{data.score:.2f}" for data in pair]
        results = "   ".join(f"{name} {score}" for name, score in zip(names, scores, strict=True))
        title = f"{first.targets} targets: {results}"
        row.suptitle(title, x=0.01, ha="left", **TITLE)
        for column in range(COLUMNS):
            instant = round(first.steps * column / (COLUMNS - 1))
            axes = row.add_subplot(1, COLUMNS, column + 1)
            for data, tint, scale in zip(pair, DUEL, DUEL_SCALES, strict=True):
                draw_scene(axes, data, instant, box, column == 0, row is rows[-1], tint=tint, scale=scale)
    entries = [
        *(Line2D([], [], color=color, lw=2, label=name) for name, color in zip(names, DUEL, strict=True)),
        Line2D([], [], color=GREY, marker="s", ms=4, mfc=BLACK, mec=BLACK, lw=0.9, label="target track"),
        Patch(facecolor=PALE, edgecolor=BLACK, lw=1.3, label="belief (95 %), detected"),
        Patch(facecolor="white", edgecolor=BLACK, ls=DASHED, label="belief (95 %), not detected"),
    ]
    figure.legend(handles=entries, ncols=5, fontsize=8.5, **LEGEND)
    return save(figure, path)
