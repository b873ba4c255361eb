"""What is drawn for an episode before its first step: a random scene, and all random numbers."""

import equinox as eqx
from jaxtyping import Array, Bool, Float

from foveate.types import Count, Pose


class Drawn(eqx.Module):
    """A random scene as arrays, padded to a fixed number of targets."""

    pose: Pose
    position: Float[Array, "n d"]
    drift: Float[Array, "n d"]
    present: Bool[Array, " n"]
    horizon: Count
    map_number: Count | None = None
    others: Float[Array, "mates ..."] | None = None
    """Poses of the other robots of a team."""


class Noise(eqx.Module):
    """All random numbers of one episode: uniform jitter in [-1, 1], and standard normals for the rest.

    With detections without ids there are those of `simulation.population`, too: uniform in [0, 1).
    """

    jitter: Float[Array, "K n d"]
    process: Float[Array, "K n n_y"]
    measurement: Float[Array, "K n n_z"]
    first: Float[Array, "n n_y"]
    beginning: Float[Array, " numbers"] | None = None
    steps: Float[Array, "K numbers_a_step"] | None = None
    fates: Float[Array, "K n numbers_a_target"] | None = None
    mates: Float[Array, "K mates n n_z"] | None = None
    """Standard normals for the measurements of the other robots of a team."""
    radio: Float[Array, "K M M"] | None = None
    """Uniform in [0, 1), for a team's radio."""
    mate_steps: Float[Array, "K mates numbers_a_scan"] | None = None
    mate_fates: Float[Array, "K mates n 2"] | None = None
    """Uniform in [0, 1), for the scans of the other robots of a team without ids (`simulation.team.mate_scans`)."""
