"""Driving an agent through a recording of real targets that come and go, with the real filter and real visibility."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.evaluation.evaluate import decision_time
from foveate.evaluation.metrics import chi_square_band, longest_run, splits
from foveate.experiment.experiment import Experiment
from foveate.io.provenance import provenance
from foveate.io.toml import digest
from foveate.models.gate import gate_limit
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.recordings.motion import fit_statistics, median_fix_interval_s
from foveate.recordings.recording import Recording, Slots, resample_slots
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import first_error
from foveate.simulation.records import TRUE, Arrivals, Episode, Policy, Protocol, Trace, Truth
from foveate.simulation.rollout import rollout

MAX_ROUNDING = 0.05
"""Positions must be resolved to this share of the sensor's standard deviation."""


VERSION = 1
"""Of the files of replays."""


JUMP = 20.0
"""A gap in the clock of the recording, in its median steps, that is worth a warning."""


CONTRADICTION = 4.0
"""A process noise off by more than this factor in variance is worth a warning."""


@dataclass(frozen=True, kw_only=True)
class ReplayRow:
    """One method on one recording from one start.

    `targets` counts tracks that were there for a step at least; `log_det_mean` [nat], `rmse_m` and `nees` are over all
    targets at all steps, and apart over those of tracks that were measured at least once and of those that never
    were, null where there are none. `nees_band` holds at least 95 % of such means if the filter's covariance is right:
    the steps of a track, which hang together, count as one. `seen_fraction` is the share of tracks measured at least
    once, `seen_time_fraction` of all target-steps with a measurement; `longest_unseen_s` the longest time that any
    track went without one; `lost` counts tracks unseen at their end with an error above the depth of the view;
    `rejected` measurements that the gate rejected.
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
    """A recording made ready: what every method gets alike. `truth` (K+1, columns, n_y)."""

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

    Raises ValueError where the recording has another number of dimensions than the scenario.
    """
    d, problem = scenario.dimension, scenario.problem()
    if not problem.motion.begins_with_position:
        raise InputError("target.Z: a recording holds positions: expected states that begin with them, Z = [I 0]")
    if problem.schedule is not None:
        raise InputError("the scenario has a schedule: replay samples recordings at one tau_s: leave [schedule] out")
    if recording.dimension != d:
        raise InputError(f"{recording.name}: positions have {recording.dimension} numbers: the run's scenario has {d}")
    far = float(np.abs(np.stack(recording.extent)).max())
    if np.spacing(np.float32(far)) > MAX_ROUNDING * scenario.sensor.std_m:
        raise InputError(
            f"{recording.name}: positions up to {far:g} m from the origin, where float32 resolves only "
            f"{np.spacing(np.float32(far)):.2g} m: subtract a common origin from them"
        )
    slots = resample_slots(recording, float(scenario.tau_s), float(max_gap_s))
    truth = _states(problem, slots)
    steps, n, n_y = truth.shape[0] - 1, truth.shape[1], truth.shape[2]
    rng = np.random.default_rng([seed, 0x7265706C])
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


def _states(problem: Problem, slots: Slots) -> np.ndarray:
    """Recorded positions as states: velocities (and their derivatives) by differences between instants."""
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
    """Drive one method through the recording."""
    trace = _run(ready.problem, policy, ready.episode, ready.protocol, jax.random.key(ready.seed))
    trace = jax.tree.map(np.asarray, trace)
    step_time = decision_time(ready.problem, policy, ready.episode)
    return _row(ready, method, trace, step_time), trace


def _row(ready: Replay, method: str, trace: Trace, step_time: float) -> ReplayRow:
    index, tau = ready.slots.track_index, float(ready.problem.tau)
    # A step counts for a track that was there before and after it: at its first instant there is no belief to update.
    counts = (index[1:] >= 0) & (index[1:] == index[:-1])
    visible = np.asarray(trace.visible) & counts
    error = np.asarray(trace.mean, float)[1:] - ready.truth[1:]
    square = ((error @ np.asarray(ready.problem.motion.Z, float).T) ** 2).sum(axis=-1)
    nees = np.einsum("kni,knij,knj->kn", error, np.asarray(trace.information, float)[1:], error)
    lost, longest, lengths = 0, 0.0, []
    of_seen = np.zeros_like(counts)
    tracks = np.unique(index[1:][counts])
    for track in tracks:
        here = counts & (index[1:] == track)
        lengths.append(here.sum())
        column = int(np.flatnonzero(here.any(axis=0))[0])
        steps = np.flatnonzero(here[:, column])
        looks = visible[steps, column]
        of_seen |= here & looks.any()
        longest = max(longest, float(longest_run(~looks[:, None], np.full(len(looks), tau))[0]))
        lost += bool(not looks[-1] and np.sqrt(square[steps[-1], column]) > ready.depth_m)
    total, seen = max(1, int(counts.sum())), len(np.unique(index[1:][of_seen]))
    # A mean over tracks that weigh as long as they are varies as one over so many that weigh the same.
    alike = total**2 / max(1, int(np.square(lengths).sum()))
    return ReplayRow(
        method=method,
        seed=ready.seed,
        agent_start=ready.agent_start,
        targets=len(tracks),
        log_det_mean=float(np.asarray(trace.log_det, float)[counts].sum() / total),
        seen_fraction=seen / max(1, len(tracks)),
        seen_time_fraction=float(visible.sum() / total),
        longest_unseen_s=longest,
        rmse_m=float(np.sqrt(square[counts].sum() / total)),
        nees=float(nees[counts].sum() / total),
        nees_band=chi_square_band(ready.truth.shape[-1], alike),
        **splits(square[counts], nees[counts], of_seen[counts]),
        lost=lost,
        rejected=0 if trace.rejections is None else int((np.diff(trace.rejections, axis=0, prepend=0) > 0).sum()),
        step_time_s=step_time,
    )


def default_agent_start(recording: Recording, scenario: Scenario) -> list[float]:
    """The middle of the recording's extent, heading along x."""
    lower, upper = recording.extent
    space = scenario.agent.agent().space
    middle = jnp.asarray((lower + upper) / 2, float)
    return space.to_numbers(space.upright(middle, jnp.zeros(())))


def random_agent_starts(recording: Recording, scenario: Scenario, count: int, seed: int) -> list[list[float]]:
    """Starts uniform in the recording's extent, with any heading."""
    lower, upper = recording.extent
    space, rng = scenario.agent.agent().space, np.random.default_rng([seed, count])
    return [
        space.to_numbers(
            space.upright(jnp.asarray(rng.uniform(lower, upper), float), jnp.asarray(rng.uniform(-np.pi, np.pi)))
        )
        for _ in range(count)
    ]


def warnings_for(scenario: Scenario, recording: Recording, slots: Slots, max_gap_s: float) -> list[str]:
    """What a user should know before trusting the result: each a line."""
    found = []
    most, trained = int(slots.present.sum(axis=1).max()), scenario.scenes.targets_max
    if most > trained:
        found.append(f"up to {most} targets at once: the run's scenario goes up to {trained}")
    if slots.dropped:
        found.append(f"{slots.dropped} tracks fall between the control instants and are left out")
    times = np.unique(np.concatenate([track.times_s for track in recording.tracks]))
    gaps = np.diff(times)
    if len(gaps) and gaps.max() > max(max_gap_s, JUMP * np.median(gaps)):
        first = int(np.argmax(gaps))
        found.append(
            f"nothing is recorded between {times[first]:.10g} s and {times[first + 1]:.10g} s: all targets leave and "
            "appear anew; if the clock jumped, cut the recording there with --start or --end"
        )
    interval = median_fix_interval_s(recording) if any(len(track.times_s) > 1 for track in recording.tracks) else 0.0
    if interval > max_gap_s:
        found.append(
            f"fixes are {interval:g} s apart, more than --max-gap {max_gap_s:g} s: targets are absent most of the time"
        )
    motion = scenario.problem().motion
    if motion.state_size == scenario.dimension:
        try:
            statistics = fit_statistics(recording, float(scenario.tau_s), float(max_gap_s))
        except InputError:  # too few pairs of fixes to judge W by
            return found
        walk = float(np.trace(statistics.walk_covariance_m2))
        claimed = float(jnp.trace(motion.W))
        if not walk / CONTRADICTION <= claimed <= walk * CONTRADICTION:
            found.append(
                f"targets move {walk**0.5:.2g} m (rms) per step, the scenario's W claims {claimed**0.5:.2g} m: "
                "beliefs will be too sure or too vague; fit a scenario to this recording"
            )
    return found


def result(
    rows: Sequence[ReplayRow], experiment: Experiment, recording: Recording, facts: dict[str, Any]
) -> dict[str, Any]:
    """The replay as JSON, with what it was made with."""
    made = {"experiment": digest(experiment), "recording_sha256": recording.sha256}
    return {**provenance(), **made, **facts, "rows": [asdict(row) for row in rows]}
