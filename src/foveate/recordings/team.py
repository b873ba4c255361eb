"""A team on a recording: where its robots start, their share of the random numbers, and what each makes of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.evaluation.metrics import mean_or_zero
from foveate.models.problem import Problem
from foveate.simulation.records import Trace
from foveate.simulation.team.records import TeamDraws

STREAM = 0x7465616D
"""Of the random numbers of the other robots: those of the first one are as without a team."""


@dataclass(frozen=True, kw_only=True)
class RobotRow:
    """Measures of one robot of a team on a recording, by its own beliefs and measurements.

    `log_det_mean` [nat] and `nees` are means over all targets and steps, `seen_time_fraction` is the share of
    target-steps that it has measured itself, `heard_fraction` that of the other robots' messages that have reached it.
    """

    log_det_mean: float
    nees: float
    seen_time_fraction: float
    heard_fraction: float


def first_poses(problem: Problem, numbers: Sequence[float]) -> Float[Array, "M ..."]:
    """The poses of all robots, whose numbers [m, rad] follow each other."""
    robots = 1 if problem.team is None else problem.team.agents
    by_robot = np.reshape(np.asarray(numbers, float), (robots, -1))
    return jnp.stack([problem.agent.space.from_numbers(own) for own in by_robot])


def team_draws(problem: Problem, poses: Float[Array, "M ..."], steps: int, columns: int, seed: int) -> TeamDraws | None:
    """What a replay fixes for the other robots and the radio; None for a single robot."""
    if problem.team is None:
        return None
    robots, rng = len(poses), np.random.default_rng([seed, STREAM])
    noise = rng.standard_normal((steps, robots - 1, columns, problem.sensor.size))
    radio = rng.uniform(0.0, 1.0, (steps, robots, robots))
    return TeamDraws(poses[1:], jnp.asarray(noise, float), jnp.asarray(radio, float))


def team_measures(trace: Trace, counted: Bool[np.ndarray, "K n"]) -> dict[str, Any]:
    """Fields of a row that only teams have, of a trace as numpy arrays; `counted` are the steps of present targets."""
    team = trace.team
    if team is None:
        return {}
    assert team.nees is not None, "of targets with ids"
    robots = team.log_det.shape[1]
    rows = tuple(
        RobotRow(
            log_det_mean=mean_or_zero(np.asarray(team.log_det[:, m], float)[counted]),
            nees=mean_or_zero(np.asarray(team.nees[:, m], float)[counted]),
            seen_time_fraction=mean_or_zero(np.asarray(team.visible[:, m])[counted]),
            heard_fraction=float(team.heard[:, m].sum()) / (len(team.heard) * (robots - 1)),
        )
        for m in range(robots)
    )
    return {
        "agents": robots,
        "worst_log_det_mean": min(row.log_det_mean for row in rows),
        "members_nees": float(np.mean([row.nees for row in rows])),
        "robots": rows,
    }


def rejected(trace: Trace) -> int:
    """Number of measurements that gates have rejected, of all robots."""
    counts = trace.rejections if trace.team is None else trace.team.rejections
    return 0 if counts is None else int((np.diff(counts, axis=0, prepend=0) > 0).sum())
