"""Every table that a command prints, in a terminal of 80 columns: nothing is cut, and nothing is lost."""

import fcntl
import os
import pty
import struct
import sys
import termios
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.comparisons import made_up
from rich.cells import cell_len

from foveate.bench.report import Report
from foveate.bench.timing import Metric
from foveate.cli.common import print_tables
from foveate.evaluation.cards import cards, cards_table
from foveate.evaluation.evaluate import Row
from foveate.evaluation.summary import Summary, summarise
from foveate.evaluation.summary_table import summary_table, summary_tables
from foveate.evaluation.verdict import verdict_of
from foveate.experiment.presets import PRESETS
from foveate.io.strict_json import parse_json
from foveate.io.tables import Table, parts
from foveate.names import HEURISTICS, METHODS
from foveate.recordings.measures import ReplayRow
from foveate.recordings.replay_table import replay_table
from foveate.study.tables import consistency, differences, scores
from foveate.study.tables import tables as study_tables
from foveate.study.world_results import Lead, WorldResult
from foveate.study.world_results import tables as worlds_tables

ROOT = Path(__file__).parents[2]
WIDTH = 80

Screen = Callable[[Callable[[], None]], list[str]]


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Screen:
    """Lines that a call prints on a terminal of 80 columns, without colours."""
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.delenv("COLUMNS", raising=False)

    def lines(call: Callable[[], None]) -> list[str]:
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, WIDTH, 0, 0))
        read: list[bytes] = []
        reader = threading.Thread(target=_read, args=(ours, read))
        reader.start()
        with open(theirs, "w", encoding="utf-8") as terminal, monkeypatch.context() as patch:
            for name in ("stdin", "stdout", "stderr", "__stdin__", "__stdout__", "__stderr__"):
                patch.setattr(sys, name, terminal)
            call()
        reader.join(10)
        return b"".join(read).decode().splitlines()

    return lines


def _read(descriptor: int, read: list[bytes]) -> None:
    try:
        while part := os.read(descriptor, 1 << 16):
            read.append(part)
    except OSError:  # Linux: everything is read, and the other end closed
        pass
    os.close(descriptor)


def summary(method: str, protocol: str, scenes: int = 3, targets: tuple[int, ...] = (3, 20)) -> list[Summary]:
    """Cells of a method, with numbers as long as any evaluation has."""
    numbers = {"seen_fraction": 1.0, "seen_step_fraction": 0.25, "longest_unseen_s": 123.4, "entropy": 0.1}
    numbers |= {"rmse_m": 12.25, "nees": 123.4, "step_time_s": 0.01, "episode": 0, "seed": 0, "objective": -10.125}
    numbers |= {"rmse_seen_m": 0.1, "rmse_unseen_m": 0.4, "nees_seen": 1.5, "nees_unseen": None}
    rows = [
        Row(scene=f"{motion}-{n}-{i}", score=-2.5 - i, motion=motion, targets=n, method=method, protocol=protocol,
            **numbers)
        for motion in ("unbiased", "biased") for n in targets for i in range(scenes)
    ]  # fmt: skip
    return summarise(rows, 2)


CELLS = [cell for protocol in ("surrogate", "true") for name in METHODS for cell in summary(name, protocol)]


def evaluations() -> list[Table]:
    """Of scores alone, with an objective, with normalised scores, and with all of that."""
    with_all = [replace(cell, normalised_score=-0.123) for cell in CELLS]
    return [
        table
        for cells, objective in ((CELLS, None), (CELLS, "mean"), (with_all, "terminal"), (with_all, "seen"))
        for table in summary_tables("runs/my-long-name on own: 30 scenes, 1 episode each", cells, objective)
    ]


def replays() -> list[Table]:
    """A row of a replay a method, with all measures."""
    rows = tuple(
        ReplayRow(method=name, seed=0, agent_start=(0.0, 0.0, 0.0), targets=148, log_det_mean=-12.25, seen_fraction=1.0,
                  seen_time_fraction=1.0, longest_unseen_s=1234.5, rmse_m=123.45, nees=1234.5, nees_band=(1.0, 2.0),
                  rmse_seen_m=1.0, rmse_unseen_m=None, nees_seen=3.0, nees_unseen=None, lost=15 + i, rejected=1234,
                  step_time_s=0.1)
        for name in METHODS for i in range(2)
    )  # fmt: skip
    return [replay_table("a-long-name-of-a-recording.csv", rows)]


def verdicts() -> list[Table]:
    """Of all methods and a planner; and of one episode."""
    scores = {name: np.array([-12.25, 3.0, 4.0]) - i for i, name in enumerate(METHODS)}
    single = {name: each[:1] for name, each in scores.items()}
    return [
        verdict_of(PRESETS["quadrotor"], scores, {"icr-16": scores["policy"][:2]}).table,
        verdict_of(PRESETS["paper"], single, {}).table,
    ]


def comparisons() -> list[Table]:
    """All tables of a comparison, in six cells, of which one has a single scene."""
    made = made_up()
    cells = [
        replace(cell, motion=motion, targets=targets)
        for cell in made.summary for motion in ("unbiased", "biased") for targets in (3, 5, 7)
        if cell.motion == "biased"
    ]  # fmt: skip
    longer = {"omniscient": "omniscient", "net": "true-view-longer", "other": "refine-15"}
    cells = [replace(cell, method=longer[cell.method]) for cell in cells]
    overall = tuple(replace(each, method=longer[each.method]) for each in made.overall)
    wide = replace(made, summary=tuple(cells), overall=overall)
    return [*study_tables(made, "true"), scores(wide, "true"), consistency(wide, "true")]


def worlds() -> list[Table]:
    """Two worlds of made-up results, one without a planner."""
    leads = tuple(
        Lead(method=name, mean=-12.25, difference=1.0, difference_se=0.1, episodes=128) for name in HEURISTICS
    )
    whole = WorldResult(world="a-world-of-a-long-name", objective="mean", protocol="true", mean=-12.25,
                        ci95=(-13.0, -11.5), by_seed=(-12.25, -12.5, -12.0), episodes=128, heuristics=leads,
                        planner=leads[0], no_planner="", way=-1.23, training_s=12345.0)  # fmt: skip
    return worlds_tables([whole, replace(whole, world="b", planner=None, way=None, objective="seen")])


def benchmarks() -> list[Table]:
    """As the baseline of this repository, without and with a baseline."""
    known: Any = parse_json((ROOT / "benchmarks" / "baseline.json").read_text(encoding="utf-8"))
    names = ("key", "value", "unit", "better", "spread")
    metrics = tuple(Metric(**{name: each[name] for name in names if name in each}) for each in known["metrics"])
    ratios = {each["key"]: each["ratio"] for each in known["metrics"]}
    report = Report(machine=known["machine"], repeats=9, metrics=metrics, ratios=ratios)
    return [report.table({}), report.table(ratios)]


def presets() -> list[Table]:
    """Of the package."""
    return [cards_table(cards())]


KINDS = [evaluations, replays, verdicts, comparisons, worlds, benchmarks, presets]


@pytest.mark.parametrize("make", KINDS)
@pytest.mark.parametrize("wide", [False, True])
def test_tables_fit_into_80_columns_and_lose_nothing(make: Callable[[], list[Table]], wide: bool, screen: Screen):
    for table in make():
        lines = screen(lambda table=table: print_tables(table, wide=wide))
        assert max(map(cell_len, lines)) <= WIDTH
        assert not any("…" in line for line in lines)
        shown = table if wide else table.brief
        assert set(" ".join(shown.header).split()) <= set(" ".join(lines).split())
        for row in shown.rows:
            printed = {word for line in lines if line.startswith(row[0]) for word in line.split()}
            assert {word for cell in row for word in cell.split()} <= printed


@pytest.mark.parametrize("make", [evaluations, replays, verdicts, presets])
def test_the_tables_of_daily_work_take_one_part(make: Callable[[], list[Table]]):
    """The score stands in the line of its method, but for normalised scores, which few ask for."""
    for table in make():
        if "normalised" not in table.header:
            assert len(parts(table.brief, WIDTH)) == 1, table.brief.header


def test_one_scene_has_no_interval_and_one_episode_no_deviation():
    """A measured interval of zero stays one: scenes with the same score."""
    single = summary("policy", "true", scenes=1, targets=(3,))[0]
    again = replace(single, std=0.5, episodes=4)
    same = replace(single, episodes=30)
    column = {name: i for i, name in enumerate(summary_table("t", [single], None).header)}
    rows = summary_table("t", [single, again, same], None).rows
    assert [row[column["score [nat]"]] for row in rows] == ["-2.50 ± -", "-2.50 ± -", "-2.50 ± 0.00"]
    assert [row[column["std"]] for row in rows] == ["-", "0.50", "0.00"]


def test_intervals_of_one_scene_in_comparisons_and_verdicts():
    made = made_up()
    single = replace(
        made,
        summary=tuple(replace(cell, ci95=(cell.mean, cell.mean), std=0.0, episodes=1) for cell in made.summary),
        differences=tuple(replace(each, scenes=1) for each in made.differences),
    )
    assert all(row[2].endswith("± -") for row in scores(single, "true").rows)
    assert all("± -" in row[2] for row in differences(single, "true").rows)
    assert {row[2] for row in verdicts()[1].rows if row[0] == "policy"} == {"-12.25 ± -"}
    (row,) = worlds()[0].rows[:1]
    assert row[2] == "-12.25 ± 0.75"
