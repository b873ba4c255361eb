"""Results that are computed once: each kept in a file under a key, a digest of all that it depends on."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from foveate.errors import InputError
from foveate.io.files import read_document, write_document
from foveate.io.npz import load_arrays, save_arrays

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Entry(Generic[T]):
    """A file that keeps one result: of arrays by name where it ends in .npz, else of JSON.

    `encode` gives what the file holds, and `decode` the result again; it raises ValueError, KeyError or TypeError for
    content that is not as it was written. A file that is `optional` may fail to be written, with a warning.
    """

    path: Path
    kind: str
    version: int
    key: str
    encode: Callable[[T], Any]
    decode: Callable[[Any], T]
    optional: bool = False

    def load_or_compute(self, compute: Callable[[], T], on_rejected: Callable[[str], None] = lambda line: None) -> T:
        """The kept result, or else a computed one, which is kept.

        `on_rejected` takes a line about a file that is damaged or was made under another key.
        """
        if self.path.exists():
            try:
                return self._load()
            except (ValueError, KeyError, TypeError) as error:
                line = str(error) if isinstance(error, ValueError) else f"{self.path}: holds something else"
                on_rejected(f"{line}: computed again")
                if not self.optional:
                    # Else an interrupted computation could complete what a decode misses beside the old file.
                    self.path.unlink()
        result = compute()
        try:
            self._save(self.encode(result))
        except OSError as error:
            if not self.optional:
                raise
            warnings.warn(f"{self.path}: not kept: {error.strerror or error}", stacklevel=2)
        return result

    def _load(self) -> T:
        if self.path.suffix == ".npz":
            header, content = load_arrays(self.path, self.kind, self.version)
            key = header.get("content")
        else:
            document = read_document(self.path, self.kind, self.version, f"{self.kind} file")
            key, content = document.get("key"), document.get("result")
        if key != self.key:
            raise InputError(f"{self.path}: was made with other settings, or by another version")
        return self.decode(content)

    def _save(self, content: Any) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.suffix == ".npz":
            header = {"format": f"foveate-{self.kind}", "version": self.version, "content": self.key}
            save_arrays(self.path, content, header)
        else:
            write_document(self.path, self.kind, self.version, {"key": self.key, "result": content})
