"""Progress off a terminal: lines of the logger "foveate", or printed in a notebook."""

import logging
import re
import time

import pytest

from foveate.cli.logs import logged
from foveate.io.progress import Bar, logger

LINE = r"training: (\d+) of 40 epochs( in \d:\d\d(, \d:\d\d left)?)?  note \1"
TENTHS = [1, *range(4, 41, 4)]


def train(quiet: bool = False) -> None:
    with Bar("training", 40, "epochs", quiet) as bar:
        for done in range(1, 41):
            bar.update(done, f"note {done}")


def reported(lines: list[str]) -> list[int]:
    found = [re.fullmatch(LINE, line) for line in lines]
    assert all(found), lines
    return [int(match[1]) for match in found if match]


def test_a_notebook_shows_progress_at_each_tenth(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    train(quiet=True)
    assert not capsys.readouterr().out
    train()
    assert reported(capsys.readouterr().out.splitlines()) == TENTHS


def test_elsewhere_progress_is_logged(caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]):
    """Python's logging decides what becomes of it: nothing is printed by itself, but for what is not to be missed."""
    with caplog.at_level(logging.INFO, "foveate"):
        train(quiet=True)
        assert not caplog.messages
        train()
    assert reported(caplog.messages) == TENTHS
    caplog.clear()
    with caplog.at_level(logging.DEBUG, "foveate"):
        train()
    assert reported(caplog.messages) == list(range(1, 41))
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "")


def test_the_first_line_comes_before_the_first_unit(caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.INFO, "foveate"), Bar("evaluating", 2, "methods") as bar:
        bar.update(0, "policy")
        bar.update(0, "policy, again")
        bar.update(2)
    assert caplog.messages[0] == "evaluating: 0 of 2 methods  policy"
    assert len(caplog.messages) == 2


def test_what_takes_long_to_begin_says_so(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("foveate.io.progress.SILENT_S", 0.01)
    with caplog.at_level(logging.INFO, "foveate"), Bar("training", 10, "epochs") as bar:
        deadline = time.monotonic() + 60
        while not caplog.messages and time.monotonic() < deadline:
            time.sleep(0.01)
        assert caplog.messages == ["training: 0 of 10 epochs"]
        bar.update(1)
        bar.update(2)
    assert len(caplog.messages) == 3


def test_the_time_left_counts_from_the_first_unit(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch):
    """100 s of compilation and one unit, then 10 s a unit: 80 s for the other 8 of 10."""
    now = [0.0]
    monkeypatch.setattr("foveate.io.progress.time.monotonic", lambda: now[0])
    with caplog.at_level(logging.INFO, "foveate"), Bar("training", 10, "epochs") as bar:
        for done, now[0] in ((1, 100.0), (2, 110.0)):
            bar.update(done)
    assert caplog.messages == ["training: 1 of 10 epochs in 1:40", "training: 2 of 10 epochs in 1:50, 1:20 left"]


@pytest.mark.parametrize(
    ("quiet", "verbose", "shown"), [(False, False, TENTHS), (True, False, []), (False, True, list(range(1, 41)))]
)
def test_a_command_prints_them_on_standard_error(
    quiet: bool, verbose: bool, shown: list[int], capsys: pytest.CaptureFixture[str]
):
    """By default a line a tenth, quiet none, verbose all with their time; warnings always."""
    with logged(quiet, verbose):
        train()
        with Bar("replaying", 1, "runs") as bar:
            bar.say("warning: fixes are far apart")
    printed = capsys.readouterr()
    assert not printed.out
    *lines, last = printed.err.splitlines()
    assert last.endswith("warning: fixes are far apart")
    if verbose:
        assert all(re.match(r"\d\d:\d\d:\d\d  ", line) for line in lines)
        lines = [line[10:] for line in lines]
    assert reported(lines) == shown
    assert not logger.handlers
    assert logger.level == logging.NOTSET
