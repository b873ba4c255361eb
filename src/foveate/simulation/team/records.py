"""Records of a team: what an episode fixes for it, what a robot knows of the others, and what is recorded."""

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax
from jaxtyping import Array, Bool, Float, Int

from foveate.types import Count


class MateScans(eqx.Module):
    """Random numbers of the scans of the robots beside the first, of detections without ids: as in `ScanNoise`."""

    detection: Float[Array, "*K mates targets"]
    clutter_body: Float[Array, "*K mates alarms d"]
    is_false: Bool[Array, "*K mates alarms"]
    order: Float[Array, "*K mates candidates"]


class TeamDraws(eqx.Module):
    """What an episode fixes for the robots beside the first, and for the radio.

    `poses` are their first poses, `measurement_noise` is as in `Truth`, and `radio` is uniform in [0, 1) for each
    receiver (row) and sender: a message is lost where it is below the radio's loss. `scans` is None of detections with
    ids. In the parts of one step there is no axis of steps.
    """

    poses: Float[Array, "mates ..."]
    measurement_noise: Float[Array, "*K mates n n_z"]
    radio: Float[Array, "*K M M"]
    scans: MateScans | None = None

    def of_steps(self, change: Callable[[Array], Array]) -> "TeamDraws":
        """The draws, with every array that has an axis of steps changed."""
        noise, radio, scans = jax.tree.map(change, (self.measurement_noise, self.radio, self.scans))
        return replace(self, measurement_noise=noise, radio=radio, scans=scans)


class TeamView(eqx.Module):
    """What a robot knows of its team: the newest it has heard of each member, itself included.

    `number` is its own; `pose` is in the world frame; `age` is the number of steps since the news, 0 for its own.
    `claims` are what each member's policy has said of every target (`Policy.claims`).
    """

    number: Count
    pose: Float[Array, "M ..."]
    age: Int[Array, " M"]
    claims: Float[Array, "M n"]


class TeamTrace(eqx.Module):
    """Record of every robot of a team, beside that of what all of them have measured.

    `log_det` and `nees` are those of each robot's own beliefs after each step, `visible` marks what it has measured,
    `heard` the senders (columns) whose message of this step reaches a receiver (rows). `rejections` counts the
    measurements in a row that a robot's gate has rejected; None without a gate.

    Without ids beliefs are each robot's own tracks, with their `mean` and `information`, of which the `confirmed` are
    reported; `expected_number` is that of all targets. `visible` is of true targets, and `nees` is None, as nothing
    says of which target a track is.
    """

    pose: Float[Array, "instants M ..."]
    action: Float[Array, "K M m"]
    log_det: Float[Array, "K M n"]
    nees: Float[Array, "K M n"] | None
    visible: Bool[Array, "K M targets"]
    heard: Bool[Array, "K M M"]
    rejections: Int[Array, "K M n"] | None = None
    mean: Float[Array, "K M n n_y"] | None = None
    information: Float[Array, "K M n n_y n_y"] | None = None
    confirmed: Bool[Array, "K M n"] | None = None
    expected_number: Float[Array, "K M"] | None = None
