"""The command line `foveate`. Nothing heavy is imported before a command is chosen, so that help is fast."""

import functools
import inspect
import operator
import sys
import traceback
from collections.abc import Sequence
from dataclasses import fields
from importlib import import_module
from typing import Annotated, Any

import tyro

from foveate import __version__
from foveate.cli.bench import Bench
from foveate.cli.evaluate import Evaluate
from foveate.cli.export import Export
from foveate.cli.fit import Fit
from foveate.cli.plan import Plan
from foveate.cli.render import Render
from foveate.cli.replay import Replay
from foveate.cli.reproduce import Reproduce
from foveate.cli.train import Train
from foveate.cli.view import View
from foveate.errors import InputError
from foveate.io.jax_settings import full_precision, keep_compiled

DESCRIPTION = """Teach a mobile agent with a limited field of view where to look.

A run in three commands:
  foveate train --preset paper --out runs/first
  foveate evaluate runs/first --scenes table1
  foveate replay runs/first RECORDING.csv --out runs/first/replay

foveate COMMAND --help explains each command; --version prints the version; --debug, with any command, shows the
traceback of an error. RUN may be the name of a preset (its trained policy comes with the package).

Exit status: 0 success, 1 ran but a check failed, 2 wrong input, 70 a bug of foveate, 130 interrupted.
"""

WRONG_INPUT, BUG, INTERRUPTED = 2, 70, 130
"""Exit statuses; 70 is EX_SOFTWARE of sysexits.h."""

COMMANDS = {
    "train": Train,
    "evaluate": Evaluate,
    "reproduce": Reproduce,
    "plan": Plan,
    "fit": Fit,
    "replay": Replay,
    "render": Render,
    "view": View,
    "export": Export,
    "bench": Bench,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Exit status: 0 success, 1 a check failed, 2 wrong input, 70 a bug of foveate, 130 interrupted."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug, given = "--debug" in given, [argument for argument in given if argument != "--debug"]
    if given == ["--version"]:
        print(f"foveate {__version__}")
        return 0
    command = None
    try:
        command = _parsed(given)
        return _run(command)
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        status, lines = _failure(error, command)
        print(f"foveate: {lines}", file=sys.stderr)
        return status


def _parsed(given: Sequence[str]) -> Any:
    """Parse a command and its options. Raises InputError for an option given twice."""
    kinds = [_for_tyro(kind, name, is_chosen=name in given[:1]) for name, kind in COMMANDS.items()]
    choice: Any = functools.reduce(operator.or_, kinds)
    config = (tyro.conf.OmitSubcommandPrefixes,)
    command = tyro.cli(choice, prog="foveate", description=DESCRIPTION, args=given, config=config)
    names = [argument.partition("=")[0] for argument in given if argument.startswith("--")]
    if twice := [name for name in names if names.count(name) > 1]:  # of which the parser takes the last
        raise InputError(f"{twice[0]}: is given twice: expected once, followed by all its values")
    return command


def _for_tyro(kind: type, name: str, is_chosen: bool) -> Any:
    """Describe a command by the first line of its docstring in the list, by all of it on its own page."""
    text = inspect.cleandoc(kind.__doc__ or "")
    return Annotated[kind, tyro.conf.subcommand(name, description=text if is_chosen else text.splitlines()[0])]


def _run(command: Any) -> int:
    keep_compiled()
    full_precision()
    command.prepare()
    name = next(name for name, kind in COMMANDS.items() if isinstance(command, kind))
    return import_module(f"foveate.cli.run.{name}").run(command)


def _failure(error: BaseException, command: Any) -> tuple[int, str]:
    """Exit status and message of an error: one line, except for a bug."""
    if isinstance(error, InputError):
        return WRONG_INPUT, _with_option(str(error), command)
    if isinstance(error, OSError):
        return WRONG_INPUT, f"{error.filename or ''}: {error.strerror or error}"
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, "interrupted"
    report = f"please report it, with the command and its version (foveate {__version__}); --debug shows the traceback"
    return BUG, f"this is a bug of foveate: {type(error).__name__}: {error}\n{report}"


def _with_option(message: str, command: Any) -> str:
    """Name the option where a message begins with the Python argument of the same name."""
    name = message.partition(":")[0].partition(" ")[0]
    if command is None or name not in {field.name for field in fields(command)}:
        return message
    return f"--{name.replace('_', '-')}{message[len(name) :]}"


if __name__ == "__main__":
    sys.exit(main())
