"""The agent's sensor: z = H y + eta, eta ~ N(0, V), only inside the field of view."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.fov import FieldOfView
from foveate.geometry.linalg import inverse_spd, multiply


class Softness(NamedTuple):
    """Blur of the differentiable field of view: offset [-] and kappa [m]."""

    offset: float
    kappa: float


PAPER_SOFTNESS = Softness(offset=2.0, kappa=0.4)
"""The paper's level. A target 1.13 m outside still counts half."""


def detection_weight(distance: Float[Array, "*b"], softness: Softness) -> Float[Array, "*b"]:
    """1 - Phi(d), Phi(d) = [1 + erf(d / (sqrt 2 kappa) - offset)] / 2, of a signed distance d [m] (paper, equation 20).

    It is 1 inside of the field of view, where d < 0, and 0 far outside.
    """
    return 0.5 * jax.scipy.special.erfc(distance / (jnp.sqrt(2.0) * softness.kappa) - softness.offset)


class Sensor(eqx.Module):
    """A linear sensor with a limited field of view.

    V is the covariance of the noise [m^2], given in `frame`. In the body frame it turns with the agent,
    V_world = R V R^T (then n_z = d). The noise's standard deviation grows with the range r [m] to the target by the
    factor 1 + range_growth r. With `uses_missed_detections` the Kalman filter (not a soft view) also takes missed
    detections as negative information (see `models.missed_detection`).
    """

    H: Float[Array, "n_z n_y"]
    V: Float[Array, "n_z n_z"]
    view: FieldOfView
    range_growth: float = eqx.field(static=True, default=0.0)
    frame: Literal["world", "body"] = eqx.field(static=True, default="world")
    uses_missed_detections: bool = eqx.field(static=True, default=False)

    def covariance(self, rotation: Float[Array, "d d"], point_body: Float[Array, " d"]) -> Float[Array, "n_z n_z"]:
        """V in the world frame for a target at `point_body` [m]; `rotation` is the agent's, body to world."""
        V = self.V
        if self.frame == "body":
            V = multiply(multiply(rotation, V), rotation.T)
        if self.range_growth == 0.0:
            return V
        square = jnp.sum(point_body**2)
        # The root's derivative at 0 is infinite; a target at the apex gets a range of 0 with derivative 0.
        distance = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
        return V * (1.0 + self.range_growth * distance) ** 2

    def information(self, covariance: Float[Array, "n_z n_z"]) -> Float[Array, "n_y n_y"]:
        """H^T V^-1 H, the information of one measurement."""
        return multiply(multiply(self.H.T, inverse_spd(covariance)), self.H)
