"""Jobs with cached results: each result in a file, under a key that digests everything it depends on."""

import os
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
    """A result that is computed once and cached: as named arrays if `path` ends in .npz, otherwise as JSON.

    `key` is evaluated when the job runs, since it may depend on files of earlier jobs. `encode` turns a result into the
    file's content, and `decode` turns it back, raising ValueError, LookupError, TypeError or ArithmeticError for
    unexpected content. If an `optional` file cannot be written, the job only warns.
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
        """Return the cached result, or compute it from `given` and cache it.

        `on_rejected` receives a line about a file that is damaged or has another key.
        """
        key = self.key()
        if os.path.exists(self.path):  # unlike Path.exists, False in a folder that this user may not enter
            try:
                return self._load(key)
            except (ValueError, LookupError, TypeError, ArithmeticError) as error:
                line = str(error) if isinstance(error, ValueError) else f"{self.path}: holds something else"
                on_rejected(f"{line}: computed again")
                if not self.optional:
                    # Otherwise an interrupted computation could add what `decode` misses, beside the old file.
                    self.path.unlink()
        result = self.compute(*given)
        try:
            self._save(key, self.encode(result))
        except (OSError, InputError) as error:
            if not self.optional:
                raise
            warnings.warn(f"{self.path}: not kept: {getattr(error, 'strerror', None) or error}", stacklevel=2)
        return result

    def _load(self, key: str) -> T:
        if self.path.suffix == ".npz":
            header, content = load_arrays(self.path, self.kind, self.version)
            cached_key = header.get("content")
        else:
            document = read_document(self.path, self.kind, self.version, f"{self.kind} file")
            cached_key, content = document.get("key"), document.get("result")
        if cached_key != key:
            raise InputError(f"{self.path}: was made with other settings, or by another version")
        return self.decode(content)

    def _save(self, key: str, content: Any) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.suffix == ".npz":
            header = {"format": f"foveate-{self.kind}", "version": self.version, "content": key}
            save_arrays(self.path, content, header)
        else:
            write_document(self.path, self.kind, self.version, {"key": key, "result": content})
