"""Shapes and dtypes of every annotation in foveate are checked while the tests run, in float64."""

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
install_import_hook("foveate", "beartype.beartype")
