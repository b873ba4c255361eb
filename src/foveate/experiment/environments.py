"""Environments in JAX by the names of scenarios."""

from pathlib import Path

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import experiment_from
from foveate.names import ProtocolName
from foveate.scenario.scenario import Scenario
from foveate.simulation.environment import Environment
from foveate.simulation.records import PROTOCOLS


def environment(
    scenario: Scenario | Experiment | str | Path = "paper", *, protocol: ProtocolName = "true", noise: bool = True
) -> Environment:
    """Make the environment of a scenario as pure functions, for learners in JAX: `reset(key)` and `step`.

    Args:
        scenario: Scenario, experiment, name of a preset, TOML file or run folder.
        protocol: Information from the paper's soft view (surrogate), or from real measurements (true).
        noise: Sample process and measurement noise; without it, only "surrogate" is possible.

    Raises:
        InputError: An argument is invalid, or a file is damaged.
    """
    if protocol not in PROTOCOLS:
        raise InputError(f"protocol {protocol!r}: expected {' or '.join(PROTOCOLS)}")
    chosen = experiment_from(scenario).scenario
    return Environment(chosen.problem(), chosen.scenes, PROTOCOLS[protocol], noise)
