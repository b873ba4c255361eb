"""List the measurements of `foveate bench`."""

from collections.abc import Callable

from foveate.bench.decisions import jax_decisions, onnx_decisions
from foveate.bench.processes import starting, whole_training
from foveate.bench.simulation import environments, planning, simulation
from foveate.bench.timing import Metric
from foveate.bench.training import compilation_counts, training_step
from foveate.experiment.presets import PRESETS

Measurement = tuple[str, Callable[[int], list[Metric]]]
"""A title, and the function that measures with a number of repeats."""


def measurements(sizes: tuple[int, ...], quick: bool) -> list[Measurement]:
    """All measurements in order; `sizes` are episodes of a training step."""
    paper = PRESETS["paper"]
    training: list[Measurement] = [
        (f"training step, {size} episodes", lambda repeats, size=size: training_step(paper, size, repeats))
        for size in sizes
    ]
    rest: list[Measurement] = [
        ("simulation", lambda repeats: simulation(paper, repeats)),
        ("environments", lambda repeats: environments(paper, repeats)),
        ("decisions by JAX", lambda repeats: jax_decisions(paper, repeats)),
        ("decisions by ONNX Runtime", lambda repeats: onnx_decisions(paper, repeats)),
        ("planning", lambda repeats: planning(paper, repeats)),
        ("compilations of a training", lambda repeats: compilation_counts(paper)),
        ("start of the command line", starting),
    ]
    if not quick:
        rest.append(("the paper's training, from command to checkpoint", lambda repeats: whole_training()))
    return training + rest
