"""Snapshot of an episode at a moment between two instants, for scenes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from foveate.geometry.numpy_poses import positions
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """State of an episode at one moment [m]: the agent, its path, the h targets that are present, and b beliefs.

    `tracks` and `tracked` (false where a target was absent) are those of ALL targets so far.
    """

    pose: Float[np.ndarray, "..."]
    path: Float[np.ndarray, "moments d"]
    tracks: Float[np.ndarray, "instants n d"]
    tracked: Bool[np.ndarray, "instants n"]
    truth: Float[np.ndarray, "h d"]
    estimate: Float[np.ndarray, "b d"]
    covariance: Float[np.ndarray, "b d d"]
    seen: Bool[np.ndarray, " b"]
    """Beliefs of targets that are detected; tracks of detections without ids that are confirmed."""
    existence: Float[np.ndarray, " b"]
    """Probability that there is a target, 1 with ids."""
    columns: Int[np.ndarray, " h"]
    """Column of each target that is present: with the number of the column, 1 for the first, it is named."""


def snapshot(
    data: EpisodeData, arc: Float[np.ndarray, "moments ..."], moment: int, trail: int | None = None
) -> Snapshot:
    """Snapshot of an episode at a moment. `arc` is `data.arc()`; tracks reach `trail` steps back, None for all.

    Between two instants the agent follows its arc, positions are interpolated linearly, and beliefs keep covariance and
    colour until the next measurement.
    """
    k, part = divmod(moment, SUBSTEPS)
    later, first = min(k + 1, data.steps), 0 if trail is None else max(0, k - trail)
    # A target that leaves within the step stays in place: the next position is that of another target, or of none.
    present, shown, tracks = data.present[k], data.believed[k], data.tracks

    def between(values: np.ndarray, there: Bool[np.ndarray, "instants _"]) -> np.ndarray:
        stays = there[k] & there[later]
        return values[k] + part / SUBSTEPS * stays[:, None] * (values[later] - values[k])

    truth = between(data.truth, data.present)
    existence = np.ones(len(shown)) if tracks is None else tracks.existence[k]
    seen = data.seen_at(k) if tracks is None else tracks.confirmed[k]
    return Snapshot(
        pose=arc[moment],
        path=positions(arc[first * SUBSTEPS : moment + 1]),
        tracks=np.concatenate([data.truth[first : k + 1], truth[None]]),
        tracked=np.concatenate([data.present[first : k + 1], present[None]]),
        truth=truth[present],
        estimate=between(data.estimate, data.believed)[shown],
        covariance=data.covariance[k][shown],
        seen=seen[shown],
        existence=existence[shown],
        columns=np.flatnonzero(present),
    )
