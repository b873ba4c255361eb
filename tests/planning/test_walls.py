"""Plans among obstacles: the score is that of the simulation, on the map of the episode, and no plan sees through."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.evaluation.evaluate import prepare
from foveate.models.sensor import PAPER_SOFTNESS
from foveate.planning.named import heuristic_policy
from foveate.planning.receding import FixedActions, Receding
from foveate.planning.shooting import PlanSettings
from foveate.scenario.random_obstacles import CircleObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.information import Future, final_log_det
from foveate.simulation.records import SURROGATE, TRUE
from foveate.simulation.rollout import log_dets, rollout
from foveate.simulation.step import predict, start
from foveate.simulation.suites import own_suite

SCENES = SceneSettings(
    targets_min=3, targets_max=3, half_side_m=(5.0, 5.0), half_side_per_target_m=0.0, agent_spread=1.0, steps=5
)
CIRCLES = CircleObstacles(density_per_m2=0.15, maps=2, test_maps=2)
SCENARIO = Scenario(scenes=SCENES, obstacles=CIRCLES)


def test_the_score_of_a_plan_is_that_of_the_simulation():
    """On the second test map, with contacts on the way."""
    problem = SCENARIO.problem()
    scenes = [scene for scene in own_suite(SCENES, problem) if scene.map == 3][:4]
    suite, contacts = prepare(problem, SCENES, scenes), 0

    @jax.jit
    def both(episode, action):
        quiet = replace(episode, truth=None)
        states = [predict(problem, start(problem, quiet, SURROGATE), episode.inputs[0])]
        for k in range(1, 5):
            mean = states[-1].mean
            states.append(replace(states[-1], mean=problem.motion.advance(mean, episode.inputs[k])))
        means = jnp.stack([state.mean for state in states])
        future = Future(episode.pose, means, states[0].information[0], episode.present, episode.horizon, jnp.array(3))
        found = final_log_det(problem, future, action, PAPER_SOFTNESS)
        policy = FixedActions(action)
        expected = log_dets(problem, policy, quiet, SURROGATE, jax.random.key(0))[-1]
        other = final_log_det(
            replace(problem, obstacles=None), replace(future, map_number=None), action, PAPER_SOFTNESS
        )
        return found, expected, rollout(problem, policy, episode, TRUE, jax.random.key(0)).contacts[-1], other

    for i in range(len(scenes)):
        episode = jax.tree.map(lambda x, i=i: x[i], suite.episodes)
        action = jnp.asarray(np.random.default_rng(i).uniform(-1.0, 1.0, (5, 2)))
        found, expected, met, other = both(episode, action)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        contacts += int(met)
        assert np.abs(np.asarray(found - other)).max() > 1e-3
    assert contacts > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["window", pytest.param("receding", marks=pytest.mark.exhaustive)])
def test_planners_run_on_the_map_of_the_episode(name):
    """The score that receding plans climb is that of the test above."""
    problem = SCENARIO.problem()
    suite = prepare(problem, SCENES, own_suite(SCENES, problem)[:2])
    policy = (
        heuristic_policy("window", problem, 2.0)
        if name == "window"
        else Receding(problem, PlanSettings(starts=2, iterations=2), 2, heuristic_policy("nearest", problem, 2.0))
    )
    episode = jax.tree.map(lambda x: x[0], suite.episodes)
    trace = eqx.filter_jit(rollout)(problem, policy, episode, TRUE, jax.random.key(0))
    assert np.isfinite(np.asarray(trace.action)).all()
