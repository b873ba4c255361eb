"""Named arrays with a header in one `.npz` file: no pickled code, damage is detected."""

import hashlib
import io
import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from foveate.errors import InputError
from foveate.io.files import check_format, file_error, read_bytes, write_atomic
from foveate.io.strict_json import parse_json

_HEADER, _DIGEST = "header", "digest"
_SHAPE_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def save_arrays(path: str | Path, arrays: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Write arrays and header, atomically; the same content gives the same bytes.

    The header is any JSON object with "format": "foveate-<kind>" and "version": a whole number of 1 or more. Raises
    InputError for another header, for arrays that would be read back differently (objects, records, bfloat16) and for
    reserved names ("header" in `arrays`, "digest" in `header`).
    """
    _check(path, arrays, header)
    try:
        text = _canonical({**header, _DIGEST: _digest(arrays, header)})
    except ValueError as error:
        raise file_error(path, f"the header cannot be written: {error}") from error
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, array in {_HEADER: np.frombuffer(text, np.uint8), **arrays}.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(array, order="C"), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), member.getvalue())
    write_atomic(path, buffer.getvalue())


def load_arrays(path: str | Path, kind: str, newest: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read the header and arrays of a `save_arrays` file of format "foveate-<kind>" and version 1 to `newest`.

    Raises InputError of one line, naming the file, for anything else. Python objects are never unpickled.
    """
    data = read_bytes(path, f"{kind} file")
    if not data.startswith(b"PK"):
        raise file_error(path, f"is not an .npz archive; give a {kind} file that foveate wrote")
    try:
        arrays = _members(data)
        header = parse_json(arrays.pop(_HEADER).tobytes().decode()) if _HEADER in arrays else None
    except Exception as error:  # readers of a hostile or broken archive raise nearly anything
        problem = f"is cut short or damaged ({type(error).__name__}: {error})"
        raise file_error(path, f"{problem}; give a {kind} file as foveate wrote it") from error
    if not isinstance(header, dict):
        raise file_error(path, f"has no header; give a {kind} file that foveate wrote")
    recorded = header.pop(_DIGEST, None)
    check_format(path, header, kind, newest)
    if recorded != _digest(arrays, header):
        raise file_error(path, f"is damaged: its content is not what was written; give an intact {kind} file")
    return header, arrays


def _members(data: bytes) -> dict[str, np.ndarray]:
    """Arrays of an archive; each is read to its end, which verifies its checksum, before it is parsed."""
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        # Members may overlap: a small file could hold a large one many times.
        if sum(member.file_size for member in members) > len(data):
            raise InputError("its members are larger than the file")
        for member in members:
            name, suffix = member.filename[:-4], member.filename[-4:]
            # Uncompressed members only: a small file cannot unpack to a huge one.
            is_plain = member.compress_type == zipfile.ZIP_STORED and member.compress_size == member.file_size
            if suffix != ".npy" or name in arrays or not is_plain:
                raise InputError(f"strange member {member.filename!r:.60}")
            arrays[name] = _array(archive.read(member))
    return arrays


def _array(data: bytes) -> np.ndarray:
    """Array of a member, whose own header must state the bytes that follow it: nothing larger is ever made."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    if version not in _SHAPE_READERS:
        raise InputError(f"an array of version {version}")
    shape, is_fortran, dtype = _SHAPE_READERS[version](file)
    if dtype.kind in "OV":
        raise InputError(f"an array of type {dtype}")
    if math.prod(shape) * dtype.itemsize != len(data) - file.tell():
        raise InputError(f"an array of {shape} {dtype}, which is not as long")
    return np.ndarray(shape, dtype, data, file.tell(), order="F" if is_fortran else "C").copy(order="K")


def _check(path: str | Path, arrays: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Raise InputError for a header that `load_arrays` would reject, or arrays that it would read back differently."""
    kind, version = header.get("format"), header.get("version")
    if not isinstance(kind, str) or not kind.startswith("foveate-"):
        raise file_error(path, f"header format {kind!r}; expected 'foveate-' and the kind of file")
    if type(version) is not int or version < 1:
        raise file_error(path, f"header version {version!r}; expected a whole number of 1 or more")
    if _DIGEST in header:
        raise file_error(path, f"the header's key {_DIGEST!r} is taken; choose another name")
    for name, array in arrays.items():
        if name == _HEADER or "\0" in name:
            raise file_error(path, f"an array cannot be named {name!r}; choose another name")
        if array.dtype.kind in "OV" or np.dtype(array.dtype.str) != array.dtype:
            right = "expected a plain number or text type, as float32"
            raise file_error(path, f"the array {name!r} has the type {array.dtype}; {right}")


def _canonical(header: dict[str, Any]) -> bytes:
    """Header as JSON, the same for the same content. Raises ValueError on NaN and infinity."""
    return json.dumps(header, sort_keys=True, allow_nan=False).encode()


def _digest(arrays: dict[str, np.ndarray], header: dict[str, Any]) -> str:
    """SHA-256 of the header and of every array's name, dtype, shape and bytes."""
    total = hashlib.sha256(_canonical(header))
    for name in sorted(arrays):
        total.update(json.dumps([name, arrays[name].dtype.str, arrays[name].shape]).encode())
        total.update(arrays[name].tobytes())
    return total.hexdigest()
