"""Measures of a replay: what a method saw of the recorded targets, and how well it knew them."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from foveate.evaluation import metrics
from foveate.evaluation.gospa import mean_gospa, pairs
from foveate.evaluation.metrics import mean_or_none, mean_or_zero
from foveate.evaluation.rows import with_numbers
from foveate.models.detections.records import DetectionModel
from foveate.models.problem import Problem
from foveate.recordings.recording import Slots
from foveate.recordings.team import RobotRow, rejected, team_measures
from foveate.simulation.records import Episode, Protocol, Trace

OF_DETECTIONS = ("gospa", "gospa_localisation", "gospa_missed", "gospa_false", "dropped")
"""Fields of rows of detections without ids alone."""
OF_TEAMS = ("agents", "worst_log_det_mean", "members_nees", "robots")
"""Fields of rows of teams alone."""


@dataclass(frozen=True, kw_only=True)
class ReplayRow:
    """Measures of one method on one recording from one start.

    `targets` counts tracks present for at least a step. `log_det_mean` [nat], `rmse_m` and `nees` are means over all
    targets and steps; `*_seen` over tracks measured at least once, `*_unseen` over the others, null where there are
    none. `nees_band` holds at least 95 % of such means if the filter's covariance is right: the steps of a track, which
    are correlated, count as one. `seen_fraction` is the share of tracks measured at least once, `seen_time_fraction`
    that of target-steps with a measurement, `longest_unseen_s` the longest time of any track without one. `lost` counts
    tracks unseen at their end with an error above the depth of the view, `rejected` measurements outside the gate.

    With detections without ids `gospa` is the mean GOSPA over the steps [m] of the filter's confirmed tracks, whose
    parts are means too; `log_det_mean`, `rmse_m`, `nees` and its band are those of the confirmed tracks that GOSPA
    pairs with a target, over all steps, None (0 in a file) where none ever was; an error is then the distance to the
    nearest confirmed track for `lost`. `dropped` counts detections and tracks for which there was no room.

    `contacts` counts the agent's steps that an obstacle has ended, and `in_obstacles` the instants of targets that are
    inside of one, by the map; null without obstacles.

    Of a team of `agents` robots, whose poses follow each other in `agent_start`, the beliefs are those of one filter
    that hears every measurement; `rejected` and `contacts` are all robots'. `robots` has the measures of each by its
    own beliefs, `worst_log_det_mean` the least of their `log_det_mean`, `members_nees` the mean of their `nees`.
    """

    method: str
    seed: int
    agent_start: tuple[float, ...]
    targets: int
    log_det_mean: float | None
    seen_fraction: float
    seen_time_fraction: float
    longest_unseen_s: float
    rmse_m: float | None
    nees: float | None
    nees_band: tuple[float, float] | None
    rmse_seen_m: float | None
    rmse_unseen_m: float | None
    nees_seen: float | None
    nees_unseen: float | None
    lost: int
    rejected: int
    step_time_s: float
    gospa: float | None = None
    gospa_localisation: float | None = None
    gospa_missed: float | None = None
    gospa_false: float | None = None
    dropped: int | None = None
    contacts: int | None = None
    in_obstacles: int | None = None
    agents: int | None = None
    worst_log_det_mean: float | None = None
    members_nees: float | None = None
    robots: tuple[RobotRow, ...] | None = None

    def record(self) -> dict[str, Any]:
        """All fields as plain values; those of detections without ids and of teams only there.

        The errors of no track are 0.
        """
        left_out = (*(OF_DETECTIONS if self.gospa is None else ()), *(OF_TEAMS if self.robots is None else ()))
        return with_numbers({name: value for name, value in asdict(self).items() if name not in left_out})


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


def measured(ready: PreparedReplay, method: str, trace: Trace, step_time_s: float) -> ReplayRow:
    """Measures of the trace of a method (numpy arrays), whose decisions take `step_time_s` [s]."""
    index, tau, model = ready.slots.track_index, float(ready.problem.tau), ready.problem.detections
    # A step counts for tracks present before and after it: at its first instant a track has no belief to update.
    counted = (index[1:] >= 0) & (index[1:] == index[:-1])
    visible = trace.visible & counted
    square_m2 = _own_errors(ready, trace) if model is None else _nearest(ready, model, trace)
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
    if model is None:
        errors = _of_beliefs(ready, trace, square_m2, counted, of_seen, np.array(lengths))
    else:
        errors = _of_tracks(ready, model, trace)
    return ReplayRow(
        method=method,
        seed=ready.seed,
        agent_start=ready.agent_start,
        targets=len(lengths),
        seen_fraction=mean_or_zero(np.array(seen, bool)),
        seen_time_fraction=mean_or_zero(visible[counted]),
        longest_unseen_s=longest,
        lost=lost,
        rejected=rejected(trace),
        step_time_s=step_time_s,
        contacts=None if trace.contacts is None else int(trace.contacts[-1]),
        in_obstacles=None if ready.inside is None else int(ready.inside.sum()),
        **errors,
        **team_measures(trace, counted),
    )


def _own_errors(ready: PreparedReplay, trace: Trace) -> Float[np.ndarray, "K columns"]:
    """Squared error of the position of each target's own belief after each step [m^2]."""
    error = np.asarray(trace.mean, float)[1:] - ready.truth[1:]
    return metrics.squared_position_error(error, np.asarray(ready.problem.motion.Z, float))


def _of_beliefs(
    ready: PreparedReplay,
    trace: Trace,
    square_m2: Float[np.ndarray, "K columns"],
    counted: Bool[np.ndarray, "K columns"],
    of_seen: Bool[np.ndarray, "K columns"],
    lengths: np.ndarray,
) -> dict[str, Any]:
    """Errors of every target's own belief, and its consistency."""
    error = np.asarray(trace.mean, float)[1:] - ready.truth[1:]
    nees = metrics.nees(error, np.asarray(trace.information, float)[1:])
    return {
        "log_det_mean": mean_or_zero(np.asarray(trace.log_det, float)[counted]),
        # The steps of a track are correlated: tracks are the samples, weighted by their lengths.
        "nees_band": metrics.chi_square_band(ready.truth.shape[-1], metrics.effective_count(lengths)),
        **metrics.error_measures(square_m2[counted], nees[counted], of_seen[counted]),
    }


def _reported(trace: Trace) -> Bool[np.ndarray, "K tracks"]:
    assert trace.confirmed is not None, "traces of detections without ids have it"
    return np.asarray(trace.confirmed)[1:]


def _nearest(ready: PreparedReplay, model: DetectionModel, trace: Trace) -> Float[np.ndarray, "K columns"]:
    """Squared distance of each target to the nearest confirmed track after each step [m^2]; infinite without any."""
    Z, reported = np.asarray(ready.problem.motion.Z, float), _reported(trace)
    square_m2 = np.full(ready.truth.shape[:2], np.inf)[1:]
    for k, which in enumerate(reported):
        apart = (np.asarray(trace.mean[k + 1, which], float)[:, None] - ready.truth[k + 1]) @ Z.T
        square_m2[k] = (apart**2).sum(axis=-1).min(axis=0, initial=np.inf)
    return square_m2


def _of_tracks(ready: PreparedReplay, model: DetectionModel, trace: Trace) -> dict[str, Any]:
    """GOSPA of the confirmed tracks, and the errors of those that it pairs with targets."""
    assert trace.dropped is not None, "traces of detections without ids have it"
    Z, cutoff_m = np.asarray(ready.problem.motion.Z, float), float(np.asarray(model.cutoff))
    mean, reported, truth = np.asarray(trace.mean, float)[1:], _reported(trace), ready.truth[1:]
    there, index = ready.slots.present[1:], ready.slots.track_index[1:]
    found = mean_gospa(mean @ Z.T, reported, truth @ Z.T, there, cutoff_m)
    errors, information, of = [], [], []
    for k in range(len(truth)):
        tracks, targets = np.flatnonzero(reported[k]), np.flatnonzero(there[k])
        rows, columns = pairs(mean[k, tracks] @ Z.T, truth[k, targets] @ Z.T, cutoff_m)
        errors.append(mean[k, tracks[rows]] - truth[k, targets[columns]])
        information.append(np.asarray(trace.information[k + 1, tracks[rows]], float))
        of.append(index[k, targets[columns]])
    error, matrices = np.concatenate(errors), np.concatenate(information)
    lengths = np.unique(np.concatenate(of), return_counts=True)[1]
    square_m2 = mean_or_none(metrics.squared_position_error(error, Z))
    band = metrics.chi_square_band(truth.shape[-1], metrics.effective_count(lengths)) if len(lengths) else None
    return {
        "log_det_mean": mean_or_none(np.linalg.slogdet(matrices)[1]),
        "rmse_m": None if square_m2 is None else square_m2**0.5,
        "nees": mean_or_none(metrics.nees(error, matrices)),
        "nees_band": band,
        **dict.fromkeys(("rmse_seen_m", "rmse_unseen_m", "nees_seen", "nees_unseen")),
        "gospa": found.gospa,
        "gospa_localisation": found.localisation,
        "gospa_missed": found.missed,
        "gospa_false": found.false,
        "dropped": int(trace.dropped[-1]),
    }
