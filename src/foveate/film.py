"""One episode as numpy arrays, ready to be drawn: no padding, positions only, nothing left to compute."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from foveate.geometry.space import Space
from foveate.problem import Problem, Trace

SUBSTEPS = 6
"""Poses that `Film.arc` gives for each step; divisible by 1, 2 and 3, the frames a step may have."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Film:
    """One episode, cut to its horizon K and its n real targets; all in the world frame, in metres and seconds.

    `pose` is in the representation of `space`. `truth` and `estimate` are positions, `covariance` that of the
    estimated position, `visible[k]` and `log_det[k]` belong to instant k + 1. Where `present` is false a target is not
    there, and its other entries mean nothing. `outline`: the view's border(s) in the body frame.
    """

    title: str
    tau_s: float
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
            raise ValueError(
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

    def arc(self) -> Float[np.ndarray, "poses 3"]:
        """Planar poses along the way, SUBSTEPS a step: the twist that leads from one pose to the next is constant.

        That is the way the agent took if it turned by at most pi in the step. Raises ValueError in space.
        """
        self.require_planar()
        start, end = self.pose[:-1, None], self.pose[1:, None]
        share = np.arange(SUBSTEPS) / SUBSTEPS
        # In numpy, as jax would compile it anew for every length. An arc of w is its chord, sinc(w / 2) times as long,
        # seen at half the angle; so a part of it is the whole chord turned back, and shortened.
        w = -np.remainder(np.pi - (end - start)[..., 2], 2 * np.pi) + np.pi
        turn = -0.5 * (1 - share) * w
        length = share * np.sinc(share * w / (2 * np.pi)) / np.sinc(w / (2 * np.pi))
        x, y = (end - start)[..., 0], (end - start)[..., 1]
        ahead = length * (np.cos(turn) * x - np.sin(turn) * y), length * (np.sin(turn) * x + np.cos(turn) * y)
        between = start + np.stack([*ahead, share * w], axis=-1)
        return np.concatenate([between.reshape(-1, 3), self.pose[-1:]])

    def require_planar(self) -> None:
        """Raise ValueError for an episode in space."""
        if self.space.dimension != 2:
            raise ValueError(
                f"{self.title or 'film'}: pictures are planar: this episode is in {self.space.dimension}-D"
            )


def film(
    problem: Problem,
    trace: Trace,
    truth_state: Float[np.ndarray, "instants columns n_y"],
    horizon: int,
    targets: int,
    title: str = "",
) -> Film:
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
    tau_s = float(problem.tau)
    return Film(
        title=title,
        tau_s=tau_s,
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
