"""Scores of policies and planners by the objective of a training, on held-out episodes with the same noise for all."""

import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foveate.evaluation.gospa import mean_gospa
from foveate.evaluation.planners import WINDOW
from foveate.experiment.experiment import Experiment
from foveate.learning.devices import cores
from foveate.learning.learner import objective_score
from foveate.learning.loop import PLANAR_COMPILER_OPTIONS
from foveate.models.precision import rounds_alike
from foveate.models.problem import Problem
from foveate.planning.receding import Receding
from foveate.planning.shooting import PlanSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, Episode, Observation, Policy
from foveate.simulation.rollout import rollout
from foveate.types import Action, Key, Scalar

PLANS_PER_BATCH = 4
"""Episodes that a core plans side by side; the same on every machine, as rounding may depend on it."""

Scores = Float[np.ndarray, "_"]
"""Score of each episode [nat per target, or share of time in view]; a planner has fewer episodes than a policy."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Test episodes of an experiment's scenario, with truth, noise, and keys of the methods' own random numbers."""

    experiment: Experiment
    problem: Problem
    episodes: Episode
    keys: jax.Array


def held_out(experiment: Experiment, count: int, seed: int) -> HeldOut:
    """Sample `count` episodes that neither train nor validate a policy, whatever the seed of its training."""
    problem, scenes = experiment.scenario.problem(), experiment.scenario.scenes
    # A training derives its keys from its own seed by `split`; a number this large is none of theirs.
    key = jax.random.fold_in(jax.random.key(seed), np.uint32(zlib.crc32(b"verdict")))
    episode_keys, keys = (jax.random.split(each, count) for each in jax.random.split(key))
    make = jax.vmap(lambda key: training_episode(problem, scenes, key, noise=True, test=True))
    return HeldOut(experiment=experiment, problem=problem, episodes=jax.jit(make)(episode_keys), keys=keys)


class OneOf(Policy):
    """The policy of this index: all of them in one compiled program, in which the simulation is compiled once."""

    policies: tuple[Policy, ...]
    index: Int[Array, ""]

    def start(self, observation: Observation) -> tuple[Any, ...]:
        """The memories of all policies."""
        return tuple(policy.start(observation) for policy in self.policies)

    def claims(self, observation: Observation, memory: tuple[Any, ...]) -> Float[Array, " n"]:
        """What the policy tells its team."""
        told = [policy.claims(observation, own) for policy, own in zip(self.policies, memory, strict=True)]
        return jnp.stack(told)[self.index]

    def __call__(self, observation: Observation, memory: tuple[Any, ...], key: Key) -> tuple[Action, tuple[Any, ...]]:
        """The action of the policy; only its own memory changes."""
        branches = [partial(self._decide, i, observation, key) for i in range(len(self.policies))]
        return jax.lax.switch(self.index, branches, memory)

    def _decide(
        self, i: int, observation: Observation, key: Key, memory: tuple[Any, ...]
    ) -> tuple[Action, tuple[Any, ...]]:
        action, own = self.policies[i](observation, memory[i], key)
        return action, (*memory[:i], own, *memory[i + 1 :])


def policy_scores(
    given: HeldOut, policies: Mapping[str, Policy], report: Callable[[int], None] = lambda done: None
) -> dict[str, Scores]:
    """Run every policy on all episodes; `report` takes the number of completed policies."""
    arrays, static = eqx.partition(tuple(policies.values()), eqx.is_array)

    def run(arrays, index, episodes, keys):
        policy = OneOf(eqx.combine(arrays, static), index)
        return jax.vmap(lambda episode, key: _score(given, policy, episode, key))(episodes, keys)

    rest = (given.episodes, given.keys)
    program = _compiled(given, run, arrays, jnp.array(0), *rest)
    scores = {}
    with ThreadPoolExecutor(cores()) as pool:
        found = pool.map(lambda i: _scores(given, program(arrays, jnp.array(i), *rest), rest[0]), range(len(policies)))
        for name, values in zip(policies, found, strict=True):
            scores[name] = values
            report(len(scores))
    return scores


def planner_scores(
    given: HeldOut, settings: PlanSettings, count: int, report: Callable[[int], None] = lambda done: None
) -> Scores:
    """Run the receding-horizon planner on the first `count` episodes; `report` takes the number of completed ones.

    It maximises log det at the end of its window, whatever the objective. Raises InputError where it cannot plan.
    """

    def run(episodes, keys):
        return jax.vmap(partial(_planner_score, given, settings))(episodes, keys)

    def batch(first: int) -> Any:
        # Copies of the last episode fill the last batch: all run the same compiled program.
        rows = np.minimum(np.arange(first, first + PLANS_PER_BATCH), count - 1)
        return jax.tree.map(lambda x: x[rows], (given.episodes, given.keys))

    program = _compiled(given, run, *batch(0))
    parts: list[Scores] = []
    with ThreadPoolExecutor(cores()) as pool:
        batches = map(batch, range(0, count, PLANS_PER_BATCH))
        for part in pool.map(lambda batch: _scores(given, program(*batch), batch[0]), batches):
            parts.append(part)
            report(min(count, PLANS_PER_BATCH * len(parts)))
    return np.concatenate(parts)[:count]


def planning_work(experiment: Experiment, settings: PlanSettings) -> float:
    """Numbers that planners update in an episode: of all matrices, steps ahead, iterations, starts, steps, robots."""
    scenario = experiment.scenario
    n, n_y = scenario.scenes.targets_max, scenario.problem().motion.state_size
    steps = scenario.scenes.horizon(n)
    agents = 1 if scenario.team is None else scenario.team.agents
    starts = settings.starts + (agents > 1 and settings.starts > 1)
    return float(steps * min(WINDOW, steps) * settings.iterations * starts * agents * n * n_y**2)


def _planner_score(given: HeldOut, settings: PlanSettings, episode: Episode, key: Key) -> "Scalar | Estimates":
    window = min(WINDOW, len(episode.inputs))
    planner = Receding(problem=given.problem, settings=settings, window=window)
    return _score(given, planner, episode, key)


class Estimates(NamedTuple):
    """Positions of all tracks after each step [m], and the tracks that are reported: of detections without ids."""

    position_world: Float[Array, "*b K n d"]
    reported: Bool[Array, "*b K n"]


def _score(given: HeldOut, policy: Policy, episode: Episode, key: Key) -> Scalar | Estimates:
    """Score of an episode; without ids what `_scores` needs for it, as pairs are found outside of JAX."""
    training, model = given.experiment.training, given.problem.detections
    trace = rollout(given.problem, policy, episode, PROTOCOLS[training.select], key)
    if model is None or trace.confirmed is None:
        return objective_score(trace, episode, training.objective)
    return Estimates(given.problem.motion.position(trace.mean[1:]), trace.confirmed[1:])


def _scores(given: HeldOut, found: Any, episodes: Episode) -> Scores:
    """Scores of episodes as numbers: without ids minus GOSPA, the mean over the steps."""
    model, truth, scans = given.problem.detections, episodes.truth, episodes.scans
    if model is None or truth is None or scans is None:
        return np.asarray(found, float)
    position = np.asarray(given.problem.motion.position(truth.state), float)[:, 1:]
    estimates = np.asarray(found.position_world, float), np.asarray(found.reported)
    parts, cutoff_m = (*estimates, position, np.asarray(scans.alive)[:, 1:]), float(np.asarray(model.cutoff))

    def score(i: int, steps: int) -> float:
        estimate, reported, target, alive = (part[i, :steps] for part in parts)
        return -mean_gospa(estimate, reported, target, alive, cutoff_m).gospa

    return np.array([score(i, int(steps)) for i, steps in enumerate(np.asarray(episodes.horizon))])


def _compiled(given: HeldOut, run: Callable, *arguments: Any) -> Callable:
    """Compile a program before threads call it, each of which would compile it again."""
    # In space, too: without a training's gradient the programs run no slower.
    options = PLANAR_COMPILER_OPTIONS if rounds_alike(given.problem) else {}
    with jax.default_matmul_precision("highest"):  # of this thread: a setting of the caller's does not reach it
        return jax.jit(run, compiler_options=options).lower(*arguments).compile()
