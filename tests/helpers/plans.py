"""Problems and futures to plan in: the paper's, and one of velocities in space with noise that grows with the range."""

import jax.numpy as jnp
import numpy as np

from foveate.experiment.presets import PRESETS
from foveate.geometry.fov_spatial import cone
from foveate.geometry.space import SPACES
from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.planning.shooting import PlanSettings
from foveate.scenario.scenes import Scene
from foveate.simulation.information import Future

PROBLEM = PRESETS["paper"].scenario.problem()


FEW = PlanSettings(starts=4, iterations=30)


def future_of(problem, pose, state, information=None, horizon=None):
    state = jnp.asarray(state, float)
    K, n = state.shape[:2]
    return Future(
        pose=jnp.asarray(pose, float),
        state=state,
        information=jnp.broadcast_to(
            problem.prior_information if information is None else information, (n, *problem.prior_information.shape)
        ),
        present=jnp.ones(n, bool),
        horizon=jnp.array(K if horizon is None else horizon),
    )


def velocity_problem():
    """Targets with a velocity in space, sensor noise in the body frame that grows with the range."""
    d, tau, eye = 3, 0.5, np.eye(3)
    A = np.block([[eye, tau * eye], [0 * eye, eye]])
    motion = LinearGaussian(
        A=jnp.array(A), B=jnp.zeros((6, 1)), W=jnp.array(np.diag([0.01] * 3 + [0.05] * 3)), Z=jnp.eye(d, 6)
    )
    sensor = Sensor(
        H=jnp.eye(d, 6),
        V=jnp.diag(jnp.array([0.3, 0.1, 0.2])),
        view=cone(0.0, 6.0, 1.4),
        range_growth=0.2,
        frame="body",
    )
    agent = Agent(
        space=SPACES["spatial"], axes=(0, 4, 5), lower=jnp.array([-1.0, -0.8, -0.9]), upper=jnp.array([2.0, 0.8, 0.9])
    )
    return Problem(
        agent=agent,
        sensor=sensor,
        motion=motion,
        tau=jnp.array(tau),
        prior_information=jnp.array(np.diag([1.0] * 3 + [4.0] * 3)),
    )


SPATIAL = velocity_problem()


def spatial_future(steps=4):
    start = np.array([[3.0, 0.5, 0.2, 0.3, 0, 0], [2.0, -1.0, 0.5, 0, 0.4, -0.2]])
    states = [start]
    for _ in range(steps - 1):
        states.append(states[-1] @ np.asarray(SPATIAL.motion.A).T)
    return future_of(SPATIAL, SPACES["spatial"].from_numbers([0, 0.2, 0, 1, 0.1, 0, 0.2]), states)


TWO = Scene(id="two", agent=(0.0, 0.0, 0.5), targets=((4.0, 1.0), (-5.0, 2.0)), drift=((0.1, 0.0),) * 2, horizon=6)
