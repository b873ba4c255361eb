"""Compiled programs are kept between processes, unless JAX is told otherwise."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from foveate.errors import InputError
from foveate.io import jax_settings

CODE = """
import jax, jax.numpy as jnp
from foveate.io.jax_settings import keep_compiled
jax.jit(lambda x: jnp.sin(x) + 1)(1.0)  # a program before: JAX then has decided that there is no cache
keep_compiled()
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: jnp.cos(x) + jnp.linalg.inv(jnp.eye(3) + x))(1.0)
print(jax.config.jax_compilation_cache_dir)
"""


def folder_of(home: Path, **variables: str) -> Path | None:
    """The folder that JAX was told, by a process with this home for caches."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(home), **variables}
    environment = {name: value for name, value in environment.items() if value}
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    said = done.stdout.strip()
    return None if said == "None" else Path(said)


def test_programs_are_kept_in_the_cache_of_the_user(tmp_path: Path):
    folder = folder_of(tmp_path, JAX_COMPILATION_CACHE_DIR="")
    assert folder == tmp_path / "foveate" / "jax"
    assert any(folder.iterdir())


def test_jax_own_settings_come_first(tmp_path: Path):
    assert folder_of(tmp_path, JAX_COMPILATION_CACHE_DIR="", JAX_ENABLE_COMPILATION_CACHE="0") is None
    assert not list(tmp_path.iterdir())
    own = tmp_path / "own"
    assert folder_of(tmp_path, JAX_COMPILATION_CACHE_DIR=str(own)) == own


def test_a_fork_is_told_by_its_process(monkeypatch: pytest.MonkeyPatch):
    assert not jax_settings.is_forked()
    monkeypatch.setattr(jax_settings, "LOADED_IN", os.getpid() + 1)
    assert jax_settings.is_forked()
    error = jax_settings.forked_error("this")
    assert isinstance(error, InputError)
    assert 'context="spawn"' in str(error)
