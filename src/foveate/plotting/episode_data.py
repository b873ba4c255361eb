"""One episode as numpy arrays, ready to be drawn: no padding, positions only, nothing left to compute."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from foveate.errors import InputError
from foveate.evaluation.evaluate import Suite, simulate
from foveate.geometry.numpy_poses import arc, positions
from foveate.geometry.space import Space
from foveate.models.problem import Problem
from foveate.simulation.records import PROTOCOLS, Policy, Trace

SUBSTEPS = 6
"""Poses that `EpisodeData.arc` gives for each step; divisible by 1, 2 and 3, the frames a step may have."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeData:
    """One episode, cut to its horizon K and its n real targets; all in the world frame, in metres and seconds.

    `pose` is in the representation of `space`. `truth` and `estimate` are positions, `covariance` that of the
    estimated position, `visible[k]` and `log_det[k]` belong to instant k + 1. Where `present` is false a target is not
    there, and its other entries mean nothing. `outline`: the view's border(s) in the body frame.
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
        """Whether a target was there before and after a step: only then there is a belief to update."""
        return self.present[1:] & self.present[:-1]

    @property
    def score(self) -> float | None:
        """Mean log det Y_K of the targets there at the end [nat per target], None without any."""
        there = self.present[-1] if self.steps else np.zeros(self.targets, bool)
        return float(self.log_det[-1][there].mean()) if there.any() else None

    @property
    def seen_share(self) -> float:
        """The share of measured targets among all targets of all steps, 0 without any."""
        return float((self.visible & self.counted).sum() / max(1, self.counted.sum()))

    def seen_at(self, instant: int) -> Bool[np.ndarray, " n"]:
        """Which targets were measured at an instant; none at the first."""
        return self.visible[instant - 1] if instant else np.zeros(self.targets, bool)

    def arc(self) -> Float[np.ndarray, "poses ..."]:
        """Poses along the way, SUBSTEPS a step: the twist that leads from one pose to the next is constant."""
        return arc(self.pose, SUBSTEPS)


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """What there is to see of a film at one moment [m]: the agent, its way, and the h targets that are there.

    `tracks` and `tracked` (whether it was there) are those of ALL targets so far.
    """

    pose: Float[np.ndarray, "..."]
    path: Float[np.ndarray, "poses d"]
    tracks: Float[np.ndarray, "instants n d"]
    tracked: Bool[np.ndarray, "instants n"]
    truth: Float[np.ndarray, "h d"]
    estimate: Float[np.ndarray, "h d"]
    covariance: Float[np.ndarray, "h d d"]
    seen: Bool[np.ndarray, " h"]


def snapshot(film: EpisodeData, way: Float[np.ndarray, "poses ..."], moment: int, trail: int | None = None) -> Snapshot:
    """A film at moment i: i / SUBSTEPS steps after the start. `way` is `film.arc()`; tracks reach `trail` steps back.

    Between two instants the agent is on its arc, positions are interpolated linearly, and a belief keeps its
    covariance and colour until the next measurement can have come.
    """
    k, part = divmod(moment, SUBSTEPS)
    later, share = min(k + 1, film.steps), part / SUBSTEPS
    here, stays = film.present[k], film.present[k] & film.present[later]

    def between(values: np.ndarray) -> np.ndarray:
        return values[k] + share * stays[:, None] * (values[later] - values[k])

    truth, first = between(film.truth), 0 if trail is None else max(0, k - trail)
    return Snapshot(
        pose=way[moment],
        path=positions(way[first * SUBSTEPS : moment + 1]),
        tracks=np.concatenate([film.truth[first : k + 1], truth[None]]),
        tracked=np.concatenate([film.present[first : k + 1], here[None]]),
        truth=truth[here],
        estimate=between(film.estimate)[here],
        covariance=film.covariance[k][here],
        seen=film.seen_at(k)[here],
    )


def episode_data(
    problem: Problem,
    trace: Trace,
    truth_state: Float[np.ndarray, "instants columns n_y"],
    horizon: int,
    targets: int,
    title: str = "",
) -> EpisodeData:
    """The film of ONE episode: `trace` and `truth_state` as numpy arrays, padded in steps and targets or not.

    The first `horizon` steps and the first `targets` columns count.
    """
    K, n = int(horizon), int(targets)
    Z = np.asarray(problem.motion.Z, float)
    present = np.asarray(trace.present)[: K + 1, :n]
    # An absent target has an information matrix that means nothing, and may not be invertible.
    information = np.where(
        present[..., None, None], np.asarray(trace.information, float)[: K + 1, :n], np.eye(Z.shape[1])
    )
    outline = problem.sensor.view.outline()
    return EpisodeData(
        title=title,
        space=problem.agent.space,
        visible=np.asarray(trace.visible)[:K, :n],
        log_det=np.asarray(trace.log_det, float)[:K, :n],
        times_s=np.concatenate([[0.0], np.cumsum(problem.step_lengths_s(K))]),
        pose=np.asarray(trace.pose, float)[: K + 1],
        truth=np.asarray(truth_state, float)[: K + 1, :n] @ Z.T,
        estimate=np.asarray(trace.mean, float)[: K + 1, :n] @ Z.T,
        covariance=Z @ np.linalg.inv(information) @ Z.T,
        present=present,
        outline=tuple(np.asarray(line, float) for line in ([outline] if isinstance(outline, np.ndarray) else outline)),
    )


def suite_data(suite: Suite, policy: Policy, protocol: str, name: str) -> list[EpisodeData]:
    """A policy of that name in every scene of a suite: the episodes whose rows an evaluation gives."""
    trace = simulate(suite, policy, PROTOCOLS[protocol])
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
