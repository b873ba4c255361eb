"""Shared by the commands: checks of output files, ports and programs, tables."""

import os
import shutil
import socket
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from foveate.errors import InputError

if TYPE_CHECKING:
    from foveate.deploy.exported import ExportedPolicy
    from foveate.io.tables import Table


def policy_named(name: str) -> "str | ExportedPolicy":
    """The policy of an exported file; a run or a preset stays a name."""
    if Path(name).suffix != ".onnx":
        return name
    from foveate.deploy.exported import load_exported

    return load_exported(name)


def check_seed(seed: int, name: str = "--seed") -> None:
    """Raise InputError for a seed outside of its range."""
    from foveate.io.validate import seed_number

    seed_number(seed, name)


def check_output(path: Path | None, *inputs: Path | str | None, folder: bool = False) -> None:
    """Raise InputError now, not after minutes of work, where a result could not be written or would hit an input."""
    if path is None:
        return
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise InputError(f"{path}: is a link in a circle: choose another place")
    if any(target == Path(os.path.realpath(name)) for name in inputs if name):
        raise InputError(f"{path}: is an input of this command: choose another file")
    if path.exists() and path.is_dir() != folder:
        raise InputError(f"{path}: is {'no ' * folder}a folder: choose another place")
    if not target.parent.is_dir():
        raise InputError(f"{path}: no folder {path.parent}: make it first, or choose another place")


def check_port(port: int) -> None:
    """Raise InputError now, not after seconds of imports, for a port of this machine that cannot be served."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            another = f"choose another, say {port + 1 if port < 65535 else 8080}"
            raise InputError(f"--port {port}: is in use, or needs privileges: {another}") from error


def check_video(path: Path) -> None:
    """Raise InputError now, not after a simulation, for a video where nothing can encode it."""
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None and find_spec("imageio_ffmpeg") is None:
        raise InputError(f"{path}: ffmpeg is missing: install it, or write a .gif")


def print_tables(*tables: "Table", wide: bool = False) -> None:
    """Print tables with their notes, a line between them; `wide` ones with all columns."""
    from foveate.io.tables import console_of_output, draw

    console = console_of_output()
    for i, table in enumerate(tables):
        if i > 0:
            console.print()
        draw(table, console, wide)
