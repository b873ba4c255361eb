"""One episode as numpy arrays, ready to be drawn: no padding, positions only, nothing left to simulate."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from foveate.errors import InputError
from foveate.evaluation.evaluate import Suite, evaluate_traces
from foveate.evaluation.metrics import mean_log_det, mean_or_zero
from foveate.geometry.numpy_poses import arc, positions
from foveate.geometry.space import Space
from foveate.models.problem import Problem
from foveate.simulation.records import PROTOCOLS, Policy, Trace

SUBSTEPS = 6
"""Poses that `EpisodeData.arc` gives for each step; divisible by 1, 2 and 3, the frames a step may have."""

TRAIL_STEPS = 40
"""Length of trails and paths in animations, as recordings of thousands of steps would fill the picture."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeData:
    """One episode, cut to its horizon K and its n real targets; all in the world frame, in metres and seconds.

    `pose` is in the representation of `space`. `truth` and `estimate` are positions, `covariance` that of the
    estimated position, `visible[k]` and `log_det[k]` belong to instant k + 1. Where `present` is false a target is
    absent, and its other entries mean nothing. `outline`: the view's border(s) in the body frame. A *moment* is a time
    in SUBSTEPS of a step, counted from the start.
    """

    title: str
    space: Space
    visible: Bool[np.ndarray, "steps n"]
    log_det: Float[np.ndarray, "steps n"]
    times_s: Float[np.ndarray, " instants"]
    pose: Float[np.ndarray, "instants ..."]
    truth: Float[np.ndarray, "instants n d"]
    estimate: Float[np.ndarray, "instants n d"]
    covariance: Float[np.ndarray, "instants n d d"]
    present: Bool[np.ndarray, "instants n"]
    outline: tuple[Float[np.ndarray, "_ d"], ...]

    def __post_init__(self) -> None:
        if len(self.times_s) != len(self.visible) + 1:
            raise InputError(
                f"times_s has {len(self.times_s)} instants: expected {len(self.visible) + 1}, one more than steps"
            )

    @property
    def steps(self) -> int:
        """K."""
        return len(self.visible)

    @property
    def targets(self) -> int:
        """n: columns, each of which may serve several targets of a recording one after another."""
        return self.visible.shape[1]

    @property
    def counted(self) -> Bool[np.ndarray, "steps n"]:
        """Targets present before and after a step: only these have a belief to update."""
        return self.present[1:] & self.present[:-1]

    @property
    def log_det_present(self) -> Float[np.ndarray, "steps n"]:
        """log det of each target's information after each step [nat], NaN where it is absent."""
        return np.where(self.present[1:], self.log_det, np.nan)

    @property
    def mean_log_det(self) -> Float[np.ndarray, " steps"]:
        """Score so far after each step [nat per target], NaN where no target is present."""
        return mean_log_det(self.log_det, self.present[1:])

    @property
    def score(self) -> float | None:
        """Mean log det Y_K of the targets present at the end [nat per target], None without any."""
        return float(self.mean_log_det[-1]) if self.steps and self.present[-1].any() else None

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

    def arc(self) -> Float[np.ndarray, "poses ..."]:
        """Poses along the way, SUBSTEPS a step: the twist that leads from one pose to the next is constant."""
        return arc(self.pose, SUBSTEPS)


def axis_range(values: Float[np.ndarray, "*m"]) -> tuple[float, float]:
    """Lower and upper end of an axis that shows all finite values, with some room, also where all are equal."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    pad = 0.06 * (high - low) + 0.1
    return low - pad, high + pad


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """State of an episode at one moment [m]: the agent, its path, and the h targets that are present.

    `tracks` and `tracked` (false where a target was absent) are those of ALL targets so far.
    """

    pose: Float[np.ndarray, "..."]
    path: Float[np.ndarray, "poses d"]
    tracks: Float[np.ndarray, "instants n d"]
    tracked: Bool[np.ndarray, "instants n"]
    truth: Float[np.ndarray, "h d"]
    estimate: Float[np.ndarray, "h d"]
    covariance: Float[np.ndarray, "h d d"]
    seen: Bool[np.ndarray, " h"]


def snapshot(data: EpisodeData, arc: Float[np.ndarray, "poses ..."], moment: int, trail: int | None = None) -> Snapshot:
    """Snapshot of an episode at a moment. `arc` is `data.arc()`; tracks reach `trail` steps back, None for all.

    Between two instants the agent is on its arc, positions are interpolated linearly, and a belief keeps its
    covariance and colour until the next measurement can have come.
    """
    k, part = divmod(moment, SUBSTEPS)
    later, share = min(k + 1, data.steps), part / SUBSTEPS
    # A target that leaves within the step stays where it was: its next position is another target's, or none.
    present, stays = data.present[k], data.present[k] & data.present[later]

    def between(values: np.ndarray) -> np.ndarray:
        return values[k] + share * stays[:, None] * (values[later] - values[k])

    truth, first = between(data.truth), 0 if trail is None else max(0, k - trail)
    return Snapshot(
        pose=arc[moment],
        path=positions(arc[first * SUBSTEPS : moment + 1]),
        tracks=np.concatenate([data.truth[first : k + 1], truth[None]]),
        tracked=np.concatenate([data.present[first : k + 1], present[None]]),
        truth=truth[present],
        estimate=between(data.estimate)[present],
        covariance=data.covariance[k][present],
        seen=data.seen_at(k)[present],
    )


def state_data(
    problem: Problem,
    *,
    pose: Float[np.ndarray, "instants ..."],
    mean: Float[np.ndarray, "instants n n_y"],
    information: Float[np.ndarray, "instants n n_y n_y"],
    log_det: Float[np.ndarray, "steps n"],
    visible: Bool[np.ndarray, "steps n"],
    present: Bool[np.ndarray, "instants n"],
    truth: Float[np.ndarray, "instants n n_y"],
    title: str = "",
) -> EpisodeData:
    """Episode data of poses, beliefs and true states without padding."""
    Z = np.asarray(problem.motion.Z, float)
    # An absent target has an information matrix that means nothing, and may not be invertible.
    information = np.where(present[..., None, None], information, np.eye(Z.shape[1]))
    outline = problem.sensor.view.outline()
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
        outline=tuple(np.asarray(line, float) for line in ([outline] if isinstance(outline, np.ndarray) else outline)),
    )


def episode_data(
    problem: Problem,
    trace: Trace,
    truth_state: Float[np.ndarray, "instants columns n_y"],
    horizon: int,
    targets: int,
    title: str = "",
) -> EpisodeData:
    """Episode data of ONE trace: `trace` and `truth_state` as numpy arrays, padded in steps and targets or not.

    The first `horizon` steps and the first `targets` columns count.
    """
    K, n = int(horizon), int(targets)
    return state_data(
        problem,
        pose=np.asarray(trace.pose, float)[: K + 1],
        mean=np.asarray(trace.mean, float)[: K + 1, :n],
        information=np.asarray(trace.information, float)[: K + 1, :n],
        log_det=np.asarray(trace.log_det, float)[:K, :n],
        visible=np.asarray(trace.visible)[:K, :n],
        present=np.asarray(trace.present)[: K + 1, :n],
        truth=np.asarray(truth_state, float)[: K + 1, :n],
        title=title,
    )


def suite_data(suite: Suite, policy: Policy, protocol: str, name: str) -> list[EpisodeData]:
    """Run a policy of that name through every scene of a suite: the episodes whose rows an evaluation gives."""
    trace = evaluate_traces(suite, policy, PROTOCOLS[protocol])
    return [
        episode_data(
            suite.problem,
            jax.tree.map(lambda x, i=i: x[i], trace),
            np.asarray(suite.truth.state[i]),
            scene.horizon,
            len(scene.targets),
            f"{name}, {scene.id}, {protocol} protocol",
        )
        for i, scene in enumerate(suite.scenes)
    ]
