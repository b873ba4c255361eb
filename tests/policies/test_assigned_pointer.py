"""A network that is shown its own targets decides as the same network, given these by the policy that assigns them."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from helpers.episodes import training_episode
from helpers.rejections import assert_rejected
from helpers.worlds_of_detections import HALL

from foveate.evaluation.rivals import policies_of
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import ACTOR_CRITIC, for_scenario
from foveate.experiment.resolve import in_scenario
from foveate.names import ASSIGNMENTS
from foveate.planning.named import assigned_in
from foveate.policies.assigned_pointer import AssignedPointer
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import TriangleView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout

FAST = RobotSettings(agent=DifferentialDrive(v_max_m_s=9.0), view=TriangleView(depth_m=1.0))
TEAM = TeamSettings(agents=2, robots=(RobotSettings(), FAST), radio=RadioSettings(loss=0.3, memory_steps=2))
SINGLE = Scenario(scenes=SceneSettings(targets_min=3, targets_max=3, steps=8, drift_m_s=(0.3, 0.3)))
SMALL = PointerSettings(kind="pointer", target_widths=(8,), heads=2, context_widths=(8,), mode_width=8)


def network_of(scenario, rule=None):
    experiment = Experiment(scenario=scenario, policy=replace(SMALL, assignment=rule), training=ACTOR_CRITIC)
    return experiment.new_policy(jax.random.key(3))


@pytest.mark.parametrize("rule", ASSIGNMENTS)
def test_in_a_team_it_is_the_policy_with_assigned_targets(rule):
    scenario = replace(SINGLE, team=TEAM)
    problem, key = scenario.problem(), jax.random.key(5)
    episode = training_episode(problem, scenario.scenes, key, noise=True)
    own = network_of(scenario, rule)
    assert isinstance(own, AssignedPointer)
    expected = assigned_in(scenario, network_of(SINGLE), rule)
    found, same = (jax.jit(lambda policy: rollout(problem, policy, episode, TRUE, key))(x) for x in (own, expected))
    assert np.abs(found.team.action).max() > 0.5
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(same), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_alone_it_decides_on_all_targets():
    problem, key = SINGLE.problem(), jax.random.key(5)
    episode = training_episode(problem, SINGLE.scenes, key, noise=True)
    own, single = network_of(replace(SINGLE, team=TEAM), "auction"), network_of(SINGLE)
    found, same = (jax.jit(lambda policy: rollout(problem, policy, episode, TRUE, key))(x) for x in (own, single))
    assert eqx.tree_equal(found, same)


def test_without_ids_it_needs_the_same_tracks():
    """Over a lossy radio robots have tracks of their own."""
    lossy = replace(HALL, team=TeamSettings(agents=2, radio=RadioSettings(loss=0.5)))
    assert_rejected(lambda: network_of(lossy, "auction"), "policy.assignment = 'auction': expected none: without ids")
    shared = replace(HALL, team=TeamSettings(agents=2))
    assert isinstance(network_of(shared, "auction"), AssignedPointer)
    experiment = Experiment(scenario=shared, policy=replace(SMALL, assignment="auction"), training=ACTOR_CRITIC)
    assert_rejected(lambda: in_scenario(experiment, lossy), "policy.assignment = 'auction': expected none: without ids")


def test_another_rule_replaces_its_own():
    scenario = replace(SINGLE, team=TEAM)
    own = network_of(scenario, "auction")
    assert eqx.tree_equal(assigned_in(scenario, own, "greedy"), network_of(scenario, "greedy"))


def test_a_verdict_compares_it_with_no_other_rule_for_it():
    scenario = replace(SINGLE, team=replace(TEAM, robots=None))
    experiment = Experiment(scenario=scenario, policy=SMALL, training=ACTOR_CRITIC)
    assert list(policies_of(experiment, network_of(scenario, "auction"))) == ["policy"]
    assert "policy+auction" in policies_of(experiment, network_of(scenario))


def test_a_team_is_trained_like_any_with_assigned_targets():
    """By bids where all are heard, else by places."""
    assert for_scenario(replace(SINGLE, team=TeamSettings(agents=2)), "any").policy.assignment == "auction"
    assert for_scenario(replace(SINGLE, team=replace(TEAM, robots=None)), "any").policy.assignment == "greedy"
    assert for_scenario(SINGLE, "any").policy.assignment is None
