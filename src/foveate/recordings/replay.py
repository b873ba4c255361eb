"""Replay recordings: drive an agent through real targets that come and go, with real filter and real visibility."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.evaluation.evaluate import decision_time
from foveate.evaluation.metrics import (
    chi_square_band,
    effective_count,
    error_measures,
    longest_run,
    mean_or_zero,
    nees,
    squared_position_error,
)
from foveate.experiment.experiment import Experiment
from foveate.io.provenance import provenance
from foveate.io.toml import digest
from foveate.models.gate import gate_limit
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.recordings.recording import Recording, Slots, resample
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import first_error
from foveate.simulation.records import TRUE, Arrivals, Episode, Policy, Protocol, Trace, Truth
from foveate.simulation.rollout import rollout

MAX_ROUNDING = 0.05
"""Positions must be resolved to this share of the sensor's standard deviation."""

VERSION = 1
"""Version of the files of replays."""


@dataclass(frozen=True, kw_only=True)
class ReplayRow:
    """Measures of one method on one recording from one start.

    `targets` counts tracks present for a step at least; `log_det_mean` [nat], `rmse_m` and `nees` are over all targets
    at all steps, and apart over those of tracks that were measured at least once and of those that never were, null
    where there are none. `nees_band` holds at least 95 % of such means if the filter's covariance is right: the steps
    of a track, which are correlated, count as one. `seen_fraction` is the share of tracks measured at least once,
    `seen_time_fraction` of all target-steps with a measurement; `longest_unseen_s` the longest time that any track
    went without one; `lost` counts tracks unseen at their end with an error above the depth of the view; `rejected`
    counts measurements that the gate rejected.
    """

    method: str
    seed: int
    agent_start: tuple[float, ...]
    targets: int
    log_det_mean: float
    seen_fraction: float
    seen_time_fraction: float
    longest_unseen_s: float
    rmse_m: float
    nees: float
    nees_band: tuple[float, float]
    rmse_seen_m: float | None
    rmse_unseen_m: float | None
    nees_seen: float | None
    nees_unseen: float | None
    lost: int
    rejected: int
    step_time_s: float


@dataclass(frozen=True, kw_only=True)
class Replay:
    """A recording with its noise, ready to replay: the same for every method. `truth` is (K+1, columns, n_y)."""

    protocol: Protocol
    problem: Problem
    slots: Slots
    episode: Episode
    truth: np.ndarray
    depth_m: float
    agent_start: tuple[float, ...]
    seed: int


def prepare_replay(
    scenario: Scenario,
    recording: Recording,
    agent_start: Sequence[float],
    max_gap_s: float = 2.0,
    seed: int = 0,
    gate: float | None = GATE,
) -> Replay:
    """Sample the recording at the scenario's control period and draw the noise of its measurements from `seed`.

    The filter rejects measurements outside of the chi-square `gate`, of that probability (see `models.gate`).

    Raises:
        InputError: recording and scenario do not fit: dimensions, states without positions, a schedule, or positions
            too far from the origin for float32.
    """
    problem = scenario.problem()
    _check(scenario, problem, recording)
    slots = resample(recording, float(scenario.tau_s), float(max_gap_s))
    truth = _states(problem, slots)
    steps, n, n_y = truth.shape[0] - 1, truth.shape[1], truth.shape[2]
    rng = np.random.default_rng([seed, 0x7265706C])  # apart from the streams that evaluations draw from a seed
    error = first_error(problem, scenario.scenes, jnp.asarray(rng.standard_normal((steps + 1, n, n_y)), float))
    first_mean = jnp.asarray(truth, float) + error
    noise = rng.standard_normal((steps, n, problem.sensor.H.shape[0]))
    present = jnp.asarray(slots.present)
    episode = Episode(
        pose=problem.agent.space.from_numbers(agent_start),
        mean=first_mean[0],
        present=present[0],
        inputs=jnp.zeros((steps, n, problem.motion.input_size)),
        horizon=jnp.asarray(steps),
        truth=Truth(state=jnp.asarray(truth, float), measurement_noise=jnp.asarray(noise, float)),
        arrivals=Arrivals(present=present, mean=first_mean),
    )
    start = tuple(float(x) for x in agent_start)
    return Replay(
        protocol=TRUE._replace(gate=gate_limit(gate, len(problem.sensor.H))),
        problem=problem,
        slots=slots,
        episode=episode,
        truth=truth,
        depth_m=float(scenario.view.depth_m),
        agent_start=start,
        seed=seed,
    )


def _check(scenario: Scenario, problem: Problem, recording: Recording) -> None:
    """Raise InputError where a recording cannot be replayed in a scenario."""
    if not problem.motion.begins_with_position:
        raise InputError("target.Z: a recording holds positions: expected states that begin with them, Z = [I 0]")
    if problem.schedule is not None:
        raise InputError("the scenario has a schedule: replay samples recordings at one tau_s: leave [schedule] out")
    if recording.dimension != scenario.dimension:
        raise InputError(
            f"{recording.name}: positions have {recording.dimension} numbers: the run's scenario has "
            f"{scenario.dimension}"
        )
    # Far from the origin, as in map coordinates, float32 rounds positions to centimetres: noise the filter ignores.
    far = float(np.abs(np.stack(recording.extent)).max())
    if np.spacing(np.float32(far)) > MAX_ROUNDING * scenario.sensor.std_m:
        raise InputError(
            f"{recording.name}: positions up to {far:g} m from the origin, where float32 resolves only "
            f"{np.spacing(np.float32(far)):.2g} m: subtract a common origin from them"
        )


def _states(problem: Problem, slots: Slots) -> np.ndarray:
    """Make states of recorded positions: velocities (and their derivatives) by differences between instants."""
    d, n_y = problem.agent.space.dimension, problem.motion.state_size
    blocks = [slots.positions_m]
    same = slots.track_index[1:] == slots.track_index[:-1]
    while len(blocks) * d < n_y:
        change = np.where(same[..., None], np.diff(blocks[-1], axis=0), 0.0) / float(problem.tau)
        # The derivative over a step stands at its end; at a track's first instant the one that follows is taken.
        ahead = np.concatenate([change, change[-1:]])
        behind = np.concatenate([change[:1], change])
        begins = np.concatenate([np.ones_like(same[:1]), ~same])
        blocks.append(np.where(begins[..., None], ahead, behind))
    return np.concatenate(blocks, axis=-1)[..., :n_y]


@eqx.filter_jit
def _run(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key) -> Trace:
    return rollout(problem, policy, episode, protocol, key)


def replay(ready: Replay, method: str, policy: Policy) -> tuple[ReplayRow, Trace]:
    """Drive one method through the recording; its row, and the trace as numpy arrays."""
    trace = _run(ready.problem, policy, ready.episode, ready.protocol, jax.random.key(ready.seed))
    trace = jax.tree.map(np.asarray, trace)
    step_time = decision_time(ready.problem, policy, ready.episode)
    return _row(ready, method, trace, step_time), trace


def _row(ready: Replay, method: str, trace: Trace, step_time: float) -> ReplayRow:
    index, tau = ready.slots.track_index, float(ready.problem.tau)
    # A step counts for a track present before and after it: at its first instant there is no belief to update.
    counted = (index[1:] >= 0) & (index[1:] == index[:-1])
    visible = np.asarray(trace.visible) & counted
    error = np.asarray(trace.mean, float)[1:] - ready.truth[1:]
    square = squared_position_error(error, np.asarray(ready.problem.motion.Z, float))
    lost, longest, lengths, seen = 0, 0.0, [], []
    of_seen = np.zeros_like(counted)
    for track in np.unique(index[1:][counted]):
        steps, columns = np.nonzero(counted & (index[1:] == track))
        looks = visible[steps, columns]
        lengths.append(len(steps))
        seen.append(looks.any())
        of_seen[steps, columns] = seen[-1]
        longest = max(longest, float(longest_run(~looks[:, None], np.full(len(looks), tau))[0]))
        lost += bool(not looks[-1] and np.sqrt(square[steps[-1], columns[-1]]) > ready.depth_m)
    return ReplayRow(
        method=method,
        seed=ready.seed,
        agent_start=ready.agent_start,
        targets=len(lengths),
        log_det_mean=mean_or_zero(np.asarray(trace.log_det, float)[counted]),
        seen_fraction=mean_or_zero(np.array(seen, bool)),
        seen_time_fraction=mean_or_zero(visible[counted]),
        longest_unseen_s=longest,
        # The steps of a track are correlated: tracks are the samples, weighted by their lengths.
        nees_band=chi_square_band(ready.truth.shape[-1], effective_count(np.array(lengths))),
        **error_measures(
            square[counted], nees(error, np.asarray(trace.information, float)[1:])[counted], of_seen[counted]
        ),
        lost=lost,
        rejected=0 if trace.rejections is None else int((np.diff(trace.rejections, axis=0, prepend=0) > 0).sum()),
        step_time_s=step_time,
    )


def default_agent_start(recording: Recording, scenario: Scenario) -> list[float]:
    """Start in the middle of the recording's extent, heading along x."""
    lower, upper = recording.extent
    space = scenario.agent.agent().space
    middle = jnp.asarray((lower + upper) / 2, float)
    return space.to_numbers(space.upright(middle, jnp.zeros(())))


def random_agent_starts(recording: Recording, scenario: Scenario, count: int, seed: int) -> list[list[float]]:
    """Draw starts uniform in the recording's extent, with any heading."""
    lower, upper = recording.extent
    space, rng = scenario.agent.agent().space, np.random.default_rng([seed, count])
    return [
        space.to_numbers(
            space.upright(jnp.asarray(rng.uniform(lower, upper), float), jnp.asarray(rng.uniform(-np.pi, np.pi)))
        )
        for _ in range(count)
    ]


def result(
    rows: Sequence[ReplayRow], experiment: Experiment, recording: Recording, facts: dict[str, Any]
) -> dict[str, Any]:
    """Content of a replay's JSON file: the rows, and what they were made with."""
    made = {"experiment": digest(experiment), "recording_sha256": recording.sha256}
    return {**provenance(), **made, **facts, "rows": [asdict(row) for row in rows]}
