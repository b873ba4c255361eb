"""Shapes and dtypes of every annotation in foveate are checked while the tests run, in float64.

Most of the suite's time is XLA's compilation, which `compile_fast` nearly halves.
"""

import random

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
install_import_hook("foveate", "beartype.beartype")

from foveate.cli.common import compile_fast  # noqa: E402  (after the hook, so that it is checked, too)

compile_fast()


def pytest_addoption(parser):
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run files, and the tests in each, in another order")


def pytest_report_header(config):
    seed = config.getoption("--shuffle")
    return None if seed is None else f"order: --shuffle {seed}"


def pytest_collection_modifyitems(config, items):
    """Files stay together: what is made for all tests of one is made once."""
    seed = config.getoption("--shuffle")
    if seed is not None:
        drawn = random.Random(seed)
        files = {item.path: drawn.random() for item in items}
        order = {item: drawn.random() for item in items}
        items.sort(key=lambda item: (files[item.path], order[item]))
