"""Settings of JAX that the commands and the tests make: compilation and precision."""

import os
import warnings
from collections.abc import Callable
from typing import Any

from foveate.errors import InputError
from foveate.io.progress import logger

LOADED_IN = os.getpid()
"""Process that loaded this module, and with it JAX."""


def is_forked() -> bool:
    """True in a fork of the process that loaded JAX: its threads are not there, and its programs would hang."""
    return os.getpid() != LOADED_IN


def forked_error(what: str) -> InputError:
    """Error of `what` cannot run in a fork."""
    right = 'expected a process of its own: context="spawn", or start_method="spawn" of Stable-Baselines3'
    return InputError(f"{what} in a fork of a process in which JAX has run: {right}")


def keep_compiled() -> None:
    """Keep compiled programs in the user's cache folder, so that only the first run of a kind waits for compilation.

    The folder is foveate/jax there, and safe to delete. A folder that JAX has been told already stays, as by
    JAX_COMPILATION_CACHE_DIR; JAX_ENABLE_COMPILATION_CACHE=0, or the setting of JAX of that name, keeps nothing.
    Nothing is kept either where the folder cannot be written, of which JAX would warn for every program.
    """
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    from foveate.io.files import cache_folder

    settings = jax.config.values
    if not settings["jax_enable_compilation_cache"] or settings["jax_compilation_cache_dir"]:
        return
    folder = cache_folder("jax")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_writable = os.access(folder, os.W_OK | os.X_OK, effective_ids=os.access in os.supports_effective_ids)
    except OSError:
        is_writable = False
    if not is_writable:
        logger.info(f"{folder}: cannot be written; compiled programs are not kept")
        return
    # A full disk, or a file of another user: that program is compiled again, as JAX would say for each of many.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry", UserWarning)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.02)
    compilation_cache.reset_cache()  # a program compiled before has fixed that there is none


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


def quick_compilation() -> dict[str, bool]:
    """Options of `jax.jit` for programs that compile longer than they run; none for versions that may not know them."""
    import jax

    return {"xla_cpu_use_fusion_emitters": False} if jax.__version__.startswith("0.10.") else {}


def compiled(simulate: Callable[..., Any], quick: bool) -> Callable[..., Any]:
    """`equinox.filter_jit` of a function that simulates robots; `quick` compilation takes half the time.

    In the plane the program is then as fast, and rounds alike except for the last bits. In space it would take 1.6
    times as long, and the gradient ascent of a planner would round, and end, otherwise.
    """
    import equinox as eqx

    jit: Any = eqx.filter_jit  # whose types leave out the options of `jax.jit`
    return jit(simulate, compiler_options=quick_compilation() if quick else {})
