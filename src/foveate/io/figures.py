"""The style of all figures, and their files.

Seen and unseen differ in line style too, and the colours are Okabe and Ito's, which colour-blind readers tell apart.
"""

import io
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator

from foveate.errors import InputError
from foveate.io.files import write_atomic

BLUE, SKY, GREEN, VERMILLION, ORANGE = "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00"
PURPLE, BLACK, GREY, PALE = "#CC79A7", "#000000", "#8C8C8C", "#E6E6E6"
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""Colours of runs and methods, in this order."""

WIDTH, DPI = 9.0, 150
"""Inches and dots per inch; at README width (about 900 pixels) a point is then 1.4 pixels."""

NARROW = 5.5
"""Below this width [inches], as in a column of a paper, a figure has half as many panels side by side."""

TITLE: dict[str, Any] = {"fontsize": 9, "fontweight": "bold"}
LEGEND: dict[str, Any] = {"loc": "outside lower center", "frameon": False}


def clean(axes: Axes, size: float = 8.0) -> None:
    """Give axes a thin grey frame and small tick labels."""
    axes.tick_params(labelsize=size, length=2.5, width=0.6, color=GREY, pad=2)
    for spine in axes.spines.values():
        spine.set(linewidth=0.6, color=GREY)


def over_time(axes: Axes, end_s: float, y: str) -> None:
    """Give the axes of an animation's chart a time axis until `end_s` [s], whole numbers upward, a grid and labels."""
    axes.set_xlim(0, 1.015 * end_s or 1.0)  # so that the last dots are whole
    axes.locator_params(axis="x", nbins=7, steps=[1, 2, 5, 10])
    axes.yaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10], integer=True))
    axes.grid(color=PALE, lw=0.6)
    axes.set_axisbelow(True)
    clean(axes, 9.0)
    axes.set_xlabel("time [s]", fontsize=9, labelpad=2)
    axes.set_ylabel(y, fontsize=9, labelpad=2)


def tidy(axes: Axes, x: str, y: str = "", size: float = 9.0) -> None:
    """Give axes a grid, a quiet frame, and labels."""
    axes.grid(color=PALE, lw=0.6)
    axes.set_axisbelow(True)
    clean(axes, size)
    axes.set_xlabel(x, fontsize=size + 0.5)
    if y:
        axes.set_ylabel(y, fontsize=size + 0.5)


def new_figure(width: float, height: float, dpi: int = DPI, layout: Any = "constrained") -> Figure:
    """Make a white figure [inches] on a canvas of its own, without pyplot's global state.

    Raises InputError for a width below 2 or above 40 inches, and dots per inch below 30 or above 2400.
    """
    for name, value, low, high in (("width", width, 2, 40), ("dpi", dpi, 30, 2400)):
        if not low <= value <= high:
            raise InputError(f"{name} {value:g}: expected from {low} to {high}")
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def own_axes(ax: Axes | None, width: float, height: float, dpi: int) -> tuple[Axes, Figure]:
    """Return the axes `ax` of a caller's figure, or new ones in a figure of their own, and that figure."""
    axes = new_figure(width, height, dpi).subplots() if ax is None else ax
    figure = axes.get_figure(root=True)
    assert figure is not None, "axes are in a figure"
    return axes, figure


def literal(figure: Figure) -> None:
    """Draw every text as it is: between two "$" in a name matplotlib would look for a formula, and fail.

    Only a logarithmic axis has powers in its own numbers.
    """
    axes = [axis for each in figure.axes for axis in (each.xaxis, each.yaxis) if axis.get_scale() == "log"]
    powers = {id(text) for axis in axes for text in axis.findobj(Text)} - {id(axis.label) for axis in axes}
    for text in figure.findobj(Text):
        if isinstance(text, Text) and id(text) not in powers:
            text.set_parse_math(False)
            text.set_text(drawable(text.get_text()))


def drawable(name: str) -> str:
    """A name that fonts can draw: that of a file may hold bytes that are no text."""
    return name.encode(errors="replace").decode()


def save(figure: Figure, path: Path | str | None) -> Figure:
    """Write a figure whole or not at all, in the format of the ending (.png, .pdf or .svg), if there is a path."""
    literal(figure)
    if path is None:
        return figure
    path, kinds = Path(path), (".png", ".pdf", ".svg")
    if path.suffix.lower() not in kinds:
        raise InputError(f"{path}: expected a name that ends in {', '.join(kinds)}")
    buffer = io.BytesIO()
    figure.savefig(buffer, format=path.suffix[1:].lower())
    write_atomic(path, buffer.getvalue())
    return figure
