"""Work of `foveate export`."""

from dataclasses import replace

from foveate.cli.common import check_output
from foveate.cli.export import Export
from foveate.deploy.onnx.export import export
from foveate.errors import InputError
from foveate.experiment.resolve import load


def run(options: Export) -> int:
    """Load, translate, write, and print the inputs and the output."""
    if options.out.suffix.lower() != ".onnx":
        raise InputError(f"{options.out}: expected a name that ends in .onnx")
    check_output(options.out)
    experiment, policy, _ = load(options.run)
    if options.robot is not None:
        experiment = replace(experiment, scenario=experiment.scenario.of_robot(options.robot))
    inputs = export(experiment, policy, options.out, options.opset)
    agent, named = experiment.scenario.problem().agent, [f"{each.name} {_shape(each.shape)}" for each in inputs]
    axes = ", ".join(agent.space.axes[axis] for axis in agent.axes)
    print(f"{options.out}: {', '.join(named)} -> control {_shape(('b', len(agent.axes)))} = {axes} [m/s, rad/s]")
    return 0


def _shape(shape: tuple[str | int, ...]) -> str:
    return f"({', '.join(map(str, shape))})"
