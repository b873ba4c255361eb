"""`foveate export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option


@dataclass(kw_only=True)
class Export(Command):
    """Export a trained policy as an ONNX file, for a robot without JAX.

    The graph takes batches of decisions with any number of targets, in metres in the world frame, and returns commands
    in m/s and rad/s. Its metadata describe inputs and outputs. examples/run_onnx.py runs it with numpy and onnxruntime.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or name of a preset (its trained policy comes with the package)."""
    out: Annotated[tyro.conf.Positional[Path], option("FILE.onnx")]
    """File to write."""
    robot: Annotated[int | None, option("N")] = None
    """Robot of a team of different kinds, by its number from 0: the file is for robots of its kind."""
    opset: int = 17
    """ONNX operator set, 13 to 24: a lower one for an old runtime."""
