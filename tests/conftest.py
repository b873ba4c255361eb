"""Shapes and dtypes of every annotation in foveate are checked while the tests run, in float64.

Most of the suite's time is XLA's compilation, which `compile_fast` nearly halves.
"""

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
install_import_hook("foveate", "beartype.beartype")

from foveate.cli.common import compile_fast  # noqa: E402  (after the hook, so that it is checked, too)

compile_fast()
