"""List the measurements of `foveate bench`."""

from collections.abc import Callable
from functools import partial

from foveate.bench.actor_critic import iterations
from foveate.bench.decisions import jax_decisions, onnx_decisions
from foveate.bench.processes import starting, whole_training
from foveate.bench.simulation import environments, evaluation, planning, simulation
from foveate.bench.timing import Metric
from foveate.bench.training import compilation_counts, training_step
from foveate.experiment.presets import PRESETS

Measurement = tuple[str, Callable[[int], list[Metric]]]
"""Title, and function of the number of repeats."""


def measurements(sizes: tuple[int, ...], quick: bool) -> list[Measurement]:
    """Return all measurements in order; `sizes` are episodes of a training step."""
    paper = PRESETS["paper"]
    work: list[Measurement] = [
        *((f"training step, {size} episodes", partial(training_step, paper, size)) for size in sizes),
        ("iterations of the actor-critic", partial(iterations, PRESETS["true-view"])),
        ("simulation", partial(simulation, paper)),
        ("an evaluation", partial(evaluation, "true-view")),
        ("environments", partial(environments, paper)),
        ("decisions by JAX", partial(jax_decisions, paper)),
        ("decisions by ONNX Runtime", partial(onnx_decisions, paper)),
        ("planning", partial(planning, paper)),
        ("compilations of a training", lambda repeats: compilation_counts(paper)),
        ("start of the command line", starting),
    ]
    if not quick:
        work.append(("the paper's training, from command to checkpoint", lambda repeats: whole_training()))
    return work
