"""Measures of episodes whose detections have no ids: GOSPA with its parts, and what was seen of the targets."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from foveate.errors import InputError
from foveate.evaluation.gospa import mean_gospa, pairs
from foveate.evaluation.metrics import longest_run, mean_or_none, mean_or_zero, nees, squared_position_error
from foveate.models.detections.records import DetectionModel
from foveate.models.problem import Problem
from foveate.names import Objective
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Trace


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
    steps, Z = scene.horizon, np.asarray(problem.motion.Z, float)
    states, is_alive = truth[1 : steps + 1].astype(float), alive[1 : steps + 1]
    mean, reported = trace["mean"][1 : steps + 1].astype(float), trace["confirmed"][1 : steps + 1]
    cutoff_m = float(np.asarray(model.cutoff))
    found = mean_gospa(mean @ Z.T, reported, states @ Z.T, is_alive, cutoff_m)
    score = -found.gospa if scene.targets else None
    visible = trace["visible"][:steps] & is_alive
    seen = np.array([visible[begin:end, j].any() for j, begin, end in lives(is_alive)], bool)
    unseen_s = longest_run(is_alive & ~visible, problem.step_lengths_s(steps))
    tracks, targets = np.flatnonzero(reported[-1]), np.flatnonzero(is_alive[-1])
    rows, columns = pairs(mean[-1, tracks] @ Z.T, states[-1, targets] @ Z.T, cutoff_m)
    error = mean[-1, tracks[rows]] - states[-1, targets[columns]]
    information = trace["information"][steps, tracks[rows]].astype(float)
    square_m2 = mean_or_none(squared_position_error(error, Z))
    return {
        "score": score,
        "entropy": None,
        "seen_fraction": mean_or_zero(seen),
        "seen_step_fraction": float(visible.sum() / max(1, is_alive.sum())),
        "longest_unseen_s": float(unseen_s.max(initial=0.0)),
        "rmse_m": None if square_m2 is None else math.sqrt(square_m2),
        "nees": mean_or_none(nees(error, information)),
        **dict.fromkeys(("rmse_seen_m", "rmse_unseen_m", "nees_seen", "nees_unseen")),
        "objective": score if objective == "gospa" else None,
        "contacts": int(trace["contacts"][steps - 1]) if "contacts" in trace else None,
        "gospa": found.gospa,
        "gospa_localisation": found.localisation,
        "gospa_missed": found.missed,
        "gospa_false": found.false,
        "dropped": int(trace["dropped"][steps - 1]),
    }


def lives(alive: Bool[np.ndarray, "K targets"]) -> Iterator[tuple[int, int, int]]:
    """Place, first step and step after the last of every target: one after another may have the same place."""
    changes = np.diff(np.pad(alive.astype(int), ((1, 1), (0, 0))), axis=0)
    for j in range(alive.shape[1]):
        begins, ends = np.flatnonzero(changes[:, j] == 1), np.flatnonzero(changes[:, j] == -1)
        yield from ((j, int(begin), int(end)) for begin, end in zip(begins, ends, strict=True))
