"""List the measurements of `foveate bench`."""

from collections.abc import Callable

from foveate.bench.decisions import jax_decisions, onnx_decisions
from foveate.bench.processes import starting, whole_training
from foveate.bench.simulation import environments, planning, simulation
from foveate.bench.timing import Metric
from foveate.bench.training import compilation_counts, training_step
from foveate.experiment.presets import PRESETS
<<<<<<< HEAD
from foveate.learning.devices import on_all_devices, sharded
from foveate.learning.gradient import mean_and_gradient
from foveate.learning.loop import QUICKLY, advance_of, train
from foveate.learning.policy_gradient import begin, micro_batch_size
from foveate.models.problem import Problem, first_information
from foveate.planning.information import Future
from foveate.planning.shooting import OMNISCIENT, plan
from foveate.policies.attention import AttentionPolicy
from foveate.policies.inputs import policy_features
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.batch import Batch, Programs
from foveate.simulation.environment import Environment
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, SURROGATE, Episode, Observation, Policy
from foveate.simulation.rollout import rollout
from foveate.simulation.suites import own_suite, scene_episodes
=======
>>>>>>> w-learn

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
