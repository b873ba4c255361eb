"""Measures of episodes whose detections have no ids: GOSPA with its parts, and what was seen of the targets."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from foveate.errors import InputError
from foveate.evaluation.gospa import Gospa, mean_gospa, pairs
from foveate.evaluation.metrics import longest_run, mean_or_none, mean_or_zero, nees, squared_position_error
from foveate.models.detections.records import DetectionModel
from foveate.models.problem import Problem
from foveate.names import Objective
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Trace
from foveate.simulation.team.records import TeamTrace


def protocols_in(scenario: Scenario, protocols: Sequence[str]) -> tuple[str, ...]:
    """The protocols that a scenario has: without ids there is no soft view, only the true one.

    Raises InputError where only the other is asked for.
    """
    if scenario.detections is None or "true" in protocols:
        return tuple(protocols) if scenario.detections is None else ("true",)
    raise InputError("protocol 'surrogate': expected true: detections without ids have no soft view")


def require_ids(scenario: Scenario, name: str) -> None:
    """Raise InputError about the option `name` in a scenario whose detections have no ids."""
    if scenario.detections is not None:
        raise InputError(f"{name}: expected none with scenario.detections: it plans for targets with known ids")


def detection_measures(
    problem: Problem,
    trace: Trace,
    truth: Float[np.ndarray, "rows instants targets n_y"],
    alive: Bool[np.ndarray, "rows instants targets"],
    scenes: Sequence[Scene],
    objective: Objective | None = None,
) -> list[dict[str, Any]]:
    """Measure episodes, padded or not, each of its own scene, for their rows of an evaluation."""
    model = problem.detections
    assert model is not None, "for problems with detections"
    assert trace.confirmed is not None, "traces of such problems have it"
    return [_row(problem, model, _of(trace, i), truth[i], alive[i], scene, objective) for i, scene in enumerate(scenes)]


class Estimates(NamedTuple):
    """Tracks after each step, of which those that are reported count."""

    mean: Float[np.ndarray, "K n n_y"]
    information: Float[np.ndarray, "K n n_y n_y"]
    reported: Bool[np.ndarray, "K n"]


def _of(trace: Trace, i: int) -> dict[str, np.ndarray]:
    names = ("mean", "information", "confirmed", "visible", "contacts", "dropped")
    return {name: np.asarray(part)[i] for name in names if (part := getattr(trace, name)) is not None}


def _row(
    problem: Problem,
    model: DetectionModel,
    trace: dict[str, np.ndarray],
    truth: Float[np.ndarray, "instants targets n_y"],
    alive: Bool[np.ndarray, "instants targets"],
    scene: Scene,
    objective: Objective | None,
) -> dict[str, Any]:
    steps, after = scene.horizon, slice(1, scene.horizon + 1)
    states, is_alive = truth[after].astype(float), alive[after]
    estimates = Estimates(*(trace[name][after] for name in ("mean", "information", "confirmed")))
    found, square_m2, error_nees = _errors(problem, model, estimates, states, is_alive)
    score = -found.gospa if scene.targets else None
    visible = trace["visible"][:steps] & is_alive
    seen = np.array([visible[begin:end, j].any() for j, begin, end in lives(is_alive)], bool)
    unseen_s = longest_run(is_alive & ~visible, problem.step_lengths_s(steps))
    return {
        "score": score,
        "entropy": None,
        "seen_fraction": mean_or_zero(seen),
        "seen_step_fraction": float(visible.sum() / max(1, is_alive.sum())),
        "longest_unseen_s": float(unseen_s.max(initial=0.0)),
        "rmse_m": None if square_m2 is None else math.sqrt(square_m2),
        "nees": error_nees,
        **dict.fromkeys(("rmse_seen_m", "rmse_unseen_m", "nees_seen", "nees_unseen")),
        "objective": score if objective == "gospa" else None,
        "contacts": int(trace["contacts"][steps - 1]) if "contacts" in trace else None,
        "gospa": found.gospa,
        "gospa_localisation": found.localisation,
        "gospa_missed": found.missed,
        "gospa_false": found.false,
        "dropped": int(trace["dropped"][steps - 1]),
    }


def _errors(
    problem: Problem,
    model: DetectionModel,
    estimates: Estimates,
    states: Float[np.ndarray, "K targets n_y"],
    alive: Bool[np.ndarray, "K targets"],
) -> tuple[Gospa, float | None, float | None]:
    """GOSPA, and after the last step mean squared error [m^2] and NEES of the tracks that it pairs with a target."""
    mean, information, reported = estimates.mean.astype(float), estimates.information, estimates.reported
    Z, cutoff_m = np.asarray(problem.motion.Z, float), float(np.asarray(model.cutoff))
    found = mean_gospa(mean @ Z.T, reported, states @ Z.T, alive, cutoff_m)
    tracks, targets = np.flatnonzero(reported[-1]), np.flatnonzero(alive[-1])
    rows, columns = pairs(mean[-1, tracks] @ Z.T, states[-1, targets] @ Z.T, cutoff_m)
    error = mean[-1, tracks[rows]] - states[-1, targets[columns]]
    own = nees(error, information[-1, tracks[rows]].astype(float))
    return found, mean_or_none(squared_position_error(error, Z)), mean_or_none(own)


def member_measures(
    problem: Problem,
    trace: TeamTrace | None,
    truth: Float[np.ndarray, "rows instants targets n_y"],
    alive: Bool[np.ndarray, "rows instants targets"],
    scenes: Sequence[Scene],
    objective: Objective | None = None,
) -> list[dict[str, Any]]:
    """Measure the robots of a team by the tracks of each, for the rows of their episodes; nothing of a single robot."""
    if trace is None:
        return [{} for _ in scenes]
    model, own = problem.detections, (trace.mean, trace.information, trace.confirmed)
    assert model is not None, "for problems with detections"
    parts = [np.asarray(part) for part in own if part is not None]
    rows = []
    for i, scene in enumerate(scenes):
        steps, after = scene.horizon, slice(1, scene.horizon + 1)
        real = truth[i, after].astype(float), alive[i, after]
        robots = [Estimates(*(part[i, :steps, m] for part in parts)) for m in range(parts[0].shape[2])]
        found = [_errors(problem, model, robot, *real) for robot in robots]
        worst = -max(each.gospa for each, _, _ in found) if scene.targets else None
        own_nees = np.array([value for _, _, value in found if value is not None])
        rows.append(
            {
                "agents": len(robots),
                "worst_score": worst,
                "worst_objective": worst if objective == "gospa" else None,
                "members_nees": mean_or_none(own_nees),
            }
        )
    return rows


def lives(alive: Bool[np.ndarray, "K targets"]) -> Iterator[tuple[int, int, int]]:
    """Place, first step and step after the last of every target: one after another may have the same place."""
    changes = np.diff(np.pad(alive.astype(int), ((1, 1), (0, 0))), axis=0)
    for j in range(alive.shape[1]):
        begins, ends = np.flatnonzero(changes[:, j] == 1), np.flatnonzero(changes[:, j] == -1)
        yield from ((j, int(begin), int(end)) for begin, end in zip(begins, ends, strict=True))
