"""Files made by hand to break their readers: right where a digest is checked, wrong beyond it."""

import functools
import importlib.util
import io
import json
import re
import runpy
import tomllib
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from foveate.deploy.onnx.export import sealed, to_onnx
from foveate.experiment.checkpoint import VERSION, policy_shape
from foveate.experiment.experiment import Experiment
from foveate.io import npz
from foveate.io.files import content_digest
from foveate.io.toml import digest
from foveate.policies.attention import AttentionSettings

SMALL = Experiment(policy=AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,)))
Rng = np.random.Generator


@functools.cache
def shape() -> Any:
    """Structure of the policy in the checkpoints."""
    return policy_shape(SMALL)


@functools.cache
def checkpoint_parts() -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and header of a valid checkpoint of `SMALL`."""
    leaves = jax.tree_util.tree_leaves_with_path(SMALL.new_policy(jax.random.key(0)))
    named = {
        jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves if eqx.is_array(leaf)
    }
    header = {"format": "foveate-policy", "version": VERSION, "experiment": digest(SMALL), "facts": {"seed": 3}}
    return {name: np.asarray(leaf, np.float32) for name, leaf in named.items()}, header


def packed(arrays: dict[str, np.ndarray], header: dict[str, Any], method: int = zipfile.ZIP_STORED) -> bytes:
    """The file of arrays and header with a right digest, whatever they are."""
    try:
        text = npz._canonical({**header, "digest": npz._digest(arrays, header)})
    except (TypeError, ValueError):  # NaN, or no JSON
        text = json.dumps(header, default=str).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, array in {"header": np.frombuffer(text, np.uint8), **arrays}.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, array, allow_pickle=True)
            archive.writestr(f"{name}.npy", member.getvalue())
    return buffer.getvalue()


def nested(depth: int) -> Any:
    """Lists in one another."""
    value: Any = 1
    for _ in range(depth):
        value = [value]
    return value


VALUES: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    2**70,
    1e300,
    "",
    "x" * 5000,
    "\x00",
    "\ud800",
    [],
    {},
    nested(60),
    nested(400),
)
ARRAYS: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda a: a.astype(complex),
    lambda a: a.astype(str),
    lambda a: a.astype("V8"),
    lambda a: a.astype(object),
    lambda a: a.astype(bool),
    lambda a: a.astype(int),
    lambda a: a.astype(">f8"),
    lambda a: a.astype(np.float16),
    lambda a: a.astype("M8[s]"),
    lambda a: a * np.nan,
    lambda a: a.astype(float) + 1e300,
    lambda a: a + np.float32(np.inf),
    lambda a: a[None],
    lambda a: a.ravel()[:0],
    lambda a: np.asfortranarray(a),
    lambda a: np.zeros((0, 1 << 40), np.float32),
    lambda a: np.array([(1, 2.0)], [("a", int), ("b", float)]),
)


def checkpoint(rng: Rng) -> bytes:
    """A checkpoint with a right digest, of which something else is wrong."""
    arrays, header = (dict(part) for part in checkpoint_parts())
    names = list(arrays)
    for _ in range(int(rng.integers(1, 3))):
        name, kind = names[rng.integers(len(names))], int(rng.integers(6))
        if kind == 0:
            header[["format", "version", "experiment", "facts", "other"][rng.integers(5)]] = VALUES[
                rng.integers(len(VALUES))
            ]
        elif kind == 1:
            header.pop(list(header)[rng.integers(len(header))], None)
        elif kind == 2:
            arrays[name] = ARRAYS[rng.integers(len(ARRAYS))](checkpoint_parts()[0][name])
        elif kind == 3:
            arrays.pop(name, None)
        elif kind == 4:
            arrays[("x/../../y", "extra", "header ", "a" * 5000)[rng.integers(4)]] = np.ones(2, np.float32)
        elif not header:
            header = {"format": "foveate-policy"}
    method = zipfile.ZIP_DEFLATED if rng.random() < 0.05 else zipfile.ZIP_STORED
    return packed(arrays, header, method)


def overlapping(count: int = 1500, size: int = 1 << 20) -> bytes:
    """An archive whose members are the same bytes, so that it unpacks to `count` times its size."""
    member = io.BytesIO()
    np.lib.format.write_array(member, np.zeros(size, np.uint8))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.npy", member.getvalue())
        entry = archive.infolist()[0]
        for i in range(count):
            again = zipfile.ZipInfo(f"m{i}.npy")
            for name in ("header_offset", "file_size", "compress_size", "CRC"):
                setattr(again, name, getattr(entry, name))
            archive.filelist.append(again)
    return buffer.getvalue()


def toml(data: bytes) -> bytes:
    """A configuration after a change, with its digest made again where it can be read."""
    if data.count(b".") > 1000:  # tomllib holds every beginning of a dotted key: 20 GB of 1 MB of dots
        return data
    try:
        table = tomllib.loads(data.decode())
        seal = content_digest(table)[:16]
    except (ValueError, TypeError, RecursionError):  # no TOML, or what JSON has not: infinity, dates
        return data
    return f'digest = "{seal}"\nformat = "foveate-experiment"\nversion = 1\n'.encode() + data


def onnx_policy() -> bytes:
    """The policy of `SMALL` as an ONNX file."""
    return sealed(to_onnx(SMALL, SMALL.new_policy(jax.random.key(0))))


@functools.cache
def onnx_reader() -> Any:
    """What robots read ONNX files with, if onnx is installed."""
    if importlib.util.find_spec("onnx") is None or importlib.util.find_spec("onnxruntime") is None:
        return None
    import onnxruntime

    onnxruntime.set_default_logger_severity(4)  # what it cannot load it also prints
    return runpy.run_path(str(Path(__file__).parents[2] / "examples" / "run_onnx.py"))["OnnxPolicy"]


def onnx(data: bytes) -> bytes:
    """An ONNX file after a change, with its digest made again where it has one."""
    found = re.findall(rb"sha256\x12\x40([0-9a-f]{64})", data)
    if not found:
        return data
    blank = data.replace(found[-1], b"0" * 64)
    return blank.replace(b"0" * 64, sha256(blank).hexdigest().encode())
