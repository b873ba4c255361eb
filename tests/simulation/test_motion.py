"""The agent in a region, before targets and with a set of commands, against a plain loop in numpy."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode

from foveate.planning.receding import FixedActions
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import VelocityTarget
from foveate.simulation.information import Future, final_log_det
from foveate.simulation.planar_in_space import embedded_episode, embedded_problem
from foveate.simulation.records import SURROGATE, TRUE, Arrivals
from foveate.simulation.rollout import rollout
from foveate.simulation.step import instants, stages

LOW, HIGH = np.array([-4.0, -3.0]), np.array([4.0, 3.0])
YARD = RegionSettings(low_m=tuple(LOW.tolist()), high_m=tuple(HIGH.tolist()))
COMMANDS = ((0.0, -1.0), (0.0, 1.0), (1.5, 0.0), (3.0, 0.5), (3.0, -0.5))
WORLD = Scenario(
    agent=DifferentialDrive(v_max_m_s=3.0, w_max_rad_s=1.0, commands=COMMANDS),
    target=VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.02),
    scenes=SceneSettings(
        targets_min=3, targets_max=3, half_side_m=(4.0, 3.0), half_side_per_target_m=0.0, agent_spread=0.5, steps=60,
        initial_error="consistent",
    ),
    region=YARD,
    keep_off_m=0.8,
)  # fmt: skip
OPEN = replace(WORLD, region=None, keep_off_m=None)


def until_border(before, after, stays):
    share = 1.0
    for axis in range(2):
        border = HIGH[axis] if after[axis] > before[axis] else LOW[axis]
        if not LOW[axis] <= after[axis] <= HIGH[axis]:
            share = min(share, (border - before[axis]) / (after[axis] - before[axis]))
    return before if stays and share < 1 else before + share * (after - before)


def until_targets(before, after, targets, distance):
    """The end of the way by bisection for the first approach, on a fine grid of the way."""
    shares = np.linspace(0, 1, 4001)
    walk = before + shares[:, None] * (after - before)
    gaps = np.linalg.norm(walk[:, None] - targets, axis=-1)
    closer = gaps < np.minimum(distance, gaps[0]) - 1e-12
    return walk[max(0, closer.any(axis=1).argmax() - 1)] if closer.any() else after


def nearest_command(action):
    lower, upper = np.array([0.0, -1.0]), np.array([3.0, 1.0])
    wanted = lower + (action + 1) / 2 * (upper - lower)
    gaps = [np.sum(((np.array(command) - wanted) / (upper - lower)) ** 2) for command in COMMANDS]
    return np.array(COMMANDS[int(np.argmin(gaps))])


def arc(pose, v, w, tau):
    if w == 0:
        return pose + np.array([v * tau * np.cos(pose[2]), v * tau * np.sin(pose[2]), 0.0])
    turn = pose[2] + w * tau
    return np.array(
        [pose[0] + v / w * (np.sin(turn) - np.sin(pose[2])), pose[1] - v / w * (np.cos(turn) - np.cos(pose[2])), turn]
    )


def rolled(scenario, actions, protocol, episode):
    run = jax.jit(lambda e: rollout(scenario.problem(), FixedActions(actions), e, protocol, jax.random.key(0)))
    return jax.tree.map(np.asarray, run(episode))


def random_actions(seed, steps=60):
    """Mostly ahead, so that borders and targets are met."""
    return jnp.asarray(np.random.default_rng(seed).uniform([-0.2, -1.0], [1.0, 1.0], (steps, 2)))


@pytest.mark.parametrize("kind", ["stop", "stay", "free"])
def test_an_agent_in_a_region(kind):
    scenario = replace(WORLD, region=replace(YARD, agent=kind))
    problem, actions = scenario.problem(), random_actions(1)
    episode = training_episode(problem, scenario.scenes, jax.random.key(3), noise=True)
    trace = rolled(scenario, actions, TRUE, episode)
    truth = np.asarray(episode.truth.state)[..., :2]
    stopped = kept_off = 0
    for k in range(60):
        v, w = nearest_command(np.asarray(actions[k]))
        before, after = trace.pose[k], arc(trace.pose[k], v, w, 1.0)
        end = after[:2] if kind == "free" else until_border(before[:2], after[:2], kind == "stay")
        stopped += not np.allclose(end, after[:2])
        clear = until_targets(before[:2], end, truth[k + 1], 0.8)
        kept_off += not np.allclose(end, clear)
        np.testing.assert_allclose(trace.pose[k + 1, :2], clear, atol=2e-3)
        assert np.cos(trace.pose[k + 1, 2] - after[2]) == pytest.approx(1.0, abs=1e-12), "it turns as commanded"
    assert kept_off >= 3, "targets must be met"
    assert (stopped == 0) if kind == "free" else (stopped >= 3), "borders must be met"


def test_only_present_targets_stop_the_agent():
    """One is not part of the scene; another dies in the first step, and so is not there at its end."""
    problem = OPEN.problem()
    episode = training_episode(problem, OPEN.scenes, jax.random.key(3), noise=True)
    ahead = episode.pose[:2] + 1.0 * jnp.array([jnp.cos(episode.pose[2]), jnp.sin(episode.pose[2])])
    states = jnp.zeros_like(episode.truth.state).at[..., :2].set(ahead)
    present = jnp.zeros((61, 3), bool).at[0, 1].set(True)
    episode = replace(
        episode, truth=replace(episode.truth, state=states), present=present[0], arrivals=Arrivals(present, states)
    )
    scenario, actions = replace(OPEN, keep_off_m=0.8), jnp.ones((60, 2)).at[:, 1].set(0.0)
    free, kept = (rolled(s, actions, TRUE, episode) for s in (OPEN, scenario))
    np.testing.assert_array_equal(kept.pose, free.pose)
    staying = replace(episode, arrivals=Arrivals(present.at[:, 1].set(True), states))
    assert np.linalg.norm(rolled(scenario, actions, TRUE, staying).pose[1, :2] - ahead) >= 0.8 - 1e-9


def test_without_truth_the_predicted_means_stop_the_agent():
    scenario = replace(WORLD, region=replace(YARD, targets="free"))
    episode = training_episode(scenario.problem(), scenario.scenes, jax.random.key(5), noise=False)
    trace = rolled(scenario, random_actions(2), SURROGATE, episode)
    gaps = np.linalg.norm(trace.pose[:, None, :2] - trace.mean[..., :2], axis=-1)
    nearer = gaps[1:] < np.minimum(np.linalg.norm(trace.pose[:-1, None, :2] - trace.mean[1:, :, :2], axis=-1), 0.8)
    assert not (nearer & (gaps[1:] < 0.8 - 1e-9)).any()
    free = rolled(OPEN, random_actions(2), SURROGATE, episode)
    assert not np.allclose(free.pose, trace.pose)


def test_a_plan_moves_as_the_simulation():
    """The information at the end, by the plan's own recursion and by a noise-free simulation of its actions."""
    scenario = replace(WORLD, region=replace(YARD, targets="free"), scenes=replace(WORLD.scenes, steps=12))
    problem, actions = scenario.problem(), random_actions(4, 12)
    episode = training_episode(problem, scenario.scenes, jax.random.key(6), noise=False)
    run = jax.jit(lambda e: rollout(problem, FixedActions(actions), e, SURROGATE, jax.random.key(0)))
    trace = run(episode)
    first = jnp.linalg.inv(
        problem.motion.A @ jnp.linalg.inv(problem.prior_information) @ problem.motion.A.T + problem.motion.W
    )
    future = Future(episode.pose, trace.mean[1:], jnp.stack([first] * 3), episode.present, episode.horizon)
    level, planned = SURROGATE.levels[0], eqx.filter_jit(final_log_det)
    np.testing.assert_allclose(planned(problem, future, actions, level), trace.log_det[-1], rtol=1e-9)
    free = OPEN.problem()
    assert not np.allclose(planned(free, future, actions, level), trace.log_det[-1], rtol=1e-3)


def test_in_space_the_plane_has_the_same_borders():
    scenario = replace(WORLD, agent=replace(WORLD.agent, commands=None))
    problem, actions = scenario.problem(), random_actions(7)
    episode = training_episode(problem, scenario.scenes, jax.random.key(8), noise=True)
    flat = rolled(scenario, actions, TRUE, episode)
    lifted = eqx.filter_jit(rollout)(
        embedded_problem(problem), FixedActions(actions), embedded_episode(episode), TRUE, jax.random.key(0)
    )
    np.testing.assert_allclose(lifted.pose[:, :2, 3], flat.pose[:, :2], atol=1e-9)
    assert (np.abs(flat.pose[:, :2]) > np.array([4.0, 3.0]) - 1e-9).any(), "borders must be met"


def test_a_world_has_only_the_stages_that_it_needs():
    def names(scenario):
        problem = scenario.problem()
        episode = training_episode(problem, OPEN.scenes, jax.random.key(0), noise=True)
        return [stage.__name__ for stage in stages(problem, TRUE, instants(episode))]

    rest = ["expect_noise", "sense", "correct_means", "weigh_measured", "update_information"]
    assert names(OPEN) == ["move", *rest]
    assert names(WORLD) == ["move", "stop_at_border", "keep_off_targets", *rest]
    assert names(replace(OPEN, region=replace(YARD, agent="free"))) == ["move", *rest]
