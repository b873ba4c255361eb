"""Records of the Poisson multi-Bernoulli filter: what detections are like, tracks, and the state of the filter."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.models.detections.grid import Grid
from foveate.types import Count, Pose, Scalar

NO_IDENTITY = -1
"""Identity of a slot without a track."""


class Sources(eqx.Module):
    """Where targets of a simulation come from, beside those of its scene.

    Each of the boxes from `low` to `high` [m] has `first` targets before the first step, and Poisson births, `rate` a
    step in the mean; anywhere in the grid are Poisson many before the first step, `undetected` in the mean. All are
    uniform in their box.

    There is room for `scattered` of these, for `births` a step, for `others` alive at a time beside those of the scene,
    and for `clutter` false alarms a scan: so much that hardly ever one more is drawn, which then does not appear.
    """

    rate: Float[Array, " boxes"]
    low: Float[Array, "boxes d"]
    high: Float[Array, "boxes d"]
    undetected: Scalar
    first: tuple[int, ...] = eqx.field(static=True)
    scattered: int = eqx.field(static=True)
    births: int = eqx.field(static=True)
    others: int = eqx.field(static=True)
    clutter: int = eqx.field(static=True)

    @property
    def beginners(self) -> int:
        """Room for targets before the first step, beside those of the scene."""
        return sum(self.first) + self.scattered


class DetectionModel(eqx.Module):
    """Detections of an unknown number of targets, and their births and deaths.

    A target in the view, at range r [m], is detected with probability `probability` 2^-(r / half_range_m)^2, or
    `probability` without `half_range_m`. False alarms are Poisson, `clutter` a scan in the mean, uniform in the view of
    volume `view_volume` [m^d]. A target survives a step with probability `survival`; new ones appear with intensity
    `births` (expected number per cell and step), and `first` is that of the targets before the first step that no
    track stands for.

    `gate` is the largest squared Mahalanobis distance of a detection to a track that it may belong to; None: all may.
    Tracks with an existence below `recycle` return to the intensity of undetected targets. Which are reported follows
    from `confirm` and `cutoff`, the distance c of GOSPA [m] (`expectation.confirmed`). The filter has room for `tracks`
    tracks and `detections` detections a scan.

    In a simulation, policies are told of tracks above `tell`, targets of the scene begin as tracks (`known`) or not,
    and others come from `sources`.
    """

    probability: Scalar
    half_range_m: Scalar | None
    clutter: Scalar
    view_volume: Scalar
    survival: Scalar
    grid: Grid
    births: Float[Array, "*cells"]
    first: Float[Array, "*cells"]
    clutter_points_body: Float[Array, "points d"]
    """Points that fill the view evenly, from which false alarms are drawn [m]."""
    cutoff: Scalar
    gate: float | None = eqx.field(static=True, default=None)
    recycle: float = eqx.field(static=True, default=0.01)
    confirm: float = eqx.field(static=True, default=0.5)
    tracks: int = eqx.field(static=True, default=24)
    detections: int = eqx.field(static=True, default=16)
    tell: float = eqx.field(static=True, default=0.1)
    known: bool = eqx.field(static=True, default=True)
    sources: Sources | None = None

    def probability_at(self, range_m: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Probability of detection of a target in the view at this range [m]."""
        if self.half_range_m is None:
            return jnp.broadcast_to(self.probability, range_m.shape)
        return self.probability * jnp.exp2(-((range_m / self.half_range_m) ** 2))


class Tracks(eqx.Module):
    """Bernoulli tracks in slots of a fixed number; an empty slot has existence 0 and identity -1.

    `existence` is the probability that the target is there. Mean and covariance are of its state in the world, given
    that it is.
    """

    existence: Float[Array, "*b n"]
    mean: Float[Array, "*b n n_y"]
    covariance: Float[Array, "*b n n_y n_y"]
    identity: Int[Array, "*b n"]


class Look(eqx.Module):
    """The previous look: from where, the tracks that it missed, and the `excess` of each belief in what it showed.

    A belief that a view has cut is no Gaussian, and the Gaussian in its place has too much probability where the look
    missed: by `excess`, its share there less that by Bayes, for a target that is there.
    """

    pose: Pose
    missed: Bool[Array, " n"]
    excess: Float[Array, " n"]


class Population(eqx.Module):
    """State of the filter: tracks, the intensity of undetected targets per cell, and counters.

    `born` counts the tracks begun so far, and gives the next identity; `overflow` those dropped for want of a slot
    though their existence was above `recycle`.
    """

    tracks: Tracks
    undetected: Float[Array, "*cells"]
    look: Look
    born: Count
    overflow: Count

    @property
    def expected_number(self) -> Scalar:
        """Expected number of targets, those in tracks and those never detected."""
        return jnp.sum(self.tracks.existence) + jnp.sum(self.undetected)


class Scan(NamedTuple):
    """Detections of one scan z (m, n_z), in any order; those not `valid` are padding."""

    measurement: Float[Array, "m n_z"]
    valid: Bool[Array, " m"]


def empty_tracks(model: DetectionModel, prior_information: Float[Array, "n_y n_y"]) -> Tracks:
    """Slots without a track; their covariance is the identity, which every function of it can take."""
    n, n_y = model.tracks, len(prior_information)
    return Tracks(
        existence=jnp.zeros(n),
        mean=jnp.zeros((n, n_y)),
        covariance=jnp.broadcast_to(jnp.eye(n_y), (n, n_y, n_y)),
        identity=jnp.full(n, NO_IDENTITY),
    )
