"""Figures of several methods: learning curves by learner, and two methods in the same scenes."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter

from foveate.errors import InputError
from foveate.experiment.run_folder import Validation
from foveate.plotting import scene
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.figures import COLUMNS, WIDTH

GRID = 200
"""Points along a mean curve."""

DUEL = (scene.BLUE, scene.VERMILLION)
"""Colours of two methods in the same scene."""

Curves = tuple[str, Sequence[Sequence[Validation]]]
"""Protocol of the held-out score of a learner, and the validations of each of its trainings."""

LEARNING_AXES: dict[str, Callable[[Validation], float]] = {
    "environment steps": lambda validation: float(validation.env_steps),
    "wall time [s]": lambda validation: validation.elapsed_s,
}


def learning_curves(learners: Mapping[str, Curves], path: Path) -> None:
    """Draw held-out score against environment steps and wall time: mean over seeds, in a band from worst to best.

    One row of panels for each protocol of the learners' scores. Raises InputError without learners.
    """
    if not learners:
        raise InputError("no learner to draw: expected at least one")
    protocols = list(dict.fromkeys(protocol for protocol, _ in learners.values()))
    figure = scene.new_figure(WIDTH, 0.5 + 3.1 * len(protocols))
    panels = figure.subplots(len(protocols), 2, squeeze=False, sharey="row")
    colors = dict(zip(learners, scene.CYCLE * len(learners), strict=False))
    for row, protocol in zip(panels, protocols, strict=True):
        for axes, (label, x_of) in zip(row, LEARNING_AXES.items(), strict=True):
            for name, (own_protocol, runs) in learners.items():
                if own_protocol == protocol:
                    _mean_curve(axes, runs, x_of, colors[name])
            log_axis(axes)
            tidy(axes, label)
        row[0].set_ylabel(f"held-out {protocol} score\n[nat per target]", fontsize=9.5)
    entries = [
        Line2D([], [], color=colors[name], lw=2, label=f"{name} ({len(runs)} seed{'s' * (len(runs) != 1)})")
        for name, (_, runs) in learners.items()
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    scene.save(figure, path)


def _mean_curve(
    axes: Axes, runs: Sequence[Sequence[Validation]], x_of: Callable[[Validation], float], color: str
) -> None:
    """Draw the mean of all runs and a band from the lowest to the highest, over the range that they share."""
    across = [np.array([x_of(validation) for validation in run]) for run in runs]
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


def tidy(axes: Axes, label: str) -> None:
    """Set the grid, a quiet frame, and the label of the x axis."""
    axes.grid(color=scene.PALE, lw=0.6)
    scene.clean(axes, 9.0)
    axes.set_xlabel(label, fontsize=9.5)


def duel_figure(names: tuple[str, str], scenes: Sequence[tuple[EpisodeData, EpisodeData]], path: Path) -> None:
    """Draw two methods in the same scenes, a row each: the start, a third, two thirds and the end.

    Each method has one colour: path, view (triangle), and the 95 % ellipses of its beliefs, solid if it measures the
    target at that instant, else dashed. Targets are squares. Raises InputError without scenes.
    """
    if not scenes:
        raise InputError("no scene to draw: expected at least one")
    figure = scene.new_figure(WIDTH, (WIDTH / COLUMNS + 0.45) * len(scenes) + 0.35)
    rows = figure.subfigures(len(scenes), 1, squeeze=False)[:, 0]
    for row, pair in zip(rows, scenes, strict=True):
        first, box = pair[0], scene.limits(pair)
        scores = ["" if data.score is None else f"{data.score:.2f}" for data in pair]
        results = "   ".join(f"{name} {score}" for name, score in zip(names, scores, strict=True))
        title = f"{first.targets} targets: {results}"
        row.suptitle(title, x=0.01, y=0.99, va="top", ha="left", fontsize=9, fontweight="bold")
        for column in range(COLUMNS):
            instant = round(first.steps * column / (COLUMNS - 1))
            axes = row.add_subplot(1, COLUMNS, column + 1)
            drawn = [scene.PlanarScene(axes, data, box, tint=tint) for data, tint in zip(pair, DUEL, strict=True)]
            for each in drawn:
                each.show(SUBSTEPS * instant)
            drawn[0].label(8.0, x=row is rows[-1], y=column == 0)
            axes.set_title(f"t = {first.times_s[instant]:g} s", fontsize=8.5, pad=3)
    black, grey = scene.BLACK, scene.GREY
    entries = [
        *(Line2D([], [], color=color, lw=2, label=name) for name, color in zip(names, DUEL, strict=True)),
        Line2D([], [], color=grey, marker="s", ms=4, mfc=black, mec=black, lw=0.9, label="target, its track"),
        Patch(facecolor=scene.PALE, edgecolor=black, lw=1.3, label="belief (95 %), seen now"),
        Patch(facecolor="white", edgecolor=black, ls=(0, (3, 2)), label="not seen now"),
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=5, fontsize=8.5, frameon=False)
    scene.save(figure, path)
