"""Planning in turn by the robots of a team: whose turn it is, what is expected of the others, and who looks where."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode
from helpers.plans import FEW

from foveate.errors import InputError
from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.evaluation.plan import PlanOptions
from foveate.experiment.presets import PRESETS
from foveate.planning.receding import Receding, has_turn, information_of_a_look, looks_of_mates
from foveate.planning.tours import best_range
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout
from foveate.simulation.team.records import TeamView
from foveate.simulation.team.rollout import first_observations

STEPS = 20
AROUND = Scene(
    id="around",
    agent=(0.0, 0.0, 0.0),
    others=((0.0, 0.0, 0.0),),
    targets=((-6.0, -3.0), (-6.0, 3.0), (6.0, -3.0), (6.0, 3.0)),
    drift=((0.0, 0.0),) * 4,
    horizon=STEPS,
)
"""Two robots beside each other, and four targets at rest, two in front and two behind."""


def view(number, age, claims):
    return TeamView(jnp.array(number), jnp.zeros((len(age), 3)), jnp.array(age), jnp.array(claims))


def test_one_robot_has_its_turn_after_the_first_round():
    turns = np.array([[has_turn(view(i, [0] * 3, np.zeros((3, 1))), jnp.array(k)) for i in range(3)] for k in range(9)])
    np.testing.assert_array_equal(turns[:2], [[True, True, True], [False, True, True]])
    np.testing.assert_array_equal(turns[3:], np.tile(np.eye(3, dtype=bool), (2, 1)))


def test_what_is_expected_of_the_others_wears_off():
    """The plan of robot 0 is half over, that of robot 2 entirely; its own does not count."""
    told = looks_of_mates(view(1, [5, 0, 12], [[0.8, 0.2], [1.0, 1.0], [0.6, 0.6]]), 10)
    np.testing.assert_allclose(told, [0.4, 0.1])


def seen(radio):
    """Targets that each robot has measured in 20 steps, (robots, targets)."""
    paper = PRESETS["paper"].scenario
    scenario = replace(paper, team=TeamSettings(agents=2, radio=radio))
    problem = scenario.problem()
    suite = prepare(problem, scenario.scenes, [AROUND], seed=3)
    settings = replace(FEW, starts=8)
    policy = Receding(problem=problem, settings=settings, window=STEPS)
    trace = evaluate_traces(suite, policy, TRUE, chunk=1)
    assert trace.team is not None
    return np.asarray(trace.team.visible[0].any(axis=0))


@pytest.mark.slow
def test_two_robots_beside_each_other_part():
    """With the same belief and the same place; by radio they see all four targets together."""
    visible = seen(RadioSettings())
    assert visible.any(axis=0).all()
    assert (visible.sum(axis=1) < 4).all()


@pytest.mark.parametrize("options", [{"omniscient": True}, {"open_loop": True}, {"refine": 3}], ids=str)
def test_plans_of_single_robots_are_rejected(options):
    scenario = replace(PRESETS["paper"].scenario, team=TeamSettings(agents=2))
    with pytest.raises(InputError, match=r"expected none with scenario\.team\.agents = 2"):
        PlanOptions(**options).check_team(scenario.problem())
    PlanOptions(starts=3).check_team(scenario.problem())


@pytest.mark.slow
@pytest.mark.parametrize(
    "sensor", [{"measures": "bearing", "std_bearing_rad": 0.1}, {"range_growth_per_m": 0.5}], ids=str
)
def test_looks_of_others_count_as_this_robots_own_ahead(sensor):
    """In the middle of the view, by the formulas of each sensor; and a team plans with it."""
    scenario = Scenario(
        view=SectorView(depth_m=4.0, angle_deg=90.0),
        sensor=SensorSettings(**sensor),
        scenes=SceneSettings(targets_min=2, targets_max=2, steps=3, initial_error="consistent"),
        team=TeamSettings(agents=2),
    )
    problem = scenario.problem()
    episode = training_episode(problem, scenario.scenes, jax.random.key(1), noise=True)
    seen = jax.jit(lambda episode: first_observations(problem, episode, TRUE))(episode)
    one = jax.tree.map(lambda x: x[0], seen)
    found = jax.jit(lambda each: information_of_a_look(problem, each))(one)
    rotation, range_m = np.asarray(problem.agent.space.rotation(one.pose)), float(best_range(problem.sensor.view))
    if "measures" in sensor:  # across the line of sight only
        across, variance = rotation @ [0.0, 1.0], range_m**2 * problem.sensor.V[0, 0]
        np.testing.assert_allclose(found, np.outer(across, across) / variance, atol=1e-9)
    else:
        V = np.asarray(problem.sensor.V) * (1.0 + 0.5 * range_m) ** 2
        np.testing.assert_allclose(found, np.linalg.inv(V), rtol=1e-9)
    planner = Receding(problem=problem, settings=FEW, window=3)
    trace = jax.jit(lambda episode: rollout(problem, planner, episode, TRUE, jax.random.key(0)))(episode)
    assert np.isfinite(trace.action).all()
    assert trace.action.any()
