"""`foveate`: the command line. Nothing heavy is imported before a command is chosen, so that help comes at once."""

import functools
import inspect
import operator
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import tyro

from foveate import __version__
from foveate.cli.bench import Bench
from foveate.cli.common import full_precision, keep_compiled
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

DESCRIPTION = """Teach a mobile agent with a limited field of view where to look.

A run in three commands:
  foveate train --preset paper --out runs/first
  foveate evaluate runs/first --scenes table1
  foveate replay runs/first RECORDING.csv --out runs/first/replay

foveate COMMAND --help explains each; --version prints the version. RUN may be a preset: its trained policy is here.
"""


def _command(kind: type, name: str, is_asked: bool) -> Any:
    """The command for tyro: with the first line of its docstring in the list, and all of it on its own page."""
    text = inspect.cleandoc(kind.__doc__ or "")
    return Annotated[kind, tyro.conf.subcommand(name, description=text if is_asked else text.splitlines()[0])]


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


def _reject_repeated(arguments: Sequence[str]) -> None:
    """Raise ValueError where an option is given twice: the parser would take the last and say nothing."""
    names = [argument.partition("=")[0] for argument in arguments if argument.startswith("--")]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{twice[0]}: is given twice: expected once, with all of its values behind it")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command. Exit status: 0 done, 1 a check failed, 2 wrong input (one line on stderr), 130 interrupted."""
    given = sys.argv[1:] if arguments is None else arguments
    if list(given) == ["--version"]:
        print(f"foveate {__version__}")
        return 0
    kinds = [_command(kind, name, is_asked=name in given[:1]) for name, kind in COMMANDS.items()]
    choice: Any = functools.reduce(operator.or_, kinds)
    try:
        command = tyro.cli(
            choice, prog="foveate", description=DESCRIPTION, args=arguments, config=(tyro.conf.OmitSubcommandPrefixes,)
        )
        _reject_repeated(given)
        keep_compiled()
        full_precision()
        return command.run_command()
    except ValueError as error:
        print(f"foveate: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"foveate: {error.filename or ''}: {error.strerror or error}", file=sys.stderr)
        return 2
    except (OverflowError, MemoryError) as error:
        print(f"foveate: a number is too large: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("foveate: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
