"""Tables of a comparison of made-up rows."""

import io
from dataclasses import replace

import numpy as np
from helpers.comparisons import BASE, LOWEST, OTHER, SCENES, SEEDS, made_up, rows
from rich.console import Console
from scipy import stats

from foveate.io.tables import Table, draw, markdown
from foveate.study.comparison import Part, compare
from foveate.study.tables import tables


def test_tables_show_the_comparison():
    comparison = made_up()
    found = tables(comparison, "true")
    text = markdown("Made up", {"scenes": "8"}, found, {"a.png": "a picture"})
    scores = found[0]
    assert scores.header[2:4] == ("3 unbiased", "5 biased")
    assert [row[0] for row in scores.rows] == ["omniscient", *sorted(("net", "other"), key=lambda m: -{
        "net": (SEEDS[0] + SEEDS[10]).mean() / 2, "other": OTHER.mean()}[m])]  # fmt: skip
    (mine,) = [row for row in scores.rows if row[0] == "other"]
    half = stats.t.ppf(0.975, SCENES - 1) * stats.sem(OTHER[0])
    assert mine[2] == f"{OTHER[0].mean():.2f} ± {half:.2f}"
    assert mine[-1] == "1.0"
    spread = next(row for row in found[-1].rows if row[1] == "std over seeds")
    assert spread[2] == f"{np.std([SEEDS[0][0].mean(), SEEDS[10][0].mean()], ddof=1):.2f}"
    assert text.startswith("# Made up\n")
    assert "![a picture](a.png)" in text
    for table in found:
        assert {len(row) for row in table.rows} == {len(table.header)}
    lines = text.splitlines()
    assert lines.count("| method | kind | 3 unbiased | 5 biased |") == 6
    assert sum(line.startswith("| other | planned |") for line in lines) == 8


def test_tables_show_the_consistency_of_the_filter():
    """NEES 2 is within every band of 24 and 40 targets, 1.5 and 2.5 only within those of few."""
    given = tuple(replace(row, nees_seen=1.0, seen_fraction=1.0, nees_unseen=None) for row in rows("net", BASE))
    part = Part(method="net", family="trained", training_seed=None, protocol="true", rows=given,
                initial_error="consistent")  # fmt: skip
    found = {table.title: table for table in tables(compare([part], "net", LOWEST, 2), "true")}
    nees = found["true, consistent initial errors: NEES by cell"]
    low, high = stats.chi2.interval(0.95, 2 * 3 * SCENES) / np.array(3 * SCENES)
    assert nees.rows[0][2] == f"2.00 ({low:.2f} to {high:.2f}) / 1.00* / -"
    (line,) = found["true, consistent initial errors: targets detected, and consistency of the filter"].rows
    assert line[2:] == ("100%", "25.0%", "3.0", "0.20", "0.10", "0.40", "2.00", "1.00", "-", "0 of 2")


HOSTILE = "[/x] :smile: [red]a[/] $\\frac{$ <b>|![x](http://a) \\"


def test_names_are_text_on_a_terminal_and_on_a_page():
    table = Table(title=HOSTILE, header=(HOSTILE, "b"), rows=((HOSTILE, "1"),))
    file = io.StringIO()
    draw(table, Console(file=file, width=500, force_terminal=True, color_system=None))
    assert file.getvalue().count(HOSTILE) == 3
    lines = markdown("t", {"fact": f"a\n# {HOSTILE}"}, [table], {}).splitlines()
    assert not any("<b>" in line or "](http" in line for line in lines)
    assert [line for line in lines if line.startswith("#")] == ["# t", lines[4]]
    (row,) = [line for line in lines if line.endswith("| 1 |")]
    assert row.replace("\\|", "").count("|") == 3
