"""Weights in files: any pytree of arrays, saved whole, checked on the way back, no code in it."""

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


T = TypeVar("T")

RENAMED = {"returns": "rollbacks"}
"""Arrays of earlier versions, as they are called now."""


def save_tree(
    path: Path, tree: Any, experiment: Experiment, kind: str, facts: dict[str, Any], content: str | None = None
) -> None:
    """Write the arrays of a pytree with the digest of its experiment; `facts` is any JSON about it (epoch, score).

    `content` is the digest of the config.toml beside it, where an older version has written that.
    """
    header = {
        "format": f"foveate-{kind}",
        "version": VERSION,
        "foveate": __version__,
        "experiment": digest(experiment) if content is None else content,
        "facts": facts,
    }
    save_arrays(path, {name: np.asarray(leaf) for name, leaf in _named(tree).items()}, header)


def load_tree(path: Path, like: T, kind: str, content: str | None = None) -> tuple[T, dict[str, Any]]:
    """The pytree that was saved, in the structure and the dtypes of `like`, and the facts beside it.

    Raises ValueError in one line for a file that is missing, cut, damaged, newer, or holds other shapes,
    or was saved by another experiment than the one whose digest `content` is given.
    """
    header, arrays = load_arrays(path, kind, VERSION)
    arrays = {RENAMED.get(name, name): array for name, array in arrays.items()}
    if content is not None and header["experiment"] != content:
        raise InputError(
            f"{path}: belongs to another experiment than the config.toml beside it, which was changed since"
        )
    wanted = _named(like)
    if missing := sorted(set(wanted) - set(arrays)):
        raise InputError(f"{path}: no array {missing[0]!r}: this checkpoint is of another network")
    if extra := sorted(set(arrays) - set(wanted)):
        raise InputError(f"{path}: array {extra[0]!r} has no place here: this checkpoint is of another network")
    for name, array in wanted.items():
        if arrays[name].shape != array.shape:
            raise InputError(
                f"{path}: {name} has shape {arrays[name].shape}: expected {array.shape}, as config.toml says"
            )
    dynamic, static = eqx.partition(like, _is_array)
    leaves = [jnp.asarray(arrays[name], old.dtype) for name, old in zip(wanted, jax.tree.leaves(dynamic), strict=True)]
    return eqx.combine(jax.tree.unflatten(jax.tree.structure(dynamic), leaves), static), header["facts"]


def _is_array(leaf: Any) -> bool:
    """An array, or the shape and dtype that stand for one."""
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _named(tree: Any) -> dict[str, Any]:
    """The arrays of a pytree by their path in it."""
    leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(tree, _is_array))
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def policy_shape(experiment: Experiment) -> Policy:
    """A policy of the experiment's architecture with shapes in place of weights, to be filled with saved ones."""
    problem = experiment.scenario.problem()
    return eqx.filter_eval_shape(lambda key: experiment.policy.policy(problem, key), jax.random.key(0))


def load_run(run: Path) -> tuple[Experiment, Policy, dict[str, Any]]:
    """Experiment and best policy of a run folder, and the facts saved with it.

    Raises ValueError in one line where the folder is not a run or a file of it is not what it should be.
    """
    if not run.is_dir():
        raise InputError(
            f"{run}: no such run folder: expected what `foveate train --out` wrote, or the name of a preset"
        )
    experiment, content = read_toml(Experiment, run / CONFIG)
    policy, facts = load_tree(run / BEST, policy_shape(experiment), "policy", content)
    return experiment, policy, facts


def write_config(run: Path, experiment: Experiment) -> None:
    """Write `config.toml` of a run folder."""
    save_toml(experiment, run / CONFIG, "foveate: everything that defines this run.")
