"""`foveate export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option


@dataclass(kw_only=True)
class Export(Command):
    """Write a trained policy as an ONNX file, for a robot without JAX.

    It takes any number of targets and of decisions at once, in metres and in the world frame, and gives commands in m/s
    and rad/s. Its metadata say what goes in and comes out. examples/run_onnx.py runs it with numpy and onnxruntime.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    out: Annotated[tyro.conf.Positional[Path], option("FILE.onnx")]
    """Where to write it."""
    opset: int = 17
    """ONNX operator set, 13 to 24: a lower one for an old runtime."""
