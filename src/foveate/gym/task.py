"""What both kinds of Gymnasium environment are made of: checked options, simulation, spaces, seeds."""

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
from foveate.policies.inputs import Features, Frame, Scale, policy_features
from foveate.scenario.scenario import Scenario
from foveate.simulation.batch import Batch, Programs
from foveate.simulation.environment import Environment
from foveate.simulation.records import PROTOCOLS, Observation
from foveate.types import Scalar

LARGEST = np.finfo(np.float32).max
"""The bound of numbers that have none: infinite ones are what checkers of environments complain of."""


@dataclass(frozen=True)
class TaskSettings:
    """What an environment is made of, and what its agent is told: the options of `gymnasium.make`.

    `protocol` says where information comes from (`true`: only from targets really in view); without `noise` an episode
    is that of the paper's training, which only `surrogate` allows. The reward is the growth of the mean log det per
    target [nat]. The `horizon` ends an episode as `truncated`, or `terminated` for who is after the score at the
    horizon itself, so that nothing is worth anything after it. `observation` is a dict of arrays or one flat row of the
    same numbers: see `policies.inputs`, of which `frame`, `information` and `length_m` (None: the view's depth) are
    the options.
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
def _programs(scenario: Scenario, protocol: str, noise: bool, look: tuple[Frame, float, Scale], count: int) -> Programs:
    """One compilation for all environments that are alike."""
    problem, (frame, length_m, information) = scenario.problem(), look
    environment = Environment(problem, scenario.scenes, PROTOCOLS[protocol], noise)

    def seen(observation: Observation, left: Scalar) -> Features:
        return policy_features(observation, left, problem.agent.space, frame, length_m, information)

    return Programs(environment, seen, count)


class Task:
    """The environments that settings mean, side by side, with their spaces."""

    def __init__(self, settings: TaskSettings, count: int, anew: bool) -> None:
        scenario = experiment_from(settings.scenario).scenario
        if settings.frame == "body" and not scenario.problem().motion.begins_with_position:
            raise InputError("frame = 'body': expected targets whose state begins with the position: take 'world'")
        length_m = float(scenario.view.depth_m) if settings.length_m is None else settings.length_m
        look = (settings.frame, length_m, settings.information)
        programs = _programs(scenario, settings.protocol, settings.noise, look, count)
        self.settings, self.scenes, self.problem = settings, scenario.scenes, programs.environment.problem
        self.batch = Batch(programs, anew)
        self.observation_space = _space(programs.seen, settings.observation == "flat")
        self.action_space = spaces.Box(-1.0, 1.0, (self.batch.axes,), np.float32)

    def shown(self, seen: Features, index: int | None = None) -> dict[str, np.ndarray] | np.ndarray:
        """What is seen as the settings want it, of all environments or of one."""
        if self.settings.observation == "flat":
            parts = [x.reshape(len(x), -1) if index is None else x[index].ravel() for x in seen]
            return np.concatenate(parts, axis=-1)
        return {name: x if index is None else x[index] for name, x in seen._asdict().items()}

    def targets(self, options: Mapping[str, Any]) -> np.ndarray:
        """How many targets each of the next episodes shall have, 0 where that is drawn. Raises ValueError for options
        that are not known, and numbers that the scenario does not allow."""
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
        """Checked, with an axis of environments."""
        array, shape = np.asarray(actions, np.float32), (self.batch.count, self.batch.axes)
        if array.shape != shape:
            raise InputError(f"actions have shape {array.shape}: expected {shape}")
        if not np.isfinite(array).all():
            raise InputError("actions: expected finite numbers")
        return array

    def ends(self, done: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`terminated` and `truncated`."""
        never = np.zeros_like(done)
        return (done, never) if self.settings.horizon == "terminated" else (never, done)


def keys_of(seeds: Sequence[int | None], chance: np.random.Generator) -> Key[jax.Array, " b"]:
    """A key for each seed, any whole number from 0; where there is none it is drawn."""
    drawn = chance.integers(2**63, size=len(seeds)).tolist()
    states = [np.random.SeedSequence(own if seed is None else seed) for seed, own in zip(seeds, drawn, strict=True)]
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
    return spaces.Box(-LARGEST, LARGEST, shape, np.float32)
