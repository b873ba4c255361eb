"""`foveate export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import option
from foveate.errors import InputError


@dataclass(kw_only=True)
class Export:
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

    def run_command(self) -> int:
        """Load, translate, write, and say what goes in and comes out."""
        from foveate.cli.common import check_output
        from foveate.deploy.onnx.export import export, inputs_of
        from foveate.experiment.resolve import load

        if self.out.suffix.lower() != ".onnx":
            raise InputError(f"{self.out}: expected a name that ends in .onnx")
        check_output(self.out)
        experiment, policy, _ = load(self.run)
        export(experiment, policy, self.out, self.opset)
        problem = experiment.scenario.problem()
        inputs = ", ".join(f"{each.name} {_shape(each.shape)}" for each in inputs_of(policy, problem))
        axes = ", ".join(problem.agent.space.axes[axis] for axis in problem.agent.axes)
        print(f"{self.out}: {inputs} -> control {_shape(('b', len(problem.agent.axes)))} = {axes} [m/s, rad/s]")
        return 0


def _shape(shape: tuple[str | int, ...]) -> str:
    return f"({', '.join(map(str, shape))})"
