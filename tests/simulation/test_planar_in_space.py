"""The planar fast path and the general one: the same numbers, to rounding."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode
from jax.flatten_util import ravel_pytree

from foveate.geometry.space import SPACES
from foveate.models.belief import Belief
from foveate.models.missed_detection import condition_on_missed_detection
from foveate.models.sensor import Softness
from foveate.policies.attention import AttentionSettings
from foveate.policies.heuristics import Lawnmower
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import VelocityTarget
from foveate.simulation.planar_in_space import EmbeddedPolicy, embedded_episode, embedded_pose, embedded_problem
from foveate.simulation.records import SURROGATE, TRUE, Protocol
from foveate.simulation.rollout import log_dets, rollout

SMALL = AttentionSettings(agent_widths=(8, 6), target_widths=(8, 6), out_widths=(8,))
FEW = {"targets_min": 2, "targets_max": 3, "half_side_per_target_m": 0.6}
SCENARIOS = {
    "the paper": Scenario(scenes=SceneSettings(**FEW)),
    "velocities in a sector, steps of two lengths": Scenario(
        view=SectorView(depth_m=4.0, angle_deg=100.0),
        sensor=SensorSettings(V=((0.04, 0.01), (0.01, 0.09)), range_growth_per_m=0.1),
        target=VelocityTarget(kind="constant_velocity"),
        scenes=SceneSettings(**FEW),
        schedule=ScheduleSettings(tau_s=(1.0, 0.5)),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frame"),
    [
        pytest.param("the paper", "world", marks=pytest.mark.exhaustive),
        ("velocities in a sector, steps of two lengths", "body"),
    ],
)
def test_trajectories_beliefs_scores_and_gradients_agree(name, frame):
    """The second has all that the first has, but for its view and the frame of its network."""
    scenario = SCENARIOS[name]
    problem = scenario.problem()
    spatial = embedded_problem(problem)
    policy = AttentionSettings(**{**vars(SMALL), "frame": frame}).policy(problem, jax.random.key(2))
    episode = training_episode(problem, scenario.scenes, jax.random.key(5), noise=True)
    # Three metres before a target, which a fresh policy, at about half speed straight ahead, then sees.
    episode = eqx.tree_at(
        lambda e: e.pose, episode, jnp.append(episode.truth.state[0, 0, :2] - jnp.array([3.0, 0.0]), 0.0)
    )
    planar_trace = eqx.filter_jit(rollout)(problem, policy, episode, TRUE, jax.random.key(0))
    trace = eqx.filter_jit(rollout)(spatial, EmbeddedPolicy(policy), embedded_episode(episode), TRUE, jax.random.key(0))
    assert planar_trace.visible.any()
    np.testing.assert_allclose(trace.pose, jax.vmap(embedded_pose)(planar_trace.pose), rtol=1e-10, atol=1e-10)
    for field in ("action", "mean", "information", "log_det", "visible"):
        np.testing.assert_allclose(getattr(trace, field), getattr(planar_trace, field), rtol=1e-10, atol=1e-10)

    levels = Protocol(levels=(Softness(2.0, 0.4), Softness(0.3, 0.25)))

    def gradient(problem, policy, episode):
        @eqx.filter_value_and_grad
        def objective(policy):
            return jnp.sum(log_dets(problem, policy, episode, levels, jax.random.key(0))[-1])

        value, slope = objective(policy)
        return value, ravel_pytree(eqx.filter(slope, eqx.is_inexact_array))[0]

    value, slope = eqx.filter_jit(gradient)(problem, policy, episode)
    spatial_value, spatial_slope = eqx.filter_jit(gradient)(spatial, EmbeddedPolicy(policy), embedded_episode(episode))
    np.testing.assert_allclose(spatial_value, value, rtol=1e-10)
    assert np.linalg.norm(slope) > 1e-3
    np.testing.assert_allclose(spatial_slope, slope, rtol=0, atol=1e-10 * np.linalg.norm(slope))


def test_a_policy_with_memory_is_embedded_too():
    problem = Scenario().problem()
    mower = Lawnmower(problem, 0.0)
    episode = training_episode(problem, SceneSettings(), jax.random.key(1), noise=False)
    planar = eqx.filter_jit(rollout)(problem, mower, episode, SURROGATE, jax.random.key(0))
    embedded = eqx.filter_jit(rollout)(
        embedded_problem(problem), EmbeddedPolicy(mower), embedded_episode(episode), SURROGATE, jax.random.key(0)
    )
    np.testing.assert_allclose(embedded.action, planar.action, rtol=1e-9, atol=1e-9)


def test_unsupported_planar_problems_are_rejected():
    problem = Scenario(sensor=SensorSettings(frame="body")).problem()
    with pytest.raises(ValueError, match="'body'"):
        embedded_problem(problem)
    with pytest.raises(ValueError, match="in space already"):
        embedded_problem(embedded_problem(Scenario().problem()))
    assert embedded_problem(Scenario().problem()).agent.space is SPACES["spatial"]


@pytest.mark.slow
def test_missed_detections_stay_used_on_the_floor_of_space():
    """Other sample points, so the beliefs agree as the two rules of integration do; heights stay certain."""
    scenario = Scenario(
        sensor=SensorSettings(missed_detections="used", range_growth_per_m=0.1), scenes=SceneSettings(**FEW)
    )
    problem = scenario.problem()
    spatial = embedded_problem(problem)
    assert spatial.sensor.uses_missed_detections
    assert spatial.sensor.range_growth == 0.1
    belief = Belief(jnp.array([1.4, 1.0]), jnp.diag(jnp.array([0.5, 0.8])))

    def outside(p, pose):
        return condition_on_missed_detection(
            belief, p.motion.Z, lambda points: p.sensor.view.contains(p.agent.space.to_body(pose, points))
        )

    planar, lifted = outside(problem, jnp.zeros(3)), outside(spatial, jnp.eye(4))
    assert float(jnp.abs(planar.mean - belief.mean).max()) > 0.1
    np.testing.assert_allclose(lifted.mean, planar.mean, atol=0.05)
    np.testing.assert_allclose(jnp.linalg.inv(lifted.information), jnp.linalg.inv(planar.information), atol=0.2)
