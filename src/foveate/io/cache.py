"""Jobs whose results are kept: each in a file, under a key that digests all that the result depends on."""

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
class Job(Generic[T]):
    """A result that is computed once and kept in a file: of arrays by name if it ends in .npz, else of JSON.

    `key` is asked for when the job's turn comes, since it may depend on files of earlier jobs. `encode` gives what the
    file holds, and `decode` the result again; it raises ValueError, KeyError or TypeError for content that is not as it
    was written. A file that is `optional` may fail to be written, with a warning.
    """

    path: Path
    label: str = ""
    kind: str
    version: int
    key: Callable[[], str]
    compute: Callable[..., T]
    encode: Callable[[T], Any]
    decode: Callable[[Any], T]
    optional: bool = False

    def result(self, *given: Any, on_rejected: Callable[[str], None] = lambda line: None) -> T:
        """The kept result, or else that of `compute(*given)`, which is kept.

        `on_rejected` takes a line about a file that is damaged or was made under another key.
        """
        key = self.key()
        if self.path.exists():
            try:
                return self._load(key)
            except (ValueError, KeyError, TypeError) as error:
                line = str(error) if isinstance(error, ValueError) else f"{self.path}: holds something else"
                on_rejected(f"{line}: computed again")
                if not self.optional:
                    # Else an interrupted computation could complete what a decode misses beside the old file.
                    self.path.unlink()
        result = self.compute(*given)
        try:
            self._save(key, self.encode(result))
        except OSError as error:
            if not self.optional:
                raise
            warnings.warn(f"{self.path}: not kept: {error.strerror or error}", stacklevel=2)
        return result

    def _load(self, key: str) -> T:
        if self.path.suffix == ".npz":
            header, content = load_arrays(self.path, self.kind, self.version)
            kept_key = header.get("content")
        else:
            document = read_document(self.path, self.kind, self.version, f"{self.kind} file")
            kept_key, content = document.get("key"), document.get("result")
        if kept_key != key:
            raise InputError(f"{self.path}: was made with other settings, or by another version")
        return self.decode(content)

    def _save(self, key: str, content: Any) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.suffix == ".npz":
            header = {"format": f"foveate-{self.kind}", "version": self.version, "content": key}
            save_arrays(self.path, content, header)
        else:
            write_document(self.path, self.kind, self.version, {"key": key, "result": content})
