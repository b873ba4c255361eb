"""Poses from which a replay starts, outside of obstacles."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.io.validate import check_count
from foveate.recordings.maps import free_start, require_free
from foveate.recordings.recording import Recording
from foveate.scenario.scenario import Scenario


def agent_starts(
    recording: Recording, scenario: Scenario, given: Sequence[float] | None, count: int, seed: int
) -> list[list[float]]:
    """The given pose, several random ones, or the middle of the recording.

    Raises InputError for another pose, or one in an obstacle; those that are not given are moved to a free place.
    """
    check_count(count, "starts")
    if given is None and count > 1:
        return random_agent_starts(recording, scenario, count, seed)
    if given is None:
        return [default_agent_start(recording, scenario)]
    if count > 1:
        raise InputError("agent_start and starts: expected one of them")
    numbers = [float(number) for number in given]
    try:
        scenario.agent.agent().space.from_numbers(numbers)
    except InputError as error:
        raise InputError(f"agent_start {','.join(f'{number:g}' for number in numbers)}: {error}") from None
    if recording.origin is not None and not recording.origin.in_degrees:
        numbers[: recording.dimension] = np.subtract(
            numbers[: recording.dimension], recording.origin.position_m
        ).tolist()
    name = f"agent_start {','.join(f'{number:g}' for number in given)}"
    require_free(scenario.problem().obstacles, np.array(numbers[: recording.dimension]), name)
    return [numbers]


def default_agent_start(recording: Recording, scenario: Scenario) -> list[float]:
    """Start in the middle of the recording's extent, or at the nearest free place, heading along x."""
    lower, upper = recording.extent
    return _upright(scenario, free_start(scenario.problem().obstacles)((lower + upper) / 2), 0.0)


def random_agent_starts(recording: Recording, scenario: Scenario, count: int, seed: int) -> list[list[float]]:
    """Draw starts uniform in the recording's extent, or at the nearest free places, with any heading."""
    rng, freed = np.random.default_rng([seed, count]), free_start(scenario.problem().obstacles)
    return [_upright(scenario, freed(rng.uniform(*recording.extent)), rng.uniform(-np.pi, np.pi)) for _ in range(count)]


def _upright(scenario: Scenario, position_world: np.ndarray, yaw: float) -> list[float]:
    space = scenario.agent.agent().space
    return space.to_numbers(space.upright(jnp.asarray(position_world, float), jnp.asarray(yaw)))
