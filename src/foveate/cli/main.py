"""The command line `foveate`. Nothing heavy is imported before a command is chosen, so that help is fast."""

import functools
import operator
import sys
import traceback
from collections.abc import Sequence
from dataclasses import fields
from importlib import import_module
from typing import Annotated, Any

import tyro

from foveate import __version__
from foveate.cli.arguments import check_arguments
from foveate.cli.bench import Bench
from foveate.cli.config import Config
from foveate.cli.evaluate import Evaluate
from foveate.cli.export import Export
from foveate.cli.fit import Fit
from foveate.cli.help import explained, wrapped
from foveate.cli.logs import logged
from foveate.cli.plan import Plan
from foveate.cli.presets import Presets
from foveate.cli.render import Render
from foveate.cli.replay import Replay
from foveate.cli.reproduce import Reproduce
from foveate.cli.streams import steady_streams
from foveate.cli.train import Train
from foveate.cli.view import View
from foveate.errors import InputError
from foveate.io.jax_settings import full_precision, keep_compiled

DESCRIPTION = """Teach a mobile agent with a limited field of view where to look.

A run in three commands:
  foveate train --preset paper --out runs/first
  foveate evaluate runs/first --scenes table1
  foveate replay runs/first RECORDING.csv --out runs/first/replay

foveate COMMAND --help explains each command. RUN may be the name of a preset (its trained policy comes with the
package; `foveate presets` lists them).

With any command: -q (--quiet) prints warnings and results alone, -v (--verbose) every step with its time, --debug the
traceback of an error. --version prints the version, --tyro-print-completion bash (zsh, tcsh) a shell's completion.

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
    "presets": Presets,
    "config": Config,
    "bench": Bench,
}

FLAGS = {"--debug": "debug", "-q": "quiet", "--quiet": "quiet", "-v": "verbose", "--verbose": "verbose"}
"""Options of every command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Exit status: 0 success, 1 a check failed, 2 wrong input, 70 a bug of foveate, 130 interrupted."""
    with steady_streams():
        return _main(list(sys.argv[1:] if arguments is None else arguments))


def _main(given: list[str]) -> int:
    flags = {FLAGS[argument] for argument in given if argument in FLAGS}
    given = [argument for argument in given if argument not in FLAGS]
    command = None
    try:
        try:
            if given == ["--version"]:
                print(f"foveate {__version__}")
                return 0
            if flags >= {"quiet", "verbose"}:
                raise InputError("--quiet and --verbose: expected one of them")
            command = _parsed(given)
            with logged("quiet" in flags, "verbose" in flags):
                return _run(command)
        finally:
            sys.stdout.flush()  # a full disk is noticed here
    except (Exception, KeyboardInterrupt) as error:
        if "debug" in flags:
            traceback.print_exc()
        status, lines = _failure(error, command)
        print(f"foveate: {lines}", file=sys.stderr)
        return status


def _parsed(given: Sequence[str]) -> Any:
    """Parse a command and its options. Raises InputError for unknown names, and for an option given twice."""
    check_arguments(given, COMMANDS, repeatable=["--set"])
    kinds = [_for_tyro(kind, name, is_chosen=name in given[:1]) for name, kind in COMMANDS.items()]
    choice: Any = functools.reduce(operator.or_, kinds)
    config = (tyro.conf.OmitSubcommandPrefixes,)
    return tyro.cli(choice, prog="foveate", description=wrapped(DESCRIPTION), args=given, config=config)


def _for_tyro(kind: type, name: str, is_chosen: bool) -> Any:
    """Describe a command by the first line of its docstring in the list, by all of it on its own page."""
    text = kind.__doc__ or ""
    if not is_chosen:
        return Annotated[kind, tyro.conf.subcommand(name, description=text.splitlines()[0])]
    return Annotated[explained(kind), tyro.conf.subcommand(name, description=wrapped(text))]


def _run(command: Any) -> int:
    command.check()
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
        return WRONG_INPUT, f"{error.filename}: {error.strerror}" if error.filename else str(error.strerror or error)
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
