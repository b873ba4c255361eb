"""Checkpoints: pytrees of arrays with the digest of their experiment, without pickled code."""

from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate import __version__
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.run_folder import BEST, CONFIG, EXTENDED
from foveate.io.files import read_document, write_document
from foveate.io.npz import load_arrays, save_arrays
from foveate.io.toml import digest, read_toml, save_toml
from foveate.simulation.records import Policy

VERSION = 1
RENAMED = {"returns": "rollbacks"}
"""Current names of arrays by their names in files of earlier versions."""
FORMER_NETWORK = "mode_layers."
"""Part of the names of arrays of the pointer network of version 0.1, which this version does not have."""
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


def load_tree(path: Path, like: T, kind: str, digests: Collection[str] | None = None) -> tuple[T, dict[str, Any]]:
    """Read a saved pytree, in the structure and dtypes of `like`, and its facts.

    Raises InputError for a missing, damaged or newer file, for other shapes and kinds of numbers, for weights that are
    not finite, for a network that is no longer there, and if the experiment's digest is not one of `digests`.
    """
    header, arrays = load_arrays(path, kind, VERSION)
    _check_header(path, header)
    arrays = {RENAMED.get(name, name): array for name, array in arrays.items()}
    if digests is not None and header["experiment"] not in digests:
        raise InputError(f"{path}: belongs to another experiment than the config.toml beside it, which was changed")
    if any(FORMER_NETWORK in name for name in arrays):
        again = f"train again with {path.parents[1] / CONFIG}"
        raise InputError(f"{path}: was trained by an earlier version, whose network is no longer supported; {again}")
    expected = _named(like)
    if missing := sorted(set(expected) - set(arrays)):
        raise InputError(f"{path}: no array {missing[0]!r}: this checkpoint is of another network")
    if extra := sorted(set(arrays) - set(expected)):
        raise InputError(f"{path}: unknown array {extra[0]!r}: this checkpoint is of another network")
    dynamic, static = eqx.partition(like, _is_array)
    # In the dtypes of `like`: a file saved with x64 is read without it, and vice versa.
    leaves = [
        _converted(f"{path}: {name}", arrays[name], leaf, weights=kind == "policy" or "policy." in name)
        for name, leaf in expected.items()
    ]
    return eqx.combine(jax.tree.unflatten(jax.tree.structure(dynamic), leaves), static), header["facts"]


def _check_header(path: Path, header: dict[str, Any]) -> None:
    """Raise InputError unless a header has the facts and the experiment's digest that `save_tree` writes."""
    for name, kind in (("facts", dict), ("experiment", str)):
        if not isinstance(header.get(name), kind):
            raise InputError(f"{path}: its header has no {name}: give a file that foveate wrote")


def stored_facts(path: Path, kind: str) -> dict[str, Any]:
    """Read the facts of a saved tree. Raises as `load_arrays`, and for a header that `save_tree` did not write."""
    header, _ = load_arrays(path, kind, VERSION)
    _check_header(path, header)
    return header["facts"]


def _converted(where: str, array: np.ndarray, like: Any, weights: bool) -> jax.Array:
    """An array in the shape and dtype of `like`. Raises InputError for another shape or kind of number.

    The `weights` of a policy are finite; other numbers, as the best score before the first one, may be infinite, but
    not by the conversion alone.
    """
    if array.shape != like.shape:
        raise InputError(f"{where} has shape {array.shape}: expected {like.shape}, as config.toml says")
    groups = next((kinds for kinds in ("f", "iu", "b") if np.dtype(like.dtype).kind in kinds), "")
    if array.dtype.kind not in groups:
        raise InputError(f"{where} has the type {array.dtype}: expected {np.dtype(like.dtype)}")
    with np.errstate(over="ignore"):
        result = array.astype(like.dtype)
    fits = np.isfinite(result) | ~np.isfinite(array) if groups == "f" else result == array
    if not fits.all():
        raise InputError(f"{where} has a number too large for {result.dtype}: expected one of that type")
    if groups == "f" and weights and not np.isfinite(result).all():
        raise InputError(f"{where} is not finite: expected finite weights")
    return jnp.asarray(result)


def _is_array(leaf: Any) -> bool:
    """True for arrays, and for the shapes and dtypes in place of them."""
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _named(tree: Any) -> dict[str, Any]:
    """Arrays of a pytree by their path, in the order of its leaves."""
    leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(tree, _is_array))
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def policy_shape(experiment: Experiment) -> Policy:
    """The experiment's policy with shapes in place of weights."""
    problem = experiment.scenario.problem()  # its matrices are looked at: not to be traced
    return eqx.filter_eval_shape(lambda key: experiment.new_policy(key, problem), jax.random.key(0))


def load_run(run: Path) -> tuple[Experiment, Policy, dict[str, Any]]:
    """Load the experiment and best policy of a run folder, and the policy's facts. Raises InputError if it cannot."""
    if not run.is_dir():
        raise InputError(f"{run}: no such run folder: expected one of a training, or a preset")
    experiment, config_digest = read_toml(Experiment, run / CONFIG)
    policy, facts = load_tree(run / BEST, policy_shape(experiment), "policy", accepted_digests(run, config_digest))
    return experiment, policy, facts


def write_config(run: Path, experiment: Experiment) -> None:
    """Write the `config.toml` of a run folder."""
    save_toml(experiment, run / CONFIG, "foveate: everything that defines this run.")


def accepted_digests(run: Path, config_digest: str) -> tuple[str, ...]:
    """Digests that checkpoints of a run folder may have: of its config.toml, and of those before it was extended."""
    if not (run / EXTENDED).exists():
        return (config_digest,)
    earlier = read_document(run / EXTENDED, "extension", 1, "record of an extended run").get("experiments")
    if not isinstance(earlier, list) or not all(isinstance(digest, str) for digest in earlier):
        raise InputError(f"{run / EXTENDED}: experiments: expected a list of digests, as foveate wrote it")
    return config_digest, *earlier


def extend_config(run: Path, experiment: Experiment, config_digest: str) -> None:
    """Replace the config.toml of a run folder by that of a longer training, whose checkpoints remain valid.

    A kill between the two writes leaves the run as it was.
    """
    earlier = list(accepted_digests(run, config_digest))
    write_document(run / EXTENDED, "extension", 1, {"experiments": earlier})
    write_config(run, experiment)
