"""Parts that both kinds of Gymnasium environment share: checked options, simulation, spaces, seeds."""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jaxtyping import Key

from foveate.errors import InputError
from foveate.experiment.resolve import experiment_from
from foveate.names import ProtocolName
from foveate.policies.inputs import Features, Frame, Scale, masked_features
from foveate.scenario.scenario import Scenario
from foveate.simulation.batch import Batch, CompiledEnvironments
from foveate.simulation.environment import Environment
from foveate.simulation.records import PROTOCOLS, Observation
from foveate.types import Scalar

BOUND = np.finfo(np.float32).max
"""Bound of observed numbers without one: checkers of environments complain of infinite bounds."""


@dataclass(frozen=True)
class TaskSettings:
    """Options of `gymnasium.make`: scenario, protocol and observation of an environment.

    `protocol` is the source of information (`true`: only targets really in view); without `noise` an episode is that of
    the paper's training, which only `surrogate` allows. The reward is the growth of the mean log det per target [nat].
    The `horizon` ends an episode as `truncated`, or as `terminated`, after which nothing has value, for learners of the
    score at the horizon itself. `observation` is a dict of arrays or one flat row of the same numbers: see
    `policies.inputs`, whose options are `frame`, `information` and `length_m` (None: the depth of the view).
    """

    scenario: Scenario | str | Path = "paper"
    _: KW_ONLY
    protocol: ProtocolName = "true"
    noise: bool = True
    horizon: Literal["truncated", "terminated"] = "truncated"
    observation: Literal["dict", "flat"] = "dict"
    frame: Frame = "body"
    information: Scale = "asinh"
    length_m: float | None = None

    def __post_init__(self) -> None:
        choices = {
            "protocol": ("true", "surrogate"),
            "horizon": ("truncated", "terminated"),
            "observation": ("dict", "flat"),
            "frame": ("body", "world"),
            "information": ("asinh", "plain"),
        }
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise InputError(f"{name} = {getattr(self, name)!r}: expected {' or '.join(map(repr, known))}")
        if self.length_m is not None and not self.length_m > 0:
            raise InputError(f"length_m = {self.length_m}: expected > 0")


@functools.lru_cache(maxsize=8)
def _programs(
    scenario: Scenario, protocol: str, noise: bool, inputs: tuple[Frame, float, Scale], count: int
) -> CompiledEnvironments:
    """One compilation for all environments with these options."""
    problem, (frame, length_m, information) = scenario.problem(), inputs
    environment = Environment(problem, scenario.scenes, PROTOCOLS[protocol], noise)

    def features(observation: Observation, left: Scalar) -> Features:
        return masked_features(observation, left, problem.agent.space, frame, length_m, information)

    return CompiledEnvironments(environment, features, count)


class Task:
    """A batch of `count` environments and their spaces; with `autoreset` the next episode begins by itself."""

    def __init__(self, settings: TaskSettings, count: int, autoreset: bool) -> None:
        scenario = experiment_from(settings.scenario).scenario
        if settings.frame == "body" and not scenario.problem().motion.begins_with_position:
            raise InputError("frame = 'body': expected targets whose state begins with the position: take 'world'")
        length_m = float(scenario.view.depth_m) if settings.length_m is None else settings.length_m
        inputs = (settings.frame, length_m, settings.information)
        programs = _programs(scenario, settings.protocol, settings.noise, inputs, count)
        self.settings, self.scenes, self.problem = settings, scenario.scenes, programs.environment.problem
        self.batch = Batch(programs, autoreset)
        self.observation_space = _space(programs.observed, settings.observation == "flat")
        self.action_space = spaces.Box(-1.0, 1.0, (self.batch.axes,), np.float32)

    def observation(self, seen: Features, index: int | None = None) -> dict[str, np.ndarray] | np.ndarray:
        """Observation in the form that the settings ask for, of all environments or of one."""
        if self.settings.observation == "flat":
            parts = [x.reshape(len(x), -1) if index is None else x[index].ravel() for x in seen]
            return np.concatenate(parts, axis=-1)
        return {name: x if index is None else x[index] for name, x in seen._asdict().items()}

    def targets(self, options: Mapping[str, Any]) -> np.ndarray:
        """Number of targets of each of the next episodes, 0 where it is random.

        Raises InputError for unknown options, and numbers that the scenario does not allow.
        """
        if unknown := sorted(set(options) - {"targets", "reset_mask"}):
            raise InputError(f"options[{unknown[0]!r}]: expected 'targets', or 'reset_mask' of a vector environment")
        asked = options.get("targets")
        if asked is None:
            return np.zeros(self.batch.count, np.int32)
        low, high = self.scenes.targets_min, self.scenes.targets_max
        numbers = np.broadcast_to(np.asarray(asked), (self.batch.count,))
        if numbers.dtype.kind not in "iu" or not ((numbers >= low) & (numbers <= high)).all():
            raise InputError(f"options['targets'] = {asked!r}: expected whole numbers from {low} to {high}")
        return numbers.astype(np.int32)

    def actions(self, actions: Any) -> np.ndarray:
        """Actions (b, m) as a float32 array. Raises InputError for another shape, and numbers that are not finite."""
        array, shape = np.asarray(actions, np.float32), (self.batch.count, self.batch.axes)
        if array.shape != shape:
            raise InputError(f"actions have shape {array.shape}: expected {shape}")
        if not np.isfinite(array).all():
            raise InputError("actions: expected finite numbers")
        return array

    def ends(self, done: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`terminated` and `truncated`, of which the settings choose one for the end at the horizon."""
        neither = np.zeros_like(done)
        return (done, neither) if self.settings.horizon == "terminated" else (neither, done)


def keys_of(seeds: Sequence[int | None], rng: np.random.Generator) -> Key[jax.Array, " b"]:
    """A key for each seed, any whole number from 0; one from `rng` for None."""
    own_seeds = rng.integers(2**63, size=len(seeds)).tolist()
    # SeedSequence spreads seeds of any size, and close ones, over all bits; a key has only 64 of them.
    states = [np.random.SeedSequence(own if seed is None else seed) for seed, own in zip(seeds, own_seeds, strict=True)]
    words = np.stack([state.generate_state(2, np.uint32) for state in states])
    return jax.random.wrap_key_data(jnp.asarray(words), impl="threefry2x32")


def _space(seen: Features, flat: bool) -> spaces.Space:
    shapes: dict[str, tuple[int, ...]] = {name: x.shape[1:] for name, x in seen._asdict().items()}
    if flat:
        return _box((sum(map(math.prod, shapes.values())),))
    boxes: dict[str, spaces.Space] = {name: _box(shape) for name, shape in shapes.items()}
    for name in ("mask", "left"):
        boxes[name] = spaces.Box(0.0, 1.0, shapes[name], np.float32)
    return spaces.Dict(boxes)


def _box(shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(-BOUND, BOUND, shape, np.float32)
