"""Array aliases, axis names of shapes, and frames.

Axis names used in shape annotations
    d     dimension of space: 2 in the plane, 3 in space
    n     targets of one scene
    n_y   state of one target, n_z its measurement, m_y its known input
    K     steps of an episode (K updates of the belief, none at k = 0)
    instants  K + 1: the start and the end of every step
    m     actuated axes of the agent, the length of an action
    n_u   length of a twist: 3 in the plane, 6 in space

Frames are part of a name
    *_world   the frame in which targets and agent live
    *_body    the agent's own frame: x ahead, y to the left, z up

Units are metres, seconds and radians.
"""

from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

Key = PRNGKeyArray
"""A typed JAX random key, used once."""

Pose = Float[Array, "..."]
"""Planar: [x, y, yaw], shape (3,). Spatial: homogeneous transform T, shape (4, 4). Body to world."""

Twist = Float[Array, " n_u"]
"""Body-frame velocity u = [v; w]. Planar: [v_x, v_y, w_z]. Spatial: [v_x, v_y, v_z, w_x, w_y, w_z]. [m/s, rad/s]"""

Action = Float[Array, " m"]
"""Normalised command in [-1, 1] for every actuated axis; the agent maps it to a twist within its limits."""

Point = Float[Array, " d"]
"""A position [m]; the frame is in the variable's name."""

Mean = Float[Array, " n_y"]
Information = Float[Array, "n_y n_y"]
Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Count = Int[Array, ""]
