"""Figures of a comparison: learning curves, two methods in the same scenes, score against time."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter

from foveate.errors import InputError
from foveate.evaluation.statistics import group_by
from foveate.experiment.run_folder import Validation
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.figures import COLUMNS, WIDTH
from foveate.plotting.scene import (
    BLACK,
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    PALE,
    PURPLE,
    VERMILLION,
    PlanarScene,
    clean,
    limits,
    new_figure,
    save,
)
from foveate.study.comparison import Overall

HALO = withStroke(linewidth=2.5, foreground="white")
"""Keeps a label legible that a line runs through."""

PANEL_POINTS = 260.0
"""Height of a panel of the Pareto figure, nearly."""

GRID = 200
"""Points along a mean curve."""

DUEL = (BLUE, VERMILLION)

STYLES = {
    "trained": (BLUE, "o"),
    "trained, refined": (PURPLE, "D"),
    "planned": (GREEN, "s"),
    "made by hand": (VERMILLION, "^"),
}
"""Colour and marker of a family of methods; another one is black."""

Curves = tuple[str, Sequence[Sequence[Validation]]]
"""Protocol of the held-out score of a learner, and the validations of each of its trainings."""

LEARNING_AXES: dict[str, Callable[[Validation], float]] = {
    "environment steps": lambda validation: float(validation.env_steps),
    "wall time [s]": lambda validation: validation.elapsed_s,
}


def learning_curves(learners: Mapping[str, Curves], path: Path) -> None:
    """Held-out score against environment steps and against time; the mean over seeds, in a band from worst to best.

    Learners, by name, whose scores are of different protocols have panels one below the other. Raises ValueError for
    none.
    """
    if not learners:
        raise InputError("no learner to draw: expected at least one")
    protocols = list(dict.fromkeys(protocol for protocol, _ in learners.values()))
    figure = new_figure(WIDTH, 0.5 + 3.1 * len(protocols))
    panels = figure.subplots(len(protocols), 2, squeeze=False, sharey="row")
    colors = dict(zip(learners, CYCLE * len(learners), strict=False))
    for row, protocol in zip(panels, protocols, strict=True):
        for axes, (label, x_of) in zip(row, LEARNING_AXES.items(), strict=True):
            for name, (of_learner, runs) in learners.items():
                if of_learner == protocol:
                    _mean_curve(axes, runs, x_of, colors[name])
            _log_axis(axes)
            _tidy(axes, label)
        row[0].set_ylabel(f"held-out {protocol} score\n[nat per target]", fontsize=9.5)
    entries = [
        Line2D([], [], color=colors[name], lw=2, label=f"{name} ({len(runs)} seed{'s' * (len(runs) != 1)})")
        for name, (_, runs) in learners.items()
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    save(figure, path)


def _mean_curve(
    axes: Axes, runs: Sequence[Sequence[Validation]], x_of: Callable[[Validation], float], color: str
) -> None:
    """Where all runs have a value: their mean, and a band from the lowest to the highest."""
    across = [np.array([x_of(validation) for validation in run]) for run in runs]
    scores = [np.array([validation.held_out for validation in run], float) for run in runs]
    first, last = max(x[0] for x in across), min(x[-1] for x in across)
    grid = np.geomspace(first, last, GRID) if last > first else np.array([first])
    values = np.array([np.interp(grid, x, score) for x, score in zip(across, scores, strict=True)])
    axes.fill_between(grid, values.min(axis=0), values.max(axis=0), color=color, alpha=0.18, lw=0)
    axes.plot(grid, values.mean(axis=0), color=color, lw=2, marker="o" if len(grid) == 1 else "")


def _log_axis(axes: Axes, subs: Sequence[float] = (1.0, 2.0, 5.0), right: float = 1.6) -> None:
    """A logarithmic x axis with plain numbers, wide enough that there are some."""
    low, high = axes.dataLim.intervalx
    axes.set_xscale("log")
    axes.set_xlim(low / 1.6, high * right)
    axes.xaxis.set_major_locator(LogLocator(subs=tuple(subs)))
    axes.xaxis.set_major_formatter(EngFormatter(sep="") if high > 1e3 else FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _tidy(axes: Axes, label: str) -> None:
    axes.grid(color=PALE, lw=0.6)
    clean(axes, 9.0)
    axes.set_xlabel(label, fontsize=9.5)


def duel_figure(names: tuple[str, str], scenes: Sequence[tuple[EpisodeData, EpisodeData]], path: Path) -> None:
    """Two methods in the same scenes, a row each: the start, a third, two thirds and the end.

    Each method has one colour: path, view (triangle), and the 95 % ellipses about its believed means, solid where it
    measures at that instant, dashed where not. Targets are squares. Raises ValueError for no scene.
    """
    if not scenes:
        raise InputError("no scene to draw: expected at least one")
    figure = new_figure(WIDTH, (WIDTH / COLUMNS + 0.45) * len(scenes) + 0.35)
    rows = figure.subfigures(len(scenes), 1, squeeze=False)[:, 0]
    for row, pair in zip(rows, scenes, strict=True):
        first, box = pair[0], limits(pair)
        scores = ["" if data.score is None else f"{data.score:.2f}" for data in pair]
        results = "   ".join(f"{name} {score}" for name, score in zip(names, scores, strict=True))
        title = f"{first.targets} targets: {results}"
        row.suptitle(title, x=0.01, y=0.99, va="top", ha="left", fontsize=9, fontweight="bold")
        for column in range(COLUMNS):
            instant = round(first.steps * column / (COLUMNS - 1))
            axes = row.add_subplot(1, COLUMNS, column + 1)
            drawn = [PlanarScene(axes, data, box, tint=tint) for data, tint in zip(pair, DUEL, strict=True)]
            for each in drawn:
                each.show(SUBSTEPS * instant)
            drawn[0].label(8.0, x=row is rows[-1], y=column == 0)
            axes.set_title(f"t = {first.times_s[instant]:g} s", fontsize=8.5, pad=3)
    entries = [
        *(Line2D([], [], color=color, lw=2, label=name) for name, color in zip(names, DUEL, strict=True)),
        Line2D([], [], color=GREY, marker="s", ms=4, mfc=BLACK, mec=BLACK, lw=0.9, label="target, its track"),
        Patch(facecolor=PALE, edgecolor=BLACK, lw=1.3, label="belief (95 %), seen now"),
        Patch(facecolor="white", edgecolor=BLACK, ls=(0, (3, 2)), label="not seen now"),
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=5, fontsize=8.5, frameon=False)
    save(figure, path)


def pareto_figure(overall: Sequence[Overall], path: Path) -> None:
    """Score against the time of a decision, a panel a protocol; a line along those that nobody beats in both.

    The omniscient planner, which decides with what nobody can know, is a dashed line. Raises ValueError for no method.
    """
    if not overall:
        raise InputError("no method to draw: expected at least one")
    protocols = group_by(overall, lambda one: one.protocol)
    figure = new_figure(WIDTH, 4.6)
    panels = figure.subplots(1, len(protocols), squeeze=False, sharey=True)[0]
    for axes, (protocol, methods) in zip(panels, protocols.items(), strict=True):
        _pareto_panel(axes, [method for method in methods if method.family != "omniscient"])
        for oracle in (method for method in methods if method.family == "omniscient"):
            axes.axhline(oracle.mean, color=BLACK, ls="--", lw=1)
            axes.annotate(
                f"omniscient {oracle.mean:.2f}", (0.01, oracle.mean), (0, 3), xycoords=axes.get_yaxis_transform(),
                textcoords="offset points", fontsize=8.5,
            )  # fmt: skip
        axes.set_title(f"{protocol} score", fontsize=10, fontweight="bold", loc="left")
    panels[0].set_ylabel("score [nat per target], mean over cells", fontsize=9.5)
    entries = []
    for family in dict.fromkeys(one.family for one in overall if one.family != "omniscient"):
        color, marker = STYLES.get(family, (BLACK, "o"))
        entries.append(Line2D([], [], color=color, ls="none", marker=marker, ms=6, label=family))
    entries.append(Line2D([], [], color=GREY, lw=1.2, label="nobody faster scores more"))
    figure.legend(handles=entries, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    save(figure, path)


def pareto_front(overall: Sequence[Overall]) -> list[Overall]:
    """Methods that score more than all that decide as fast or faster, fastest first."""
    front: list[Overall] = []
    for one in sorted(overall, key=lambda one: (one.step_time_s, -one.mean)):
        if not front or one.mean > front[-1].mean:
            front.append(one)
    return front


def _pareto_panel(axes: Axes, overall: Sequence[Overall]) -> None:
    front = pareto_front(overall)
    axes.step([1e3 * one.step_time_s for one in front], [one.mean for one in front], where="post", color=GREY, lw=1.2)
    for one in overall:
        color, marker = STYLES.get(one.family, (BLACK, "o"))
        axes.plot(1e3 * one.step_time_s, one.mean, color=color, marker=marker, ms=6, mec="white", mew=0.6, zorder=5)
    _tidy(axes, "time of a decision [ms]")
    axes.margins(y=0.08)
    low, high = axes.get_ylim()
    _log_axis(axes, (1.0,), right=4.0)
    for one, height in zip(overall, _spread_labels(overall, 0.036 * (high - low)), strict=True):
        label = axes.annotate(
            one.method, (1e3 * one.step_time_s, one.mean), (6, (height - one.mean) / (high - low) * PANEL_POINTS),
            textcoords="offset points", fontsize=8, va="center", zorder=4, path_effects=[HALO],
        )  # fmt: skip
        label.set_in_layout(False)


def _spread_labels(overall: Sequence[Overall], least: float) -> list[float]:
    """Heights of labels beside their points: where points are near in time, pushed up until none covers another."""
    order = sorted(range(len(overall)), key=lambda i: overall[i].mean)
    heights = [one.mean for one in overall]
    for rank, i in enumerate(order):
        for j in order[:rank]:
            near = abs(math.log(overall[i].step_time_s / overall[j].step_time_s)) < math.log(4.0)
            if near and heights[i] - heights[j] < least:
                heights[i] = heights[j] + least
    return heights
