"""Records of a team: what an episode fixes for it, what a robot knows of the others, and what is recorded."""

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from foveate.types import Count


class TeamDraws(eqx.Module):
    """What an episode fixes for the robots beside the first, and for the radio.

    `poses` are their first poses, `measurement_noise` is as in `Truth`, and `radio` is uniform in [0, 1) for each
    receiver (row) and sender: a message is lost where it is below the radio's loss. In the parts of one step there is
    no axis of steps.
    """

    poses: Float[Array, "mates ..."]
    measurement_noise: Float[Array, "*K mates n n_z"]
    radio: Float[Array, "*K M M"]


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
    """

    pose: Float[Array, "instants M ..."]
    action: Float[Array, "K M m"]
    log_det: Float[Array, "K M n"]
    nees: Float[Array, "K M n"]
    visible: Bool[Array, "K M n"]
    heard: Bool[Array, "K M M"]
    rejections: Int[Array, "K M n"] | None = None
