"""Drive an agent through a recording: real targets that come and go, the real filter, and real visibility."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.evaluation import metrics
from foveate.evaluation.evaluate import compiles_quickly, decision_time
from foveate.evaluation.metrics import mean_or_zero
from foveate.experiment.experiment import Experiment
from foveate.io.jax_settings import compiled
from foveate.io.provenance import provenance
from foveate.io.toml import digest
from foveate.models.gate import gate_limit
from foveate.models.precision import warn_of_rounding
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.recordings.maps import in_obstacles, require_dimension
from foveate.recordings.recording import Recording, Slots, resample
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import first_error, first_mean
from foveate.simulation.records import TRUE, Arrivals, Episode, Policy, Protocol, Trace, Truth
from foveate.simulation.rollout import rollout

MAX_ROUNDING = 0.05
"""Float32 must resolve positions to this share of the sensor's standard deviation."""

VERSION = 1
"""Version of the files of replays."""

_SIMULATE = {quick: compiled(rollout, quick) for quick in (False, True)}


@dataclass(frozen=True, kw_only=True)
class ReplayRow:
    """Measures of one method on one recording from one start.

    `targets` counts tracks present for at least a step. `log_det_mean` [nat], `rmse_m` and `nees` are means over all
    targets and steps; `*_seen` over tracks measured at least once, `*_unseen` over the others, null where there are
    none. `nees_band` holds at least 95 % of such means if the filter's covariance is right: the steps of a track, which
    are correlated, count as one. `seen_fraction` is the share of tracks measured at least once, `seen_time_fraction`
    that of target-steps with a measurement, `longest_unseen_s` the longest time of any track without one. `lost` counts
    tracks unseen at their end with an error above the depth of the view, `rejected` measurements outside the gate.
    `contacts` counts the agent's steps that an obstacle has ended, and `in_obstacles` the instants of targets that are
    inside of one, by the map; null without obstacles.
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
    contacts: int | None = None
    in_obstacles: int | None = None


@dataclass(frozen=True, kw_only=True)
class PreparedReplay:
    """A recording with its noise, ready to replay: the same for every method. `truth` is (K+1, columns, n_y).

    `inside`: instants at which a target is inside of an obstacle; None without obstacles.
    """

    protocol: Protocol
    problem: Problem
    slots: Slots
    episode: Episode
    truth: np.ndarray
    inside: np.ndarray | None
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
) -> PreparedReplay:
    """Sample the recording at the scenario's control period and draw the noise of its measurements from `seed`.

    The filter rejects measurements outside the chi-square `gate` of that probability (see `models.gate`). Raises
    InputError where recording and scenario do not fit: dimensions, states without positions, a schedule, or positions
    too far from the origin for float32.
    """
    problem = scenario.problem()
    _check(scenario, problem, recording)
    slots = resample(recording, float(scenario.tau_s), float(max_gap_s))
    warn_of_rounding(problem, int(np.bincount(slots.track_index[slots.present]).max()))
    truth = _states(problem, slots)
    steps, n, n_y = truth.shape[0] - 1, truth.shape[1], truth.shape[2]
    rng = np.random.default_rng([seed, 0x7265706C])  # independent of the streams that evaluations draw from a seed
    error = first_error(problem, scenario.scenes, jnp.asarray(rng.standard_normal((steps + 1, n, n_y)), float))
    state, present = jnp.asarray(truth, float), jnp.asarray(slots.present)
    noise = jnp.asarray(rng.standard_normal((steps, n, problem.sensor.size)), float)
    means = first_mean(problem, scenario.scenes, state + error, newcomer=True)
    episode = Episode(
        pose=problem.agent.space.from_numbers(agent_start),
        mean=means[0],
        present=present[0],
        inputs=jnp.zeros((steps, n, problem.motion.input_size)),
        horizon=jnp.asarray(steps),
        truth=Truth(state=state, measurement_noise=noise),
        arrivals=Arrivals(present=present, mean=means),
    )
    return PreparedReplay(
        protocol=TRUE._replace(gate=gate_limit(gate, problem.sensor.size)),
        problem=problem,
        slots=slots,
        episode=episode,
        truth=truth,
        inside=in_obstacles(problem.obstacles, slots),
        depth_m=float(scenario.view.depth_m),
        agent_start=tuple(map(float, agent_start)),
        seed=seed,
    )


def _check(scenario: Scenario, problem: Problem, recording: Recording) -> None:
    if not problem.motion.begins_with_position:
        raise InputError("target.Z: a recording holds positions: expected states that begin with them, Z = [I 0]")
    if problem.schedule is not None:
        raise InputError("the scenario has a schedule: replay samples recordings at one tau_s: leave [schedule] out")
    require_dimension(recording, scenario)
    # Far from the origin, as in map coordinates, float32 rounds positions to centimetres: noise the filter ignores.
    far_m = float(np.abs(np.stack(recording.extent)).max())
    rounding_m = np.spacing(np.float32(far_m))
    if rounding_m > MAX_ROUNDING * _std_m(scenario, problem):
        raise InputError(
            f"{recording.name}: positions up to {far_m:g} m from the origin, where float32 resolves only "
            f"{rounding_m:.2g} m: subtract a common origin from them"
        )


def _std_m(scenario: Scenario, problem: Problem) -> float:
    """Standard deviation of a measured position; the smallest, in the middle of the view, of other coordinates."""
    if problem.sensor.polar is None:
        return scenario.sensor.std_m
    ahead = 0.5 * float(scenario.view.depth_m) * np.eye(scenario.dimension)[0]
    return float(np.sqrt(np.linalg.eigvalsh(np.asarray(problem.sensor.equivalent(jnp.asarray(ahead, float))))[0]))


def _states(problem: Problem, slots: Slots) -> np.ndarray:
    """Return states from recorded positions: velocities (and their derivatives) by differences between instants."""
    d, n_y = problem.agent.space.dimension, problem.motion.state_size
    blocks = [slots.positions_m]
    same = slots.track_index[1:] == slots.track_index[:-1]
    while len(blocks) * d < n_y:
        change = np.where(same[..., None], np.diff(blocks[-1], axis=0), 0.0) / float(problem.tau)
        # The derivative over a step belongs to its end; a track's first instant takes that of the next one.
        ahead = np.concatenate([change, change[-1:]])
        behind = np.concatenate([change[:1], change])
        begins = np.concatenate([np.ones_like(same[:1]), ~same])
        blocks.append(np.where(begins[..., None], ahead, behind))
    return np.concatenate(blocks, axis=-1)[..., :n_y]


def drive(ready: PreparedReplay, method: str, policy: Policy) -> tuple[ReplayRow, Trace]:
    """Drive one method through the recording; return its row, and the trace as numpy arrays."""
    simulate = _SIMULATE[compiles_quickly(ready.problem, policy)]
    trace = simulate(ready.problem, policy, ready.episode, ready.protocol, jax.random.key(ready.seed))
    trace = jax.tree.map(np.asarray, trace)
    return _row(ready, method, trace, decision_time(ready.problem, policy, ready.episode)), trace


def _row(ready: PreparedReplay, method: str, trace: Trace, step_time_s: float) -> ReplayRow:
    index, tau = ready.slots.track_index, float(ready.problem.tau)
    # A step counts for tracks present before and after it: at its first instant a track has no belief to update.
    counted = (index[1:] >= 0) & (index[1:] == index[:-1])
    visible = trace.visible & counted
    error = np.asarray(trace.mean, float)[1:] - ready.truth[1:]
    square_m2 = metrics.squared_position_error(error, np.asarray(ready.problem.motion.Z, float))
    nees = metrics.nees(error, np.asarray(trace.information, float)[1:])
    lost, longest, lengths, seen = 0, 0.0, [], []
    of_seen = np.zeros_like(counted)
    for track in np.unique(index[1:][counted]):
        steps, columns = np.nonzero(counted & (index[1:] == track))
        looks = visible[steps, columns]
        lengths.append(len(steps))
        seen.append(looks.any())
        of_seen[steps, columns] = seen[-1]
        longest = max(longest, float(metrics.longest_run(~looks[:, None], np.full(len(looks), tau))[0]))
        lost += bool(not looks[-1] and np.sqrt(square_m2[steps[-1], columns[-1]]) > ready.depth_m)
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
        nees_band=metrics.chi_square_band(ready.truth.shape[-1], metrics.effective_count(np.array(lengths))),
        **metrics.error_measures(square_m2[counted], nees[counted], of_seen[counted]),
        lost=lost,
        rejected=0 if trace.rejections is None else int((np.diff(trace.rejections, axis=0, prepend=0) > 0).sum()),
        step_time_s=step_time_s,
        contacts=None if trace.contacts is None else int(trace.contacts[-1]),
        in_obstacles=None if ready.inside is None else int(ready.inside.sum()),
    )


def result(
    rows: Sequence[ReplayRow], experiment: Experiment, recording: Recording, facts: dict[str, Any]
) -> dict[str, Any]:
    """Content of a replay's JSON file: the rows, and their provenance."""
    inputs = {"experiment": digest(experiment), "recording_sha256": recording.sha256}
    return {**provenance(), **inputs, **facts, "rows": [asdict(row) for row in rows]}
