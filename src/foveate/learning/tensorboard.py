"""Write TensorBoard events, each at once: a full disk raises here, not in a thread of a writer.

The file is a TFRecord of protocol buffers `Event` (tensorflow/core/util/event.proto). Its four kinds of field are
written here, since the libraries that write them import torch or TensorFlow where these are installed: seconds of every
start.
"""

import os
import socket
import struct
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from foveate.io.files import named

VERSION = "brain.Event:2"
START = b"\x08\x01"
"""Message SessionLog with status START."""
CASTAGNOLI = 0x82F63B78
"""Polynomial of CRC-32C, reflected (RFC 3720, appendix B.4)."""


class Events:
    """Events of one training; for a resumed one, TensorBoard drops the earlier events from `purge_step` on."""

    def __init__(self, folder: Path, purge_step: int = 0) -> None:
        # TensorBoard reads the files of a folder in the order of their names: by second, then by number. A clock that
        # was set back would put a resumed training before what it continues.
        earlier = [path.name.split(".") for path in folder.glob("events.out.tfevents.*")]
        second = max([int(time.time()), *(int(parts[3]) for parts in earlier if parts[3].isdecimal())])
        name = f"events.out.tfevents.{second:010d}.{socket.gethostname()}.{len(earlier):04d}"
        self._path = folder / name
        self._file = open(self._path, "xb")  # noqa: SIM115
        self._write(0, _bytes(3, VERSION.encode()))
        if purge_step:
            self._write(purge_step, _bytes(3, VERSION.encode()))
            self._write(purge_step, _bytes(7, START))

    def __enter__(self) -> "Events":
        return self

    def __exit__(self, *exception: object) -> None:
        with named(self._path):
            self._file.close()

    def add(self, numbers: Mapping[str, float], step: int) -> None:
        """Write the numbers of one step, by name. Raises OSError if the disk is full."""
        with named(self._path):
            for name, value in numbers.items():
                with np.errstate(over="ignore"):  # a number beyond float32 is infinite there
                    scalar = _bytes(1, name.encode()) + _tag(2, 5) + np.array(value, "<f4").tobytes()
                self._write(step, _bytes(5, _bytes(1, scalar)))
            self._file.flush()
            os.fsync(self._file.fileno())

    def _write(self, step: int, what: bytes) -> None:
        event = _tag(1, 1) + struct.pack("<d", time.time()) + _tag(2, 0) + _varint(step) + what
        length = struct.pack("<Q", len(event))
        self._file.write(length + _checksum(length) + event + _checksum(event))


def _tag(field: int, wire_type: int) -> bytes:
    """Head of a field of a protocol buffer; wire types: 0 varint, 1 eight bytes, 2 length and bytes, 5 four bytes."""
    return _varint(field << 3 | wire_type)


def _bytes(field: int, content: bytes) -> bytes:
    return _tag(field, 2) + _varint(len(content)) + content


def _varint(number: int) -> bytes:
    """Seven bits a byte, the lowest first; all bytes but the last have their highest bit set."""
    parts = []
    while number >= 0x80:
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*parts, number])


def _checksum(data: bytes) -> bytes:
    """CRC-32C of a TFRecord: rotated by 15 bits and shifted, so that checksums of checksums work."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ CASTAGNOLI * (crc & 1)
    crc ^= 0xFFFFFFFF
    return struct.pack("<I", ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF)
