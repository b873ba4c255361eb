"""Checkpoints: pytrees of arrays with the digest of their experiment, without pickled code."""

from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate import __version__
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.run_folder import BEST, CONFIG
from foveate.io.npz import load_arrays, save_arrays
from foveate.io.toml import digest, read_toml, save_toml
from foveate.simulation.records import Policy

VERSION = 1
RENAMED = {"returns": "rollbacks"}
"""Current names of arrays by their names in files of earlier versions."""
T = TypeVar("T")


def save_tree(
    path: Path, tree: Any, experiment: Experiment, kind: str, facts: dict[str, Any], config_digest: str | None = None
) -> None:
    """Write the arrays of a pytree with the digest of its experiment; `facts` is JSON about it (epoch, score).

    `config_digest` is that of the config.toml beside it, which may differ if an older version wrote that file; None
    takes the experiment's.
    """
    header = {"format": f"foveate-{kind}", "version": VERSION, "foveate": __version__, "facts": facts}
    header["experiment"] = digest(experiment) if config_digest is None else config_digest
    save_arrays(path, {name: np.asarray(leaf) for name, leaf in _named(tree).items()}, header)


def load_tree(path: Path, like: T, kind: str, config_digest: str | None = None) -> tuple[T, dict[str, Any]]:
    """Read a saved pytree, in the structure and dtypes of `like`, and its facts.

    Raises InputError for a missing, damaged or newer file, for other shapes, and if the experiment's digest is not
    `config_digest`.
    """
    header, arrays = load_arrays(path, kind, VERSION)
    arrays = {RENAMED.get(name, name): array for name, array in arrays.items()}
    if config_digest is not None and header["experiment"] != config_digest:
        raise InputError(f"{path}: belongs to another experiment than the config.toml beside it, which was changed")
    expected = _named(like)
    if missing := sorted(set(expected) - set(arrays)):
        raise InputError(f"{path}: no array {missing[0]!r}: this checkpoint is of another network")
    if extra := sorted(set(arrays) - set(expected)):
        raise InputError(f"{path}: unknown array {extra[0]!r}: this checkpoint is of another network")
    for name, array in expected.items():
        shape = arrays[name].shape
        if shape != array.shape:
            raise InputError(f"{path}: {name} has shape {shape}: expected {array.shape}, as config.toml says")
    dynamic, static = eqx.partition(like, _is_array)
    # In the dtypes of `like`: a file saved with x64 is read without it, and vice versa.
    leaves = [jnp.asarray(arrays[name], array.dtype) for name, array in expected.items()]
    return eqx.combine(jax.tree.unflatten(jax.tree.structure(dynamic), leaves), static), header["facts"]


def _is_array(leaf: Any) -> bool:
    """True for arrays, and for the shapes and dtypes in place of them."""
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _named(tree: Any) -> dict[str, Any]:
    """Arrays of a pytree by their path, in the order of its leaves."""
    leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(tree, _is_array))
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def policy_shape(experiment: Experiment) -> Policy:
    """The experiment's policy with shapes in place of weights."""
    problem = experiment.scenario.problem()
    return eqx.filter_eval_shape(lambda key: experiment.policy.policy(problem, key), jax.random.key(0))


def load_run(run: Path) -> tuple[Experiment, Policy, dict[str, Any]]:
    """Load the experiment and best policy of a run folder, and the policy's facts. Raises InputError if it cannot."""
    if not run.is_dir():
        raise InputError(f"{run}: no such run folder: expected one that `foveate train --out` wrote, or a preset")
    experiment, config_digest = read_toml(Experiment, run / CONFIG)
    policy, facts = load_tree(run / BEST, policy_shape(experiment), "policy", config_digest)
    return experiment, policy, facts


def write_config(run: Path, experiment: Experiment) -> None:
    """Write the `config.toml` of a run folder."""
    save_toml(experiment, run / CONFIG, "foveate: everything that defines this run.")
