"""Shapes and dtypes of every annotation in foveate are checked while the tests run, in float64.

Most of the suite's time is XLA's compilation, which `compile_fast` and `compiled_quickly` each nearly halve. What one
worker or process has compiled the others find in a cache of this run.
"""

import os
import random
import shutil
import tempfile
from pathlib import Path

import jax
import optax
import pytest
from helpers.compilation import collect_seldom, compile_least, share_context
from jaxtyping import install_import_hook

TESTS = Path(__file__).parent

IS_FIRST = "JAX_COMPILATION_CACHE_DIR" not in os.environ
if IS_FIRST:  # workers, and processes that tests start, inherit it
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="foveate-compiled-")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)  # so that batches are sharded in this process, too
install_import_hook("foveate", "beartype.beartype")

from foveate.io.jax_settings import compile_fast  # noqa: E402

compile_fast()
share_context()
# A sixth less again; processes that tests start inherit it.
os.environ["XLA_FLAGS"] += " --xla_llvm_force_inline_before_split=false --xla_cpu_parallel_codegen_split_count=1"


def chain_mixing_types(*parts: optax.GradientTransformation) -> optax.GradientTransformation:
    """optax.chain under JAX's usual promotion: Adam's bias correction and schedules mix floats with int32 counts."""
    chained = chain(*parts)

    def update(*arguments, **extra):
        with jax.numpy_dtype_promotion("standard"):
            return chained.update(*arguments, **extra)

    return chained._replace(update=update)


chain, optax.chain = optax.chain, chain_mixing_types


CORE = {
    *("geometry", "models", "scenario", "simulation", "policies", "planning"),
    *("experiment", "learning", "evaluation", "recordings", "plotting", "study"),
}


@pytest.fixture(autouse=True, scope="module")
def promotion(request):
    """foveate's core mixes types only where its code says so.

    The doors (deploy, gym, bench, Stable-Baselines3 ..) do it on purpose: they hand float32 to a program that is
    float64 here, and float32 elsewhere. Ranks may be mixed: geometry broadcasts any leading axes, by its contract.
    """
    folders = request.path.relative_to(TESTS).parts[:-1]
    is_core = bool(folders) and folders[0] in CORE and "sb3" not in folders
    with jax.numpy_dtype_promotion("strict" if is_core else "standard"):
        yield


RUN_LONGER = {
    *("endurance", "learning/test_devices.py", "learning/test_killed.py"),
    *("learning/test_strata.py", "models/detections/test_filter.py", "models/test_missed_detection.py"),
    "planning/test_shooting.py",
}
"""Folders and files whose programs run longer than they compile, or are compared with those of other processes."""


@pytest.fixture(autouse=True, scope="module")
def compiled_quickly(request):
    """What runs so little need not run fast: XLA leaves most optimizations out, and compiles in half the time."""
    path, before = request.path.relative_to(TESTS), jax.config.read("jax_disable_most_optimizations")
    if RUN_LONGER & {path.parts[0], path.as_posix()}:
        jax.config.update("jax_disable_most_optimizations", False)
        yield
    else:
        jax.config.update("jax_disable_most_optimizations", True)
        with pytest.MonkeyPatch.context() as patch:
            compile_least(patch)
            yield
    jax.config.update("jax_disable_most_optimizations", before)


def pytest_addoption(parser):
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run files, and the tests in each, in another order")


def pytest_unconfigure(config):
    if IS_FIRST:
        shutil.rmtree(os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)


def pytest_collection_finish():
    collect_seldom()


def pytest_report_header(config):
    seed = config.getoption("--shuffle")
    return None if seed is None else f"order: --shuffle {seed}"


def pytest_collection_modifyitems(config, items):
    """Keep files whole: the fixtures of a file are made once."""
    seed = config.getoption("--shuffle")
    if seed is not None:
        drawn = random.Random(seed)
        files = {item.path: drawn.random() for item in items}
        order = {item: drawn.random() for item in items}
        items.sort(key=lambda item: (files[item.path], order[item]))
