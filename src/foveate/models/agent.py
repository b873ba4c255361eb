"""The agent's body: actuated axes of its twist, and their limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.space import Space
from foveate.types import Action, Pose, Scalar, Twist


class Agent(eqx.Module):
    """Kinematic body T' = T exp(tau hat(u)) with box limits on the actuated axes of u (paper, equation 1).

    `axes` are indices into the twist; `lower` and `upper` are their limits [m/s, rad/s]; the other axes stay 0. With
    `commands`, a row each, the body executes only these.
    """

    space: Space = eqx.field(static=True)
    axes: tuple[int, ...] = eqx.field(static=True)
    lower: Float[Array, " m"]
    upper: Float[Array, " m"]
    commands: Float[Array, "c m"] | None = None

    def control(self, action: Action) -> Float[Array, " m"]:
        """The command [m/s, rad/s] of any normalised action, exactly within the limits, or the nearest of `commands`.

        Distances to `commands` are in units of the limits. The derivative is that without `commands` (straight-through
        estimator), as the nearest command is constant almost everywhere.
        """
        share = 0.5 * (1.0 + jnp.clip(action, -1.0, 1.0))
        control = jnp.clip(self.lower + share * (self.upper - self.lower), self.lower, self.upper)
        if self.commands is None:
            return control
        away = (self.commands - control) / (self.upper - self.lower)
        nearest = self.commands[jnp.argmin(jnp.sum(away**2, axis=-1))]
        # The difference is exactly 0, so that the value is a command to the last bit.
        return nearest + (control - jax.lax.stop_gradient(control))

    def action(self, control: Float[Array, " m"]) -> Action:
        """The normalised action whose command is nearest to `control` [m/s, rad/s]."""
        return jnp.clip(2.0 * (control - self.lower) / (self.upper - self.lower) - 1.0, -1.0, 1.0)

    def twist(self, action: Action) -> Twist:
        """Body-frame twist of a normalised action, shape (n_u,)."""
        return self.on_all_axes(self.control(action))

    def on_all_axes(self, values: Float[Array, "*b m"]) -> Float[Array, "*b n_u"]:
        """Numbers of the actuated axes as numbers of every axis of the twist, 0 on those that are not actuated."""
        zero = jnp.zeros_like(values[..., 0])
        columns = [values[..., self.axes.index(i)] if i in self.axes else zero for i in range(self.space.twist_size)]
        return jnp.stack(columns, axis=-1)

    def move(self, pose: Pose, action: Action, tau: Scalar) -> Pose:
        """The pose after `tau` seconds of one constant action."""
        return self.space.move(pose, tau * self.twist(action))
