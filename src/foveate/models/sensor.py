"""The agent's sensor: z = H y + eta, eta ~ N(0, V), only inside the field of view; or z = h(q) + eta (`polar`)."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.fov import FieldOfView
from foveate.geometry.linalg import inverse_spd, multiply
from foveate.models import polar_filter
from foveate.models.polar import Polar, coordinates_of, jacobian, noise


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

    With `polar` it measures z = h(q) of the position q = R^T (H y - t) in the body frame (see `models.polar`): H is the
    position's matrix Z, V is in the measured coordinates [m^2, rad^2] for a range of 0, and neither frame nor
    `range_growth` is used.
    """

    H: Float[Array, "n_h n_y"]
    V: Float[Array, "n_z n_z"]
    view: FieldOfView
    range_growth: float = eqx.field(static=True, default=0.0)
    frame: Literal["world", "body"] = eqx.field(static=True, default="world")
    uses_missed_detections: bool = eqx.field(static=True, default=False)
    polar: Polar | None = eqx.field(static=True, default=None)

    @property
    def size(self) -> int:
        """Length n_z of a measurement."""
        return self.V.shape[-1]

    def covariance(self, rotation: Float[Array, "d d"], point_body: Float[Array, " d"]) -> Float[Array, "n_z n_z"]:
        """V in the world frame for a target at `point_body` [m]; `rotation` is the agent's, body to world.

        That of a `polar` sensor is in its own coordinates.
        """
        V = self.V
        if self.polar is not None:
            return noise(jnp, self.polar, V, point_body)
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

    def gain(self, rotation: Float[Array, "d d"], point_body: Float[Array, " d"]) -> Float[Array, "n_y n_y"]:
        """Information of one measurement of a target at `point_body`, linearised there."""
        V = self.covariance(rotation, point_body)
        if self.polar is None:
            return self.information(V)
        J = multiply(jacobian(jnp, self.polar, point_body), multiply(rotation.T, self.H))
        return multiply(multiply(J.T, inverse_spd(V)), J)

    def expected(self, state: Float[Array, "n n_y"], position_body: Float[Array, "n d"]) -> Float[Array, "n n_z"]:
        """Measurements without noise of targets with these states, at these positions in the body frame."""
        if self.polar is None:
            return state @ self.H.T
        return coordinates_of(jnp, self.polar, position_body)

    def one_point(self, measurement: Float[Array, " n_z"]) -> tuple[Float[Array, " d"], Float[Array, "d d"]]:
        """Mean and covariance in the body frame [m] of a position of which a `polar` sensor has measured this."""
        assert self.polar is not None, "for sensors that measure in their own coordinates"
        reach = polar_filter.reach_of(jnp, self.view.extent)
        return polar_filter.one_point(jnp, self.polar, measurement, self.V, reach, self.H.shape[0])

    def equivalent(self, point_body: Float[Array, " d"]) -> Float[Array, "n n"]:
        """Covariance of a position that a `polar` sensor has measured at a point [m^2]: the noise a policy is told."""
        assert self.polar is not None, "for sensors that measure in their own coordinates"
        return self.one_point(coordinates_of(jnp, self.polar, point_body))[1]
