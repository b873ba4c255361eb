"""Drive an agent through a recording: real targets that come and go, the real filter, and real visibility."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.evaluation.evaluate import compiles_quickly, decision_time
from foveate.experiment.experiment import Experiment
from foveate.io.jax_settings import compiled
from foveate.io.provenance import provenance
from foveate.io.toml import digest
from foveate.models.gate import gate_limit
from foveate.models.precision import warn_of_rounding
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.recordings.maps import in_obstacles, require_dimension
from foveate.recordings.measures import PreparedReplay, ReplayRow, measured
from foveate.recordings.recording import Recording, Slots, resample
from foveate.recordings.scans import with_scans
from foveate.recordings.team import first_poses, team_draws
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import first_error, first_mean
from foveate.simulation.records import TRUE, Arrivals, Episode, Policy, Trace, Truth
from foveate.simulation.rollout import rollout

MAX_ROUNDING = 0.05
"""Float32 must resolve positions to this share of the sensor's standard deviation."""

VERSION = 1
"""Version of the files of replays."""

_SIMULATE = {quick: compiled(rollout, quick) for quick in (False, True)}


def prepare_replay(
    scenario: Scenario,
    recording: Recording,
    agent_start: Sequence[float],
    max_gap_s: float = 2.0,
    seed: int = 0,
    gate: float | None = GATE,
) -> PreparedReplay:
    """Sample the recording at the scenario's control period and draw the noise of its measurements from `seed`.

    `agent_start` has the numbers of a pose [m, rad], of a team those of all robots, one pose after another. The filter
    rejects measurements outside the chi-square `gate` of that probability (see `models.gate`); that of detections
    without ids has its own. Raises InputError where recording and scenario do not fit: dimensions, states without
    positions, a schedule, or positions that float32 does not resolve.
    """
    problem = scenario.problem()
    _check(scenario, problem, recording)
    slots = resample(recording, float(scenario.tau_s), float(max_gap_s))
    warn_of_rounding(problem, int(np.bincount(slots.track_index[slots.present]).max()))
    truth = _states(problem, slots)
    (instants, n, n_y), steps = truth.shape, len(truth) - 1
    rng = np.random.default_rng([seed, 0x7265706C])  # independent of the streams that evaluations draw from a seed
    error = first_error(problem, scenario.scenes, jnp.asarray(rng.standard_normal((instants, n, n_y)), float))
    state, present = jnp.asarray(truth, float), jnp.asarray(slots.present)
    noise = jnp.asarray(rng.standard_normal((steps, n, problem.sensor.size)), float)
    poses, means = first_poses(problem, agent_start), first_mean(problem, scenario.scenes, state + error, newcomer=True)
    episode = Episode(
        pose=poses[0],
        mean=means[0],
        present=present[0],
        inputs=jnp.zeros((steps, n, problem.motion.input_size)),
        horizon=jnp.asarray(steps),
        truth=Truth(state=state, measurement_noise=noise),
        arrivals=Arrivals(present=present, mean=means),
        team=team_draws(problem, poses, steps, n, seed),
    )
    protocol = TRUE._replace(gate=gate_limit(gate, problem.sensor.size))
    if problem.detections is not None:  # its filter has the gate
        episode, protocol = with_scans(problem, problem.detections, episode, seed), TRUE
    return PreparedReplay(
        protocol=protocol,
        problem=problem,
        slots=slots,
        episode=episode,
        truth=truth,
        inside=in_obstacles(problem.obstacles, slots),
        depth_m=max(float(kind.view.depth_m) for kind in scenario.kinds),
        agent_start=tuple(map(float, agent_start)),
        seed=seed,
    )


def _check(scenario: Scenario, problem: Problem, recording: Recording) -> None:
    if not problem.motion.begins_with_position:
        raise InputError("target.Z: a recording holds positions: expected states that begin with them, Z = [I 0]")
    if problem.detections is not None and problem.team is not None:
        right = "expected 1 with detections without ids: on a recording only robots that know ids are a team"
        raise InputError(f"scenario.team.agents = {problem.team.agents}: {right}")
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
    """Least standard deviation of a position that a robot measures; of other coordinates, in the middle of the view."""
    if problem.sensor.polar is None:
        return min(kind.sensor.std_m for kind in scenario.kinds)
    ahead_m = [0.5 * float(kind.view.depth_m) for kind in scenario.kinds]
    points = [jnp.asarray(m * np.eye(scenario.dimension)[0], float) for m in ahead_m]
    found = [own.sensor.equivalent(point) for own, point in zip(problem.kinds, points, strict=False)]
    return float(np.sqrt(min(np.linalg.eigvalsh(np.asarray(V))[0] for V in found)))


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
    return measured(ready, method, trace, decision_time(ready.problem, policy, ready.episode)), trace


def result(
    rows: Sequence[ReplayRow], experiment: Experiment, recording: Recording, facts: dict[str, Any]
) -> dict[str, Any]:
    """Content of a replay's JSON file: the rows, and their provenance."""
    inputs = {"experiment": digest(experiment), "recording_sha256": recording.sha256}
    if experiment.scenario.detections is not None:
        facts = {**facts, "detections": asdict(experiment.scenario.detections)}
    return {**provenance(), **inputs, **facts, "rows": [row.record() for row in rows]}
