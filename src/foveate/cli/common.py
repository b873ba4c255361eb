"""Shared by the commands: settings of JAX, checks of output files, tables."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from foveate.errors import InputError


def keep_compiled() -> None:
    """Keep compiled programs in the user's cache folder, so that only the first run of a kind waits for compilation.

    The folder is foveate/jax there, and safe to delete; JAX_COMPILATION_CACHE_DIR names another one.
    """
    import jax

    from foveate.io.files import cache_folder

    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        jax.config.update("jax_compilation_cache_dir", str(cache_folder("jax")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.02)


def full_precision() -> None:
    """Multiply matrices in full float32, where accelerators would round factors to 10 bits.

    JAX_DEFAULT_MATMUL_PRECISION overrides this.
    """
    import jax

    if not os.environ.get("JAX_DEFAULT_MATMUL_PRECISION"):
        jax.config.update("jax_default_matmul_precision", "highest")


def compile_fast() -> None:
    """Let XLA compile in a fifth less time, for programs that compile longer than they run.

    Call it before importing anything that makes arrays. XLA_FLAGS overrides it; other versions of JAX may not know the
    flag, and get none.
    """
    from importlib.metadata import version

    if version("jax").startswith("0.10."):
        os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")


def check_seed(seed: int, name: str = "--seed") -> None:
    """Raise InputError for a seed outside of its range."""
    from foveate.io.validate import seed_number

    seed_number(seed, name)


def check_output(path: Path | None, *inputs: Path | str | None, folder: bool = False) -> None:
    """Raise InputError now, not after minutes of work, where a result could not be written or would hit an input."""
    if path is None:
        return
    if any(path.resolve() == Path(name).resolve() for name in inputs if name):
        raise InputError(f"{path}: is an input of this command: choose another file")
    if path.exists() and path.is_dir() != folder:
        raise InputError(f"{path}: is {'no ' * folder}a folder: choose another place")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{path}: no folder {path.parent}: make it first, or choose another place")


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; its first two columns are text, the others numbers."""
    from rich.console import Console

    from foveate.io.tables import TABLE_WIDTH, Table, draw

    table = Table(title=title, header=tuple(header), rows=tuple(tuple(row) for row in rows))
    # Not a terminal: no colours, and as wide as the table needs.
    draw(table, Console() if sys.stdout.isatty() else Console(width=TABLE_WIDTH, no_color=True))
