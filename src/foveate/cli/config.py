"""`foveate config`."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from foveate.cli.options import Changes, Command, option


@dataclass(kw_only=True)
class Config(Command):
    """Print an experiment as TOML, to change in an editor and train with.

    It has every key with its value, and no digest, so that any of them may be changed.

      foveate config true-view > mine.toml
      foveate train --config mine.toml --out runs/mine
    """

    experiment: Annotated[tyro.conf.Positional[str], option("PRESET|RUN|FILE.toml")]
    """Preset, run folder or TOML file."""
    set: Changes = ()
    """Settings to replace, as scenario.view.depth_m=5 training.learning_rate=3e-4."""
