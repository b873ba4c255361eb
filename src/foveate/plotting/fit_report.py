"""One page about a fit: what was found in the recording, and what was left out of it."""

import base64
import html
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from foveate.io.figures import GREY, TITLE, VERMILLION, WIDTH, literal, new_figure, tidy
from foveate.io.files import write_atomic
from foveate.plotting.scene import SEEN
from foveate.recordings.fit import Fitted
from foveate.recordings.outliers import clean

MOST_TRACKS, MOST_FIXES = 300, 2000
"""Tracks that are drawn, and fixes of each."""

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 16px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em }}
img {{ width: 100% }} li {{ margin: .2em 0 }}
</style></head><body><h1>{title}</h1><ul>
{facts}
</ul><img alt="Paths of the targets, the fixes left out, and speeds" src="data:image/png;base64,{figure}">
<h2>Left out, cut, or of no use</h2>
{findings}
</body></html>
"""


def write_fit_report(fitted: Fitted, path: Path, max_speed_m_s: float | None = None) -> None:
    """Write the page as HTML with its figure inside: paths, wrong fixes and jumps, speeds, targets at once."""
    statistics = fitted.statistics
    facts = [line for line in repr(fitted).splitlines() if line not in {f.text for f in statistics.findings}]
    said = [f"<li>{html.escape(finding.text)}</li>" for finding in statistics.findings]
    page = _PAGE.format(
        title=html.escape(f"Fit of {fitted.recording.short_name}"),
        facts="\n".join(f"<li>{html.escape(line)}</li>" for line in facts),
        figure=base64.b64encode(_figure(fitted, max_speed_m_s)).decode(),
        findings="<ul>" + "\n".join(said) + "</ul>" if said else "<p>Nothing: every fix counts.</p>",
    )
    write_atomic(path, page.encode())


def _figure(fitted: Fitted, max_speed_m_s: float | None) -> bytes:
    figure = new_figure(WIDTH, 4.1)
    paths, speeds = figure.subplots(1, 2, width_ratios=(3, 2))
    _paths(paths, fitted, max_speed_m_s)
    _speeds(speeds, fitted, max_speed_m_s)
    literal(figure)
    data = BytesIO()
    figure.savefig(data, format="png")
    return data.getvalue()


def _paths(axes: Axes, fitted: Fitted, max_speed_m_s: float | None) -> None:
    """Paths from above; fixes that were left out as crosses, ends of tracks at jumps as circles."""
    cleaned = clean(fitted.recording, max_speed_m_s).recording
    kept = {(track.track_id.partition(" (")[0], time) for track in cleaned.tracks for time in track.times_s.tolist()}
    for track in cleaned.tracks[:MOST_TRACKS]:
        x, y = track.positions_m[:MOST_FIXES, :2].T
        axes.plot(x, y, color=SEEN, lw=0.8)
        if " (" in track.track_id:
            axes.plot(x[:1], y[:1], "o", mfc="none", mec=VERMILLION)
    wrong = [
        position
        for track in fitted.recording.tracks
        for time, position in zip(track.times_s.tolist(), track.positions_m[:, :2], strict=True)
        if (track.track_id.partition(" (")[0], time) not in kept
    ]
    if wrong:
        axes.plot(*np.array(wrong).T, "x", color=VERMILLION, ms=4)
    statistics = fitted.statistics
    lower, upper = statistics.robust_lower_m[:2], statistics.robust_upper_m[:2]
    margin = 0.2 * (upper - lower).max() + 1.0
    tidy(axes, "x [m]", "y [m]")
    axes.set_title("paths (x: left out, o: after a jump)", loc="left", **TITLE)
    axes.set(aspect="equal", xlim=(lower[0] - margin, upper[0] + margin), ylim=(lower[1] - margin, upper[1] + margin))


def _speeds(axes: Axes, fitted: Fitted, max_speed_m_s: float | None) -> None:
    """Histogram of the speeds from fix to fix, up to twice the 95th percentile."""
    tracks = clean(fitted.recording, max_speed_m_s).recording.tracks
    parts = [np.linalg.norm(np.diff(t.positions_m, axis=0), axis=1) / np.diff(t.times_s) for t in tracks]
    speeds = np.concatenate(parts)
    most = max(2.0 * fitted.statistics.speed_p95_m_s, 1e-3)
    axes.hist(np.clip(speeds, 0, most), bins=60, range=(0, most), color=GREY)
    axes.axvline(fitted.statistics.speed_median_m_s, color=SEEN, label="median")
    axes.axvline(fitted.statistics.speed_p95_m_s, color=VERMILLION, label="95th percentile")
    tidy(axes, "speed from fix to fix [m/s]", "steps")
    axes.set_title("speeds, with the noise of the fixes", loc="left", **TITLE)
    axes.legend(frameon=False, fontsize=9)
