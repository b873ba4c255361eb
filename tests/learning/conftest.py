"""Trainings of one module of tests compile each program once."""

import jax
import pytest
from jax.experimental.compilation_cache import compilation_cache

CACHE = {
    "jax_compilation_cache_dir": None,
    "jax_persistent_cache_min_compile_time_secs": 0.05,
    "jax_persistent_cache_min_entry_size_bytes": -1,
}


@pytest.fixture(scope="module", autouse=True)
def compiled_once(tmp_path_factory):
    """Share compiled programs between calls of a trainer, each of which would compile its own."""
    before = {name: getattr(jax.config, name) for name in CACHE}
    compilation_cache.reset_cache()
    for name, value in CACHE.items():
        jax.config.update(name, value or str(tmp_path_factory.mktemp("programs")))
    yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
