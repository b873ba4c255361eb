"""The command line as tests call it."""

from pathlib import Path

import pytest
from helpers.contract import faults

from foveate.cli.main import main


def failure(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line on standard error of a command that ends with exit status 2."""
    capsys.readouterr()
    assert main([str(argument) for argument in arguments]) == 2
    printed = capsys.readouterr()
    assert not printed.out
    (line,) = printed.err.strip().splitlines()
    assert line.startswith("foveate: ")
    return line


def check_contract(kind: str, path: Path) -> None:
    assert faults(kind, path) == []
