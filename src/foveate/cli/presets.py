"""`foveate presets`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option


@dataclass(kw_only=True)
class Presets(Command):
    """List the presets, whose trained policies come with the package, or print the model cards of some.

    A preset's name can be given wherever a command takes a run.

      foveate presets
      foveate presets true-view
    """

    preset: Annotated[tyro.conf.Positional[tuple[str, ...]], option("[NAME ..]")] = ()
    """Presets whose model card to print: data, scores, limits, size and licence."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the cards as JSON."""
