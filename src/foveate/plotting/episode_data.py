"""Episode data: one episode as numpy arrays to draw, with positions only and without padding."""

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from foveate.errors import InputError
from foveate.evaluation.evaluate import Suite, evaluate_traces
from foveate.evaluation.metrics import mean_log_det, mean_or_zero
from foveate.geometry.distance_grid import Nodes
from foveate.geometry.numpy_poses import arc
from foveate.geometry.space import Space
from foveate.models.problem import Problem
from foveate.plotting.ellipsoids import borders
from foveate.plotting.track_data import TrackData, intensities, track_data
from foveate.plotting.walls import walls_of
from foveate.simulation.records import PROTOCOLS, Policy, Trace

SUBSTEPS = 6
"""Moments per step; divisible by 1, 2 and 3, the frames a step may have."""

TRAIL_STEPS = 40
"""Length of trails and path in animations: thousands of steps of a recording would fill the picture."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeData:
    """One episode, cut to its horizon K and its n real targets; in the world frame, in metres and seconds.

    `pose` is as in `space`, `truth` and `estimate` are positions, `covariance` that of the estimated position;
    `visible[k]` and `log_det[k]` belong to instant k + 1. Where `present` is false, the other entries of a target mean
    nothing. There is a belief a target, b = n, unless beliefs are `tracks` of detections without ids. `outline`: the
    view's border(s) in the body frame; `walls`: distances to obstacles; `mates`: poses of further robots, with views
    `mate_outlines`; `heard`: whom each robot (rows) has heard. A *moment* counts SUBSTEPS to a step.
    """

    title: str
    space: Space
    visible: Bool[np.ndarray, "steps n"]
    log_det: Float[np.ndarray, "steps b"]
    times_s: Float[np.ndarray, " instants"]
    pose: Float[np.ndarray, "instants ..."]
    truth: Float[np.ndarray, "instants n d"]
    estimate: Float[np.ndarray, "instants b d"]
    covariance: Float[np.ndarray, "instants b d d"]
    present: Bool[np.ndarray, "instants n"]
    outline: tuple[Float[np.ndarray, "_ d"], ...]
    region: Float[np.ndarray, "2 d"] | None = None
    """Lower and upper corner of the region with borders, if the world has one."""
    walls: Nodes | None = None
    mates: Float[np.ndarray, "instants mates ..."] | None = None
    mate_outlines: tuple[tuple[Float[np.ndarray, "_ d"], ...], ...] | None = None
    heard: Bool[np.ndarray, "steps M M"] | None = None
    tracks: TrackData | None = None

    def __post_init__(self) -> None:
        if len(self.times_s) != self.steps + 1:
            raise InputError(f"times_s has {len(self.times_s)} instants: expected {self.steps + 1}, steps + 1")

    @property
    def poses(self) -> Float[np.ndarray, "instants robots ..."]:
        """Poses of all robots, the first one's first."""
        own = self.pose[:, None]
        return own if self.mates is None else np.concatenate([own, self.mates], axis=1)

    @property
    def outlines(self) -> tuple[tuple[Float[np.ndarray, "_ d"], ...], ...]:
        """Borders of the views of all robots, the first one's first."""
        return self.outline, *(self.mate_outlines or (self.outline,) * (self.poses.shape[1] - 1))

    @property
    def steps(self) -> int:
        """Number of steps, K."""
        return len(self.visible)

    @property
    def targets(self) -> int:
        """Number of columns n; in a recording several targets may use a column, one after another."""
        return self.visible.shape[1]

    @property
    def counted(self) -> Bool[np.ndarray, "steps n"]:
        """Targets present before and after a step: only these have a belief to update."""
        return self.present[1:] & self.present[:-1]

    @property
    def believed(self) -> Bool[np.ndarray, "instants b"]:
        """Beliefs to show: those of the targets present, or the tracks that a policy is told of."""
        return self.present if self.tracks is None else self.tracks.existence > self.tracks.tell

    @property
    def log_det_present(self) -> Float[np.ndarray, "steps b"]:
        """log det of the information of each belief after each step [nat], NaN where there is none."""
        return np.where(self.believed[1:], self.log_det, np.nan)

    @property
    def mean_log_det(self) -> Float[np.ndarray, " steps"]:
        """Score so far after each step [nat per target], NaN where no target is present."""
        return mean_log_det(self.log_det, self.believed[1:])

    @property
    def score(self) -> float | None:
        """Mean log det Y_K of the targets present at the end [nat per target], None without any or without ids."""
        has_score = self.tracks is None and self.steps and self.present[-1].any()
        return float(self.mean_log_det[-1]) if has_score else None

    @property
    def seen_share(self) -> float:
        """Share of measured targets among all targets of all steps, 0 without any."""
        return self.seen_share_until(self.steps)

    def seen_share_until(self, instant: int) -> float:
        """Share of measured targets among all targets of the steps up to an instant, 0 without any."""
        return mean_or_zero(self.visible[:instant][self.counted[:instant]])

    def seen_at(self, instant: int) -> Bool[np.ndarray, " n"]:
        """Targets present and measured at an instant; none at the first."""
        return self.present[instant] & self.visible[instant - 1] if instant else np.zeros(self.targets, bool)

    def time_at(self, moment: int) -> float:
        """Time of a moment [s]."""
        return float(np.interp(moment / SUBSTEPS, np.arange(self.steps + 1), self.times_s))

    def moment_at(self, time_s: float) -> int:
        """Last moment up to a time [s]."""
        # The tolerance keeps a time that rounding has put just before its moment.
        return int(SUBSTEPS * np.interp(time_s, self.times_s, np.arange(self.steps + 1)) + 1e-9)

    def arc(self) -> Float[np.ndarray, "moments ..."]:
        """Pose at each moment: the twist from one pose to the next is constant."""
        return arc(self.pose, SUBSTEPS)


def axis_range(values: Float[np.ndarray, "*m"]) -> tuple[float, float]:
    """Limits of an axis that shows all finite values with a margin, at least 2 apart."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    pad = max(0.06 * (high - low) + 0.1, 1.0 - (high - low) / 2)
    return low - pad, high + pad


def state_data(
    problem: Problem,
    *,
    pose: Float[np.ndarray, "instants ..."],
    mean: Float[np.ndarray, "instants b n_y"],
    information: Float[np.ndarray, "instants b n_y n_y"],
    log_det: Float[np.ndarray, "steps b"],
    visible: Bool[np.ndarray, "steps n"],
    present: Bool[np.ndarray, "instants n"],
    truth: Float[np.ndarray, "instants n n_y"],
    title: str = "",
    tracks: TrackData | None = None,
) -> EpisodeData:
    """Episode data of poses, beliefs and true states without padding."""
    Z = np.asarray(problem.motion.Z, float)
    # The information matrix of an absent target means nothing, and may be singular.
    exists = present if tracks is None else tracks.existence > 0
    information = np.where(exists[..., None, None], information, np.eye(Z.shape[1]))
    return EpisodeData(
        title=title,
        space=problem.agent.space,
        visible=visible,
        log_det=log_det,
        times_s=np.concatenate([[0.0], np.cumsum(problem.step_lengths_s(len(visible)))]),
        pose=pose,
        truth=truth @ Z.T,
        estimate=mean @ Z.T,
        covariance=Z @ np.linalg.inv(information) @ Z.T,
        present=present,
        outline=borders(problem.sensor.view),
        region=None if problem.region is None else np.array([problem.region.low, problem.region.high], float),
        walls=walls_of(problem),
        tracks=tracks,
    )


def episode_data(
    problem: Problem,
    trace: Trace,
    truth_state: Float[np.ndarray, "instants columns n_y"],
    horizon: int,
    targets: int,
    title: str = "",
    alive: Bool[np.ndarray, "instants columns"] | None = None,
    undetected: Float[np.ndarray, "instants *cells"] | None = None,
) -> EpisodeData:
    """Episode data of the first `horizon` steps and the first `targets` columns of ONE trace and its true states.

    Of detections without ids: `alive` targets, and the intensity of `undetected` ones at every instant, all columns.
    """
    tracks = None
    if alive is not None:
        targets, until = truth_state.shape[1], slice(horizon + 1)
        tracks = track_data(
            problem,
            existence=np.asarray(trace.existence, float)[until],
            confirmed=np.asarray(trace.confirmed)[until],
            mean=np.asarray(trace.mean, float)[until],
            truth=np.asarray(truth_state, float)[until],
            alive=alive[until],
            undetected=None if undetected is None else undetected[until],
        )
    steps, instants = (slice(horizon), slice(targets)), (slice(horizon + 1), slice(targets))
    beliefs = targets if tracks is None else tracks.existence.shape[1]
    data = state_data(
        problem,
        pose=np.asarray(trace.pose, float)[: horizon + 1],
        mean=np.asarray(trace.mean, float)[: horizon + 1, :beliefs],
        information=np.asarray(trace.information, float)[: horizon + 1, :beliefs],
        log_det=np.asarray(trace.log_det, float)[:horizon, :beliefs],
        visible=np.asarray(trace.visible)[steps],
        present=np.asarray(trace.present if alive is None else alive)[instants],
        truth=np.asarray(truth_state, float)[instants],
        title=title,
        tracks=tracks,
    )
    if trace.team is None:
        return data
    mates, heard = np.asarray(trace.team.pose, float)[: horizon + 1, 1:], np.asarray(trace.team.heard)[:horizon]
    outlines = tuple(borders(problem.of_robot(1 + i).sensor.view) for i in range(mates.shape[1]))
    return replace(data, mates=mates, mate_outlines=outlines, heard=heard)


def suite_data(suite: Suite, policy: Policy, protocol: str, name: str) -> list[EpisodeData]:
    """Run a policy through every episode of a suite, as an evaluation does.

    Args:
        suite: Suite with one episode per scene.
        policy: Policy that decides.
        protocol: "surrogate" or "true".
        name: Name of the policy, for the titles.
    """
    traces = evaluate_traces(suite, policy, PROTOCOLS[protocol])
    data = []
    for i, scene in enumerate(suite.scenes):
        trace = jax.tree.map(lambda x, i=i: x[i], traces)
        truth = np.asarray(suite.truth.state[i])
        title = f"{name} on {scene.id}" + ", soft view of the paper" * (protocol == "surrogate")
        problem = suite.problem if suite.problem.obstacles is None else suite.problem.of_map(jnp.asarray(scene.map))
        scans: dict[str, Any] = {}
        if suite.episodes.scans is not None:
            episode = jax.tree.map(lambda x, i=i: x[i], suite.episodes)
            scans = {"alive": np.asarray(episode.scans.alive), "undetected": intensities(problem, episode, trace)}
        data.append(episode_data(problem, trace, truth, scene.horizon, len(scene.targets), title, **scans))
    return data
