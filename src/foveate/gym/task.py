"""Task behind both kinds of Gymnasium environment: validated options, simulation, spaces, seeds."""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jaxtyping import Key

from foveate.errors import InputError
from foveate.experiment.resolve import experiment_from
from foveate.io.jax_settings import forked_error, is_forked
from foveate.io.validate import require
from foveate.names import ProtocolName
from foveate.policies.inputs import Features, Frame, RangedFeatures, Scale, masked_features, with_ranges
from foveate.scenario.scenario import Scenario
from foveate.simulation.batch import Batch, CompiledEnvironments
from foveate.simulation.environment import Environment
from foveate.simulation.records import PROTOCOLS, Observation
from foveate.types import Scalar

BOUND = np.finfo(np.float32).max
"""Bound of unbounded observations: environment checkers reject infinite bounds."""


@dataclass(frozen=True)
class TaskSettings:
    """Options of `gymnasium.make`: scenario, protocol and observation of an environment.

    `protocol` is the source of information (`true`: only targets actually in view); episodes without `noise` are those
    of the paper's training, which only `surrogate` allows. The reward is the growth of the mean log det per target
    [nat]. The `horizon` ends an episode as `truncated`, or as `terminated` for learners of the score at the horizon
    itself: later states have no value. `observation` is a dict of arrays or a flat row of the same numbers (see
    `policies.inputs`), with the options `frame`, `information` and `length_m` (None: the depth of the view). `actions`
    are a number in [-1, 1] per axis ("box"; an agent with `commands` executes the nearest), or the index of one of the
    agent's `commands` ("discrete"). Among obstacles, `rays` > 0 adds so many free ranges to the observation, up to
    twice the depth of the view, and the targets that no obstacle hides.
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
    actions: Literal["box", "discrete"] = "box"
    rays: int = 0

    def __post_init__(self) -> None:
        hints = get_type_hints(type(self))
        for name in ("protocol", "horizon", "observation", "frame", "information", "actions"):
            value, choices = getattr(self, name), get_args(hints[name])
            require(value in choices, name, value, f"expected {' or '.join(map(repr, choices))}")
        fits = isinstance(self.rays, int) and self.rays >= 0
        require(fits, "rays", self.rays, "expected a whole number >= 0")
        require(self.length_m is None or self.length_m > 0, "length_m", self.length_m, "expected > 0")


@functools.lru_cache(maxsize=8)
def _programs(
    scenario: Scenario, protocol: str, noise: bool, inputs: tuple[Frame, float, Scale], rays: int, count: int
) -> CompiledEnvironments:
    """Compile once for all environments with these options."""
    problem, (frame, length_m, information) = scenario.problem(), inputs
    environment = Environment(problem, scenario.scenes, PROTOCOLS[protocol], noise)

    def features(observation: Observation, left: Scalar) -> Features | RangedFeatures:
        seen = masked_features(observation, left, problem.agent.space, frame, length_m, information)
        return with_ranges(seen, observation, rays, 2.0 * float(scenario.view.depth_m)) if rays else seen

    return CompiledEnvironments(environment, features, count)


_spaces: dict[tuple[TaskSettings, int], tuple[spaces.Space, spaces.Space]] = {}
"""Spaces of the environments made in this process, and in the one that it was forked from."""


class Task:
    """A batch of `count` environments and their spaces; with `autoreset` the next episode begins by itself.

    In a fork of a process with JAX nothing can be simulated. A vector environment that made an environment before it
    forked still learns the spaces there, and its user the error of the first reset: an error here only ends the worker.
    """

    def __init__(self, settings: TaskSettings, count: int, autoreset: bool) -> None:
        self._batch: Batch | None = None
        if is_forked():
            if (settings, count) not in _spaces:
                raise forked_error("environments")
            self.observation_space, self.action_space = _spaces[settings, count]
            return
        self._prepare(settings, count, autoreset)
        _spaces[settings, count] = self.observation_space, self.action_space

    def _prepare(self, settings: TaskSettings, count: int, autoreset: bool) -> None:
        scenario = experiment_from(settings.scenario).scenario
        if settings.frame == "body" and not scenario.problem().motion.begins_with_position:
            raise InputError("frame = 'body': expected targets whose state begins with the position: take 'world'")
        length_m = float(scenario.view.depth_m) if settings.length_m is None else settings.length_m
        inputs = (settings.frame, length_m, settings.information)
        programs = _programs(scenario, settings.protocol, settings.noise, inputs, settings.rays, count)
        # With the scenario itself, as the path of a file may mean another file where a copy of the task is made.
        self.settings, self.scenes = replace(settings, scenario=scenario), scenario.scenes
        self.problem, self._batch = programs.environment.problem, Batch(programs, autoreset)
        self.observation_space = _space(programs.observed, settings.observation == "flat")
        self.action_space = spaces.Box(-1.0, 1.0, (self.batch.axes,), np.float32)
        self._commands: np.ndarray | None = None
        if settings.actions == "discrete":
            agent = self.problem.agent
            if agent.commands is None:
                raise InputError("actions = 'discrete': expected a scenario whose agent has commands")
            self._commands = np.asarray(jax.vmap(agent.action)(agent.commands), np.float32)
            self.action_space = spaces.Discrete(len(self._commands))

    @property
    def batch(self) -> Batch:
        """The environments side by side. Raises InputError in a fork."""
        if self._batch is None:
            raise forked_error("environments")
        return self._batch

    def __reduce__(self) -> tuple[Any, ...]:
        # Compiled programs are made again; the episodes continue.
        return _restored, (self.settings, self.batch.count, self.batch.autoreset, self.batch.packed())

    def observation(
        self, seen: Features | RangedFeatures, index: int | None = None
    ) -> dict[str, np.ndarray] | np.ndarray:
        """Observation in the form of the settings, of all environments or one."""
        if self.settings.observation == "flat":
            parts = [x.reshape(len(x), -1) if index is None else x[index].ravel() for x in seen]
            return np.concatenate(parts, axis=-1)
        return {name: x if index is None else x[index] for name, x in seen._asdict().items()}

    @property
    def contacts(self) -> dict[str, np.ndarray]:
        """Steps of each environment's episode that an obstacle has ended, for infos; empty without obstacles."""
        assert self.batch.transition is not None, "the batch has stepped"
        count = self.batch.transition.state.contacts
        return {} if count is None else {"contacts": np.array(count)}

    def targets(self, options: Mapping[str, Any]) -> np.ndarray:
        """Number of targets of each environment's next episode, 0 where it is random."""
        if unknown := sorted(set(options) - {"targets", "reset_mask"}):
            raise InputError(f"options[{unknown[0]!r}]: expected 'targets', or 'reset_mask' of a vector environment")
        targets = options.get("targets")
        if targets is None:
            return np.zeros(self.batch.count, np.int32)
        low, high = self.scenes.targets_min, self.scenes.targets_max
        numbers = np.broadcast_to(np.asarray(targets), (self.batch.count,))
        valid = numbers.dtype.kind in "iu" and ((numbers >= low) & (numbers <= high)).all()
        require(valid, "options['targets']", targets, f"expected whole numbers from {low} to {high}")
        return numbers.astype(np.int32)

    def actions(self, actions: Any) -> np.ndarray:
        """Validated actions (b, m) as a float32 array; of indices (b,) their commands' actions."""
        if self._commands is not None:
            return self._commands[self._indices(np.asarray(actions), len(self._commands))]
        array, shape = np.asarray(actions, np.float32), (self.batch.count, self.batch.axes)
        if array.shape != shape:
            raise InputError(f"actions have shape {array.shape}: expected {shape}")
        if not np.isfinite(array).all():
            raise InputError("actions: expected finite numbers")
        return array

    def _indices(self, indices: np.ndarray, count: int) -> np.ndarray:
        shape = (self.batch.count,)
        if indices.shape != shape:
            raise InputError(f"actions have shape {indices.shape}: expected {shape}")
        valid = indices.dtype.kind in "iu" and ((indices >= 0) & (indices < count)).all()
        require(valid, "actions", indices.tolist(), f"expected whole numbers from 0 to {count - 1}")
        return indices

    def ends(self, done: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`terminated` and `truncated`: the settings choose which of them ends an episode at the horizon."""
        neither = np.zeros_like(done)
        return (done, neither) if self.settings.horizon == "terminated" else (neither, done)

    def keys(self, seeds: Sequence[int | None], rng: np.random.Generator) -> Key[jax.Array, " b"]:
        """Key of each environment's next episode: from its seed, or the next of its sequence, at first from `rng`."""
        given = np.array([seed is not None for seed in seeds])
        if self.batch.states is None:
            return _keys_of(seeds, rng)
        current = self.batch.states.key
        return jnp.where(given, _keys_of(seeds, rng), current) if given.any() else current


def _restored(settings: TaskSettings, count: int, autoreset: bool, states: list[np.ndarray] | None) -> Task:
    task = Task(settings, count, autoreset)
    task.batch.unpack(states)
    return task


def _keys_of(seeds: Sequence[int | None], rng: np.random.Generator) -> Key[jax.Array, " b"]:
    """A key for each seed, any whole number from 0; a random one for None."""
    random_seeds = rng.integers(2**63, size=len(seeds)).tolist()
    # SeedSequence spreads seeds of any size, and close ones, over all bits; a key has only 64 of them.
    chosen = [other if seed is None else seed for seed, other in zip(seeds, random_seeds, strict=True)]
    words = np.stack([np.random.SeedSequence(seed).generate_state(2, np.uint32) for seed in chosen])
    return jax.random.wrap_key_data(jnp.asarray(words), impl="threefry2x32")


def _space(seen: Features | RangedFeatures, flat: bool) -> spaces.Space:
    shapes = {name: x.shape[1:] for name, x in seen._asdict().items()}
    if flat:
        return spaces.Box(-BOUND, BOUND, (sum(map(math.prod, shapes.values())),), np.float32)
    bounds: dict[str, tuple[float, float]] = dict.fromkeys(("mask", "left", "ranges", "clear"), (0.0, 1.0))
    return spaces.Dict(
        {name: spaces.Box(*bounds.get(name, (-BOUND, BOUND)), shape, np.float32) for name, shape in shapes.items()}
    )
