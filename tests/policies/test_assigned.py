"""Shares of the targets: all of them, each once, evenly; and robots that hear nothing may disagree."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode
from helpers.rejections import assert_rejected
from helpers.worlds_of_detections import HALL
from scipy.optimize import linear_sum_assignment

from foveate.experiment.resolve import methods_of
from foveate.planning.named import assigned_in, heuristic_in
from foveate.policies.assigned import BID_STEPS, KEEP_NATS, shares
from foveate.policies.rules import priced
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import TriangleView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.records import TRUE, Policy
from foveate.simulation.rollout import rollout
from foveate.simulation.suites import scene_episodes
from foveate.simulation.team.rollout import first_observations

M, N = 3, 3
SCENARIO = Scenario(
    team=TeamSettings(agents=M, half_side_m=(9.0, 9.0)),
    scenes=SceneSettings(targets_min=N, targets_max=N, half_side_m=(9.0, 9.0), half_side_per_target_m=0.0, steps=4),
)


@pytest.mark.parametrize(("robots", "targets", "present"), [(3, 3, 3), (3, 7, 7), (3, 7, 4), (4, 2, 2)])
@pytest.mark.parametrize("is_greedy", [True, False])
def test_every_target_has_one_robot_and_no_robot_two_more_than_another(robots, targets, present, is_greedy):
    cost = np.random.default_rng(0).uniform(0, 50, (robots, targets))
    mask = np.arange(targets) < present
    own = np.asarray(shares(jnp.asarray(cost), jnp.asarray(mask), is_greedy))
    np.testing.assert_array_equal(own.sum(axis=0), mask)
    assert own.sum(axis=1).max() - own.sum(axis=1).min() <= 1


@pytest.fixture(scope="module")
def observed():
    problem = SCENARIO.problem()
    episode = training_episode(problem, SCENARIO.scenes, jax.random.key(1), noise=True)
    return problem, jax.jit(lambda episode: first_observations(problem, episode, TRUE))(episode)


def prices(observed):
    """What each target costs each robot."""
    problem, seen = observed
    return jax.jit(jax.vmap(lambda each: priced(problem, each)))(seen)


def assigned(observed, rule, observation=None):
    """The targets of each robot at the first decision, and the policy with its memories."""
    policy = assigned_in(SCENARIO, heuristic_in(SCENARIO, "nearest"), rule)
    memory = jax.jit(jax.vmap(policy.start))(observed[1] if observation is None else observation)
    return np.asarray(memory.share.targets), policy, memory


def test_hungarian_equals_scipy_on_the_price_of_every_robot(observed):
    cost = np.asarray(prices(observed))
    rows, columns = linear_sum_assignment(cost)
    for rule in ("hungarian", "auction"):
        targets = assigned(observed, rule)[0]
        assert cost[targets].sum() == pytest.approx(cost[rows, columns].sum())


class Told(Policy):
    """Remembers the claims that it is told."""

    def start(self, observation):
        return observation.team.claims

    def __call__(self, observation, memory, key):
        return jnp.zeros(2), observation.team.claims


def test_the_policy_in_an_auction_is_told_who_has_which_target_and_no_bids(observed):
    policy, bids = assigned_in(SCENARIO, Told(), "auction"), np.random.default_rng(3).uniform(-9, 9, (M, N))
    seen = eqx.tree_at(lambda o: (o.team.claims, o.step), observed[1], (jnp.tile(bids, (M, 1, 1)), jnp.full(M, 2)))

    def decide(each):
        return policy(each, policy.start(each), jax.random.key(0))[1]

    memory = jax.jit(jax.vmap(decide))(seen)
    for m in range(M):
        assert set(np.unique(memory.own[m])) == {0.0, 1.0}
        np.testing.assert_array_equal(memory.own[m].sum(axis=0), np.ones(N))
        np.testing.assert_array_equal(memory.own[m][m], memory.share.targets[m])


def test_a_robot_without_a_target_claims_none_and_is_shown_all(observed):
    one = eqx.tree_at(lambda o: o.present, observed[1], jnp.tile(jnp.arange(N) == 1, (M, 1)))
    for rule in ("greedy", "hungarian"):
        targets, policy, memory = assigned(observed, rule, one)
        assert targets.sum() == 1
        claims = jax.vmap(policy.claims)(one, memory)
        np.testing.assert_array_equal(claims, targets)


def test_hungarian_goes_by_the_limits_and_view_of_every_robot():
    """A price, as scipy assigns it, is that of each robot alone; what a quick robot is given depends on its mates."""
    quick = RobotSettings(agent=DifferentialDrive(v_max_m_s=12.0), view=TriangleView(depth_m=4.0, angle_deg=90.0))
    mixed = replace(SCENARIO, team=replace(SCENARIO.team, robots=(RobotSettings(), quick, RobotSettings())))
    problem, draw = mixed.problem(), partial(training_episode, SCENARIO.problem(), SCENARIO.scenes, noise=True)
    observe = jax.jit(lambda episode: first_observations(problem, episode, TRUE))
    own = [jax.jit(partial(priced, mixed.of_robot(m).problem())) for m in range(M)]
    differs = 0
    for seed in range(8):
        seen = observe(draw(key=jax.random.key(seed)))
        cost = np.stack([own[m](jax.tree.map(lambda x, m=m: x[m], seen)) for m in range(M)])
        rows, columns = linear_sum_assignment(cost)
        for rule in ("hungarian", "auction"):
            policy = assigned_in(mixed, heuristic_in(mixed, "nearest"), rule)
            targets = np.asarray(jax.jit(jax.vmap(policy.start))(seen).share.targets)
            assert cost[targets].sum() == pytest.approx(cost[rows, columns].sum())
        alike = np.asarray(assigned((SCENARIO.problem(), seen), "hungarian", seen)[0])
        differs += bool((alike != targets).any())
    assert differs > 0


def test_greedy_takes_the_nearest_pair(observed):
    problem, seen = observed
    position = np.asarray(problem.motion.position(seen.mean[0]))
    distance = np.linalg.norm(np.asarray(seen.pose)[:, None, :2] - position, axis=-1)
    robot, target = np.unravel_index(np.argmin(distance), distance.shape)
    assert assigned(observed, "greedy")[0][robot, target]


def test_an_auction_goes_by_the_bids_that_were_heard(observed):
    """Robot 0 hears that robot 1 bids less than it can for all targets but the third, and leaves that one to it."""
    seen = observed[1]
    bids = jnp.array([-900.0, -900.0, 900.0])
    heard = (jnp.full(M, 2), jnp.ones_like(seen.team.age), seen.team.claims.at[:, 1].set(bids))
    later = eqx.tree_at(lambda seen: (seen.step, seen.team.age, seen.team.claims), seen, heard)
    targets, policy, memory = assigned(observed, "auction", later)
    assert targets[0].tolist() in ([True, False, False], [False, True, False])
    own = jax.jit(jax.vmap(policy.claims))(seen, memory)
    expected = -prices(observed)[0]
    np.testing.assert_allclose(own[0], expected, atol=1e-9)


def test_old_bids_count_as_estimates_do(observed):
    """Bids of two steps ago say what the places of then do: an auction is then as hungarian."""
    seen = observed[1]
    bids = jnp.array([-900.0, -900.0, 900.0])
    age = jnp.where(jnp.eye(M, dtype=int) == 1, 0, BID_STEPS)
    heard = (jnp.full(M, 9), age, seen.team.claims.at[:, 1].set(bids))
    later = eqx.tree_at(lambda seen: (seen.step, seen.team.age, seen.team.claims), seen, heard)
    unheard = eqx.tree_at(lambda seen: seen.team.claims, later, jnp.zeros_like(seen.team.claims))
    expected = assigned(observed, "hungarian", unheard)[0]
    np.testing.assert_array_equal(assigned(observed, "auction", later)[0], expected)


def test_a_robot_that_begins_again_keeps_what_it_has_claimed(observed):
    """In a window of a training the memory begins anew, and the roster goes on."""
    seen = observed[1]
    cost = prices(observed)
    first = assigned(observed, "hungarian")[0]
    claims = jnp.tile(jnp.asarray(first, float), (M, 1, 1))
    again = eqx.tree_at(lambda seen: seen.team.claims, seen, claims)
    targets, policy, memory = assigned(observed, "hungarian", again)
    np.testing.assert_array_equal(targets, first)
    own = jax.jit(jax.vmap(lambda *each: policy(*each)[1]))(again, memory, jax.random.split(jax.random.key(0), M))
    np.testing.assert_allclose(memory.share.bids - (-cost), KEEP_NATS * first, atol=1e-9)
    np.testing.assert_array_equal(own.share.targets, first)


def test_a_robot_keeps_its_target_for_a_while(observed):
    """The bid for a robot's own target is better by KEEP_NATS at its next decision."""
    seen = observed[1]
    targets, policy, memory = assigned(observed, "auction")
    after = jax.jit(jax.vmap(lambda *each: policy(*each)[1]))(seen, memory, jax.random.split(jax.random.key(0), M))
    np.testing.assert_allclose(after.share.bids - memory.share.bids, KEEP_NATS * targets, atol=1e-9)


def test_names_of_methods():
    assert methods_of(["uncertain+greedy", "policy+auction"]) == ("uncertain+greedy", "policy+auction")
    for name in ("uncertain+nobody", "all+greedy", "uncertain+", "nobody+greedy"):
        assert_rejected(lambda name=name: methods_of(name), f"method {name!r}: expected one of")
    single = replace(SCENARIO, team=None)
    assert_rejected(lambda: assigned_in(single, heuristic_in(single, "nearest"), "greedy"), "the scenario has no team")


@pytest.mark.slow
def test_tracks_are_assigned_only_where_all_robots_have_the_same():
    team = TeamSettings(agents=2)
    for radio, name, right in (
        (RadioSettings(), "explore", "'explore+greedy': expected none: explore goes to places"),
        (RadioSettings(loss=1.0), "lookahead", "expected none: without ids robots have the same tracks only where"),
    ):
        scenario = replace(HALL, team=replace(team, radio=radio))
        assert_rejected(lambda own=scenario, name=name: assigned_in(own, heuristic_in(own, name), "greedy"), right)
    shared = replace(HALL, team=team)
    assert assigned_in(shared, heuristic_in(shared, "alternate"), "greedy").rule == "greedy"


def test_two_robots_beside_each_other_part_and_detect_all_targets():
    """Two targets to either side: assigned, all are detected within 20 steps; copies both go to one side."""
    team = TeamSettings(agents=2)
    still = SceneSettings(
        targets_min=4, targets_max=4, steps=20, drift_m_s=(0.0, 0.0), jitter_m_s=0.0, half_side_m=(1.0, 1.0)
    )
    scenario = Scenario(team=team, scenes=still)
    problem = scenario.problem()
    scene = Scene(
        id="a",
        agent=(0.0, 0.0, 0.0),
        others=((0.0, 0.5, 0.0),),
        targets=((12.0, 3.0), (12.0, -3.0), (-12.0, 3.0), (-12.0, -3.0)),
        drift=((0.0, 0.0),) * 4,
        horizon=20,
    )
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, scenario.scenes, [scene], 0, 1))
    nearest = heuristic_in(scenario, "nearest")
    policies = nearest, assigned_in(scenario, heuristic_in(scenario, "uncertain"), "hungarian")
    copies, parted = (
        np.asarray(jax.jit(lambda e, k, p=p: rollout(problem, p, e, TRUE, k).visible)(episode, jax.random.key(0)))
        for p in policies
    )
    assert parted.any(axis=0).all()
    assert not copies.any(axis=0).all()
