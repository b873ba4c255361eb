"""The pointer network against numpy, what must not change its decision, and the heuristic that it begins as."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observations import SCENARIOS, moved, scene, seen
from scipy.special import softmax

from foveate.models.robot import Robot
from foveate.policies.pointer import PADDING_LOG_WEIGHT
from foveate.policies.pointer_settings import PointerSettings
from foveate.policies.steering import steer
from foveate.policies.window import NETWORK_VALUES, DynamicWindow
from foveate.scenario.random_obstacles import CircleObstacles
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout

KEY = jax.random.key(0)
SMALL = PointerSettings(
    kind="pointer", target_widths=(12, 8), heads=3, context_widths=(10, 9), mode_width=7, modes=3, tells_time=True
)


def network(name):
    """Weights from numpy, as large as makes differences show."""
    problem, rng = SCENARIOS[name].problem(), np.random.default_rng(1)
    shapes = eqx.filter_eval_shape(lambda: SMALL.policy(problem, KEY))
    return jax.tree.map(lambda x: jnp.asarray(rng.normal(0, 1.2 / np.sqrt(x.shape[-1]), x.shape)), shapes)


TARGETS = 5
"""As many in most tests, so that they share one compiled program."""


@eqx.filter_jit
def looked(policy, observation):
    """Tokens, modes and action in one program, since compiling it is nearly all of the time."""
    tokens = policy.tokens(observation)
    return tokens, policy.modes(tokens), policy(observation, (), KEY)[0]


def decide(policy, observation):
    return looked(policy, observation)[2]


def modes_of(policy, observation):
    return looked(policy, observation)[1]


def dense(linear, x):
    return np.asarray(linear.weight) @ x + np.asarray(linear.bias)


def chain(layers, x):
    for linear in layers:
        x = np.maximum(dense(linear, x), 0)
    return x


def by_hand(policy, tokens):
    """Target by target, head by head: log weights and actions, from tokens (tested in test_tokens.py)."""
    features, aim, urgency, unit = (np.asarray(x) for x in tokens[:4])
    embeddings = [chain(policy.encoder.target_layers, x) for x in features]
    scores = np.array([dense(policy.encoder.query_layers[0], x) for x in embeddings])
    context = chain(
        policy.context_layers, np.concatenate([softmax(column) @ np.array(embeddings) for column in scores.T])
    )
    loss = urgency @ np.asarray(policy.preference)
    log_weights, actions = [], []
    for x, towards, lost in zip(embeddings, aim, loss, strict=True):
        hidden = np.maximum(dense(policy.by_target, x) + dense(policy.by_context, context), 0)
        numbers = dense(policy.mode_layer, hidden).reshape(3, -1)
        log_weights += [numbers[0, 0] - (lost - loss.min()), numbers[1, 0] - 4, numbers[2, 0] - 4]
        actions += [towards + 2 * np.tanh(numbers[0, 1:] * unit), *np.tanh(numbers[1:, 1:]) * (unit > 0)]
    idle = dense(policy.idle_layer, context)
    return np.append(log_weights, idle[0] - 4), np.array([*actions, np.tanh(idle[1:]) * (unit > 0)])


@pytest.mark.parametrize("name", SCENARIOS)
def test_network(name):
    policy = network(name)
    for seed in range(3):
        observation = seen(SCENARIOS[name], *scene(SCENARIOS[name].dimension, TARGETS, seed))
        tokens, modes, decision = looked(policy, observation)
        log_weight, action = by_hand(policy, tokens)
        np.testing.assert_allclose(modes.log_weight, log_weight, atol=1e-9)
        np.testing.assert_allclose(modes.action, action, atol=1e-9)
        best = np.clip(action[np.argmax(log_weight)], -1, 1)[list(SCENARIOS[name].problem().agent.axes)]
        np.testing.assert_allclose(decision, best, atol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_padding_and_order_do_not_matter(name):
    policy, (turn, place, *targets) = network(name), scene(SCENARIOS[name].dimension, 7)
    expected = decide(policy, seen(SCENARIOS[name], turn, place, *(part[:TARGETS] for part in targets)))
    order = np.array([5, 2, 0, 6, 4, 3, 1])
    padded = seen(SCENARIOS[name], turn, place, *(part[order] for part in targets), order < TARGETS)
    _, modes, decision = looked(policy, padded)
    np.testing.assert_allclose(decision, expected, atol=1e-12)
    np.testing.assert_array_equal(
        np.asarray(modes.log_weight[:-1]).reshape(7, 3) == PADDING_LOG_WEIGHT, np.stack([order >= TARGETS] * 3, 1)
    )


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_world_frame_does_not_matter(name):
    policy, parts = network(name), scene(SCENARIOS[name].dimension, TARGETS)
    here, there = (seen(SCENARIOS[name], *each) for each in (parts, moved(*parts)))
    np.testing.assert_allclose(decide(policy, there), decide(policy, here), atol=1e-9)


def test_a_region_that_no_training_has_told_of_changes_nothing():
    policy, parts = SMALL.policy(SCENARIOS["plane"].problem(), KEY), scene(2, 4)
    bounded = replace(SCENARIOS["plane"], region=RegionSettings(low_m=(-9.0, -9.0), high_m=(30.0, 9.0), targets="free"))
    tokens = eqx.filter_jit(lambda scenario: policy.tokens(seen(scenario, *parts)))
    here, there = (tokens(scenario) for scenario in (SCENARIOS["plane"], bounded))
    assert (here.features != there.features).any(), "it is told"
    np.testing.assert_array_equal(policy.modes(there).log_weight, policy.modes(here).log_weight)


@pytest.mark.parametrize(
    ("objective", "tells_time", "used"),
    [("terminal", True, ("mean", True)), ("terminal", False, ("seen", True)), ("mean", False, ("mean", True))],
)
def test_a_task_that_no_training_has_told_of_changes_nothing(objective, tells_time, used):
    scenario, settings = SCENARIOS["plane"], replace(SMALL, tells_time=tells_time)
    observation = seen(scenario, *scene(2, 4))
    policy = settings.policy(scenario.problem(), KEY, objective)
    other = replace(policy, objective=used[0], tells_time=used[1])
    here, there = (modes_of(each, observation).log_weight for each in (policy, other))
    np.testing.assert_array_equal(there, here)
    several = SMALL.policy(scenario.problem(), KEY, objective, ("mean", "seen"))
    mean, time = (modes_of(replace(several, objective=task), observation).log_weight for task in ("mean", "seen"))
    assert (mean != time).any(), "a policy for several tasks tells them apart"


def test_without_targets_only_the_idle_mode_is_left():
    policy, (one, other) = network("plane"), (scene(2, TARGETS, seed) for seed in (0, 5))
    nobody, nor_here = (seen(Scenario(), *parts, np.zeros(TARGETS, bool)) for parts in (one, other))
    modes = modes_of(policy, nobody)
    np.testing.assert_array_equal(decide(policy, nobody), modes.action[-1, [0, 2]])
    np.testing.assert_array_equal(decide(policy, nobody), decide(policy, nor_here))


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("steps_weight", [0.0, 0.5, 2.0])
def test_untrained_it_is_a_heuristic(name, steps_weight):
    """The steering law to the target of the least log det + weight x steps until it is in view."""
    scenario = SCENARIOS[name]
    problem, d = scenario.problem(), scenario.dimension
    policy = replace(SMALL.policy(problem, KEY), preference=jnp.array([1.0, steps_weight]))
    depth, half, drive, yaw = (2.0, np.pi / 3, 4.0, np.pi / 3) if d == 2 else (6.0, np.pi / 4, 2.0, np.pi / 4)
    chosen = []
    for seed in range(30):
        turn, place, mean, information, known_input = scene(d, TARGETS, seed, reach_m=2 * depth)
        q = (mean[:, :d] - place) @ turn
        if d == 3:  # at the agent's height, so that height costs no steps
            q[:, 2] = 0.1
            mean[:, :d] = q @ turn.T + place
        away, bearing = np.linalg.norm(q[:, :2], axis=1), np.abs(np.arctan2(q[:, 1], q[:, 0]))
        steps = np.maximum(bearing - half, 0) / yaw + np.maximum(away - depth, 0) / drive
        cost = np.linalg.slogdet(information)[1] + steps_weight * steps
        first, second = np.sort(cost)[:2]
        if second - first < 0.1:
            continue
        best = np.argmin(cost)
        chosen.append(best == np.argmin(np.linalg.slogdet(information)[1]))
        law = steer(problem.agent, problem.tau, jnp.asarray(q[best]), depth / 2)
        action = decide(policy, seen(scenario, turn, place, mean, information, known_input))
        np.testing.assert_allclose(action, law, atol=0.12)
    assert len(chosen) > 20
    assert all(chosen) == (steps_weight == 0.0), "else the steps decide nothing"


@pytest.mark.parametrize("name", SCENARIOS)
def test_gradients_of_the_weights_are_those_of_differences(name):
    """Also with a target at the agent itself, and with none."""
    policy = network(name)
    turn, place, mean, information, known_input = scene(SCENARIOS[name].dimension, 3)
    mean[0, : len(place)] = place
    parameters, rest = eqx.partition(policy, eqx.is_inexact_array)
    rng = np.random.default_rng(2)
    along = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), parameters)

    @eqx.filter_jit
    @jax.value_and_grad
    def worth(parameters, observation):
        modes = eqx.combine(parameters, rest).modes(policy.tokens(observation))
        return jnp.sum(jax.nn.softmax(modes.log_weight) @ modes.action)

    for present in (np.ones(3, bool), np.zeros(3, bool)):
        observation = seen(SCENARIOS[name], turn, place, mean, information, known_input, present)
        slope = worth(parameters, observation)[1]
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(slope))
        nudged = [jax.tree.map(lambda x, v, h=h: x + h * v, parameters, along) for h in (-1e-6, 1e-6)]
        here, there = (worth(weights, observation)[0] for weights in nudged)
        projected = sum(jnp.vdot(a, b) for a, b in zip(*map(jax.tree.leaves, (slope, along)), strict=True))
        np.testing.assert_allclose(projected, (there - here) / 2e-6, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("name", ["plane", "space"])
def test_no_target_at_all_is_as_none_present(name):
    scenario = SCENARIOS[name]
    policy, parts = network(name), scene(scenario.dimension, TARGETS)
    absent = seen(scenario, *parts, np.zeros(TARGETS, bool))
    nobody = seen(scenario, *parts[:2], *(part[:0] for part in parts[2:]), np.zeros(0, bool))
    _, modes, decision = looked(policy, nobody)
    assert len(modes.action) == 1
    np.testing.assert_allclose(decision, decide(policy, absent), atol=1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_with_the_window_it_can_be_that_heuristic(name):
    """Which has tests of its own, and stands still without a target; the network's corrections are 0 here."""
    problem = SCENARIOS[name].problem()
    policy = at_the_window(problem)
    window = DynamicWindow(problem, 0.5 * float(problem.sensor.view.extent.ahead_m), NETWORK_VALUES)
    decides = eqx.filter_jit(lambda observation: window(observation, (), KEY)[0])
    for seed in range(3):
        observation = seen(SCENARIOS[name], *scene(SCENARIOS[name].dimension, TARGETS, seed))
        np.testing.assert_allclose(decide(policy, observation), decides(observation), atol=1e-9)
    nobody = replace(observation, present=jnp.zeros(TARGETS, bool))
    still = problem.agent.control(decide(policy, nobody))
    np.testing.assert_allclose(still, 0.0, atol=1e-9)


def test_what_it_is_told_is_clipped_to_a_range():
    """Far outside, as where beliefs are far wider than any of a training, it decides as at the border."""
    problem, observation = SCENARIOS["plane"].problem(), seen(SCENARIOS["plane"], *scene(2, TARGETS, 0))
    free = SMALL.policy(problem, KEY)
    policy = replace(SMALL, clips_features=True).policy(problem, KEY)
    told, unclipped = (np.asarray(each.tokens(observation).features) for each in (policy, free))
    np.testing.assert_array_equal(told, unclipped)  # until there is a range, all is told
    low, high = np.quantile(unclipped, [0.3, 0.7], axis=0)
    policy = replace(policy, feature_range=jnp.asarray(np.stack([low, high])))
    told = np.asarray(policy.tokens(observation).features)
    np.testing.assert_array_equal(told, np.clip(unclipped, low, high))
    assert (told != unclipped).any()
    gradient = eqx.filter_grad(lambda policy: policy.modes(policy.tokens(observation)).action.sum())(policy)
    assert (np.asarray(gradient.feature_range) == 0).all(), "no training moves it"


def test_the_window_of_a_network_knows_of_no_obstacles():
    """As the rest of a network without rays: among circles it decides as in the open."""
    circles = CircleObstacles(maps=1, test_maps=0, density_per_m2=0.05)
    problems = [Scenario(obstacles=obstacles).problem() for obstacles in (None, circles)]
    policy = replace(SMALL, dynamic_window=True).policy(problems[1], KEY)
    for seed in range(3):
        observation = seen(SCENARIOS["plane"], *scene(2, TARGETS, seed))
        actions = [decide(policy, replace(observation, robot=Robot.of(each))) for each in problems]
        np.testing.assert_array_equal(*actions)


def test_the_window_in_an_episode_with_a_schedule():
    """The policy that is the heuristic acts as it does, from step to step."""
    scenario = Scenario(schedule=ScheduleSettings(tau_s=(1.0, 0.5)), scenes=SceneSettings(steps=4))
    problem, key = scenario.problem(), jax.random.key(2)
    policy = at_the_window(problem)
    heuristic = DynamicWindow(problem, 0.5 * float(scenario.view.depth_m), NETWORK_VALUES)

    @jax.jit
    def actions(key):
        episode = training_episode(problem, scenario.scenes, key, noise=True)
        return [rollout(problem, each, episode, TRUE, key).action for each in (policy, heuristic)]

    np.testing.assert_allclose(*actions(key), atol=1e-9)


def at_the_window(problem):
    """A policy that takes the window's command, without a correction."""
    policy = replace(SMALL, dynamic_window=True).policy(problem, KEY)
    nothing = jax.tree.map(jnp.zeros_like, policy.idle_layer)
    return eqx.tree_at(lambda x: (x.window_log_weight, x.idle_layer), policy, (jnp.full(1, 99.0), nothing))
