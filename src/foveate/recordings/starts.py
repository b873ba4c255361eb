"""Poses from which a replay starts, outside of obstacles: those of all robots of a team, one after another."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.io.validate import check_count
from foveate.recordings.maps import free_start, require_free
from foveate.recordings.recording import Recording
from foveate.recordings.team import STREAM
from foveate.scenario.scenario import Scenario


def agent_starts(
    recording: Recording, scenario: Scenario, given: Sequence[float] | None, count: int, seed: int
) -> list[list[float]]:
    """The given pose, several random ones, or the middle of the recording; of a team, poses of all robots.

    The robots of a team after the first start at random places unless their poses are given, too. Raises InputError for
    another pose, or one in an obstacle; those that are not given are moved to a free place.
    """
    check_count(count, "starts")
    if given is None and count > 1:
        return random_agent_starts(recording, scenario, count, seed)
    if given is None:
        return [default_agent_start(recording, scenario, seed)]
    if count > 1:
        raise InputError("agent_start and starts: expected one of them")
    numbers = [float(number) for number in given]
    robots = _robots(scenario)
    size = len(_upright(scenario, np.zeros(scenario.dimension), 0.0))
    if robots == 1 or len(numbers) != robots * size:
        numbers = _given_start(recording, scenario, numbers)
        return [numbers + _mates(recording, scenario, seed, 0)]
    return [[x for i in range(robots) for x in _given_start(recording, scenario, numbers[i * size : (i + 1) * size])]]


def _given_start(recording: Recording, scenario: Scenario, numbers: list[float]) -> list[float]:
    """A robot's pose in the frame of the replay. Raises InputError unless it is one, outside of obstacles."""
    text = f"agent_start {','.join(f'{number:g}' for number in numbers)}"
    try:
        scenario.agent.agent().space.from_numbers(numbers)
    except InputError as error:
        also = f", or the poses of all {robots} robots" if (robots := _robots(scenario)) > 1 else ""
        raise InputError(f"{text}: {error}{also}") from None
    place = np.array(numbers[: recording.dimension])
    if recording.origin is not None and not recording.origin.in_degrees:
        place = place - recording.origin.position_m
    require_free(scenario.problem().obstacles, place, text)
    return [*place.tolist(), *numbers[recording.dimension :]]


def default_agent_start(recording: Recording, scenario: Scenario, seed: int = 0) -> list[float]:
    """Start in the middle of the recording's extent, or at the nearest free place, heading along x."""
    lower, upper = recording.extent
    first = _upright(scenario, free_start(scenario.problem().obstacles)((lower + upper) / 2), 0.0)
    return first + _mates(recording, scenario, seed, 0)


def random_agent_starts(recording: Recording, scenario: Scenario, count: int, seed: int) -> list[list[float]]:
    """Draw starts uniform in the recording's extent, or at the nearest free places, with any heading."""
    first = _random_poses(recording, scenario, count, np.random.default_rng([seed, count]))
    return [own + _mates(recording, scenario, seed, i) for i, own in enumerate(first)]


def _robots(scenario: Scenario) -> int:
    return 1 if scenario.team is None else scenario.team.agents


def _mates(recording: Recording, scenario: Scenario, seed: int, start: int) -> list[float]:
    """Random poses of the robots after the first, for one of several starts; none of a single robot."""
    if _robots(scenario) == 1:
        return []
    rng = np.random.default_rng([seed, start, STREAM])
    return [x for pose in _random_poses(recording, scenario, _robots(scenario) - 1, rng) for x in pose]


def _random_poses(recording: Recording, scenario: Scenario, count: int, rng: np.random.Generator) -> list[list[float]]:
    freed = free_start(scenario.problem().obstacles)
    return [_upright(scenario, freed(rng.uniform(*recording.extent)), rng.uniform(-np.pi, np.pi)) for _ in range(count)]


def _upright(scenario: Scenario, position_world: np.ndarray, yaw: float) -> list[float]:
    space = scenario.agent.agent().space
    return space.to_numbers(space.upright(jnp.asarray(position_world, float), jnp.asarray(yaw)))
