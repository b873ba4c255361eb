"""The omniscient planner, the oracle of every score: it knows the true positions of targets, and has no noise.

Its plans take minutes, so they are kept in the user's cache folder under a digest of all that they depend on.
"""

import hashlib
import json
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate import __version__
from foveate.errors import InputError
from foveate.evaluation.evaluate import Row, Suite, episode_rows, policy_keys
from foveate.io.cache import Job
from foveate.io.files import cache_folder
from foveate.io.grouping import group_by
from foveate.learning.devices import cores
from foveate.models import belief
from foveate.models.belief import entropy
from foveate.models.problem import Problem, first_information
from foveate.models.sensor import Softness
from foveate.planning.receding import FixedActions
from foveate.planning.shooting import OMNISCIENT, PlanSettings, plan
from foveate.simulation.information import Future, score
from foveate.simulation.records import PROTOCOLS, Episode, Protocol
from foveate.simulation.rollout import rollout

VERSION = 1
"""Of the files of plans; raised, too, when the planner gives other plans than before."""

ORACLE_MICRO_BATCH = 4
"""Episodes of one size in a batch: more would not fit into a core's cache."""

OnProgress = Callable[[int], None]
"""Takes the number of completed episodes."""


@dataclass(frozen=True, kw_only=True)
class Plans:
    """The omniscient planner's action sequences for every episode of a suite.

    `score`: of the noise-free information recursion with every target at its true position [nat per target];
    `seconds`: wall time an episode, compiled, on the machine that planned them.
    """

    action: Float[np.ndarray, "episodes K m"]
    score: Float[np.ndarray, " episodes"]
    seconds: Float[np.ndarray, " episodes"]


def oracle_rows(
    suite: Suite,
    protocol: str,
    on_progress: OnProgress = lambda done: None,
    settings: PlanSettings | None = None,
) -> list[Row]:
    """Rows of the omniscient planner (None: at its full budget); its plans are kept in the user's cache folder."""
    plans = omniscient(suite, protocol, settings or OMNISCIENT[protocol], cache_folder("plans"), on_progress)
    return omniscient_rows(suite, protocol, plans)


def omniscient(
    suite: Suite,
    protocol: str,
    settings: PlanSettings,
    cache: Path,
    on_progress: OnProgress = lambda done: None,
) -> Plans:
    """Plan every episode of a suite, or load the plans from the folder `cache`; scores are computed either way."""
    futures = jax.jit(jax.vmap(lambda episode: _future(suite.problem, episode)))(suite.episodes)
    key, shape = _key(suite, protocol, settings), (*futures.state.shape[:2], len(suite.problem.agent.axes))

    def decode(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        action, seconds = arrays["action"], arrays["seconds"]
        if action.shape != shape or seconds.shape != shape[:1]:
            raise InputError(f"plans of shape {action.shape}: expected {shape}")
        return action, seconds

    job = Job(
        path=cache / f"{key}.npz",
        kind="plans",
        version=VERSION,
        key=lambda: key,
        compute=lambda: _solve_all(suite, futures, settings, on_progress),
        encode=lambda plans: {"action": plans[0], "seconds": plans[1]},
        decode=decode,
        optional=True,  # a folder that cannot be written costs the next run its time, not this one its result
    )
    action, seconds = job.result()
    on_progress(len(action))
    softness = next(iter(PROTOCOLS[protocol].levels), None)  # None: the real view
    value = _scores(suite.problem, futures, jnp.asarray(action), softness)
    return Plans(action=action, score=np.asarray(value, float), seconds=seconds)


@eqx.filter_jit
def _scores(problem: Problem, futures: Future, actions, softness: Softness | None) -> Float[Array, " episodes"]:
    return jax.vmap(lambda future, action: score(problem, future, action, softness))(futures, actions)


def omniscient_rows(suite: Suite, protocol: str, plans: Plans) -> list[Row]:
    """Rows of the plans, run in the simulation; score and entropy are those of `Plans.score`.

    Under `true` both scores are the same, as detections depend on true positions alone (unless V grows with the
    believed range); under `surrogate` the simulated filter weighs its noisy means, which the planner does not know.
    """
    trace = _drive(suite.problem, jnp.asarray(plans.action), suite.episodes, PROTOCOLS[protocol], policy_keys(suite))
    horizons = np.asarray(suite.episodes.horizon)
    rows = episode_rows(suite, "omniscient", protocol, jax.tree.map(np.asarray, trace), list(plans.seconds / horizons))
    n_y = suite.problem.motion.state_size
    return [
        row if row.score is None else _rescored(row, value, entropy(value, n_y), suite)
        for row, value in zip(rows, plans.score.tolist(), strict=True)
    ]


def _rescored(row: Row, score: float, entropy: float, suite: Suite) -> Row:
    objective = score if suite.objective == "terminal" else row.objective
    return replace(row, score=score, entropy=entropy, objective=objective)


@eqx.filter_jit
def _drive(problem: Problem, actions, episodes: Episode, protocol: Protocol, keys):
    return jax.vmap(lambda e, a, k: rollout(problem, FixedActions(a), e, protocol, k))(episodes, actions, keys)


def _future(problem: Problem, episode: Episode) -> Future:
    """True positions, and information before any measurement, at every step of an episode."""
    assert episode.truth is not None, "an episode without truth has no known future"
    first = first_information(problem, len(episode.present))
    return Future(
        pose=episode.pose,
        state=episode.truth.state[1:],
        information=jax.vmap(lambda Y: belief.predict_information(Y, problem.motion))(first),
        present=episode.present,
        horizon=episode.horizon,
        map_number=episode.map_number,
    )


def _solve(problem: Problem, futures: Future, settings: PlanSettings, keys) -> Float[Array, "episodes K m"]:
    return jax.vmap(lambda future, key: plan(problem, future, settings, key).action)(futures, keys)


def _cropped(futures: Future, rows: np.ndarray, targets: int, steps: int) -> Future:
    """The futures of these episodes without padding."""

    def crop(future: Future) -> Future:
        information, present = future.information[:targets], future.present[:targets]
        return replace(future, state=future.state[:steps, :targets], information=information, present=present)

    return jax.vmap(crop)(jax.tree.map(lambda x: x[rows], futures))


def _solve_all(
    suite: Suite, futures: Future, settings: PlanSettings, on_progress: OnProgress
) -> tuple[np.ndarray, np.ndarray]:
    """Actions and seconds of every episode; those of one size share a program, so that none is padded."""
    keys = policy_keys(suite)
    action = np.zeros((*futures.state.shape[:2], len(suite.problem.agent.axes)), futures.state.dtype)
    seconds = np.zeros(len(action))

    def size_of(i: int) -> tuple[int, int]:
        scene = suite.scenes[i // suite.episodes_per_scene]
        return max(1, len(scene.targets)), scene.horizon

    sizes = group_by(range(len(action)), size_of)
    batches = {
        size: [np.array(rows[i : i + ORACLE_MICRO_BATCH]) for i in range(0, len(rows), ORACLE_MICRO_BATCH)]
        for size, rows in sizes.items()
    }

    def arguments(size: tuple[int, int], batch: np.ndarray) -> tuple[Any, ...]:
        rows = np.resize(batch, ORACLE_MICRO_BATCH)  # repeats episodes, as a program has one shape
        return suite.problem, _cropped(futures, rows, *size), settings, keys[rows]

    solver: Any = eqx.filter_jit(_solve)
    done = 0
    with ThreadPoolExecutor(cores()) as pool:
        programs = list(pool.map(lambda size: solver.lower(*arguments(size, batches[size][0])).compile(), sizes))
        for (size, rows), program in zip(sizes.items(), programs, strict=True):
            inputs = [arguments(size, batch) for batch in batches[size]]
            began = time.perf_counter()
            solved = pool.map(lambda given, program=program: np.asarray(program(*given)), inputs)
            for batch, actions in zip(batches[size], solved, strict=True):
                action[batch, : size[1]] = actions[: len(batch)]
                done += len(batch)
                on_progress(done)
            seconds[rows] = (time.perf_counter() - began) / len(rows)
    return action, seconds


def _key(suite: Suite, protocol: str, settings: PlanSettings) -> str:
    """Digest of everything that plans depend on."""
    leaves, structure = jax.tree.flatten((suite.problem, suite.episodes.pose, suite.truth.state))
    arrays = [np.asarray(leaf) for leaf in leaves]
    words = {
        "version": [__version__, VERSION],
        "protocol": protocol,
        "settings": asdict(settings),
        "scenes": [scene.record() for scene in suite.scenes],
        "episodes": [suite.seed, suite.episodes_per_scene],
        "structure": str(structure),
        "arrays": [[array.dtype.str, array.shape] for array in arrays],
    }
    total = hashlib.sha256(json.dumps(words, sort_keys=True).encode())
    for array in arrays:
        total.update(array.tobytes())
    return total.hexdigest()
