"""Settings of JAX that the commands and the tests make: compilation and precision."""

import os


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
