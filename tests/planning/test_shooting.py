"""Plans against brute force, finite differences, a textbook filter, closed forms; what an online planner knows."""

import itertools
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.experiment.presets import PRESETS
from foveate.geometry.fov import ball
from foveate.geometry.fov_spatial import cone, prism
from foveate.geometry.space import SPACES
from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.models.sensor import PAPER_SOFTNESS, Sensor, Softness
from foveate.models.target import LinearGaussian
from foveate.planning.information import Future, final_log_det, score
from foveate.planning.receding import FixedActions, Receding, believed_future
from foveate.planning.shooting import PAPER, Plan, PlanSettings, ascend, better, level_at, plan
from foveate.planning.tours import best_range, straight_ahead, tours
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.scenario.sensor import ScheduleSettings
from foveate.simulation.records import SURROGATE, TRUE, Observation, Policy
from foveate.simulation.rollout import log_dets

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


def covariance_filter(problem, future, action, weight):
    """log det Y by the textbook covariance filter, with V / weight as the noise of a target that counts so much."""
    rotation_of, motion, sensor = problem.agent.space.rotation, problem.motion, problem.sensor
    A, W, H = (np.asarray(x) for x in (motion.A, motion.W, sensor.H))
    pose = future.pose
    covariances = [np.linalg.inv(Y) for Y in np.asarray(future.information)]
    for k in range(len(action)):
        pose = problem.agent.move(pose, action[k], problem.tau)
        points = problem.agent.space.to_body(pose, motion.position(future.state[k]))
        for j, P in enumerate(covariances):
            P = P if k == 0 else A @ P @ A.T + W
            w = float(weight(sensor.view.signed_distance(points[j])))
            if w > 0:
                V = np.asarray(sensor.covariance(rotation_of(pose), points[j])) / w
                gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
                P = P - gain @ H @ P
            covariances[j] = P
    return -np.array([np.linalg.slogdet(P)[1] for P in covariances])


@pytest.mark.parametrize("hard", [True, False])
def test_score_is_that_of_a_textbook_filter(hard):
    from scipy.special import erfc

    future = spatial_future()
    action = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (4, 3)))
    level = None if hard else Softness(0.7, 0.5)
    weight = (lambda d: float(d <= 0)) if hard else (lambda d: 0.5 * erfc(float(d) / (np.sqrt(2) * 0.5) - 0.7))
    expected = covariance_filter(SPATIAL, future, action, weight)
    found = jax.jit(lambda f: final_log_det(SPATIAL, f, action, level))(future)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("problem", ["planar", "spatial"])
def test_gradient_through_a_plan(problem):
    level, rng = Softness(1.0, 0.6), np.random.default_rng(1)
    if problem == "spatial":
        problem, future, action = SPATIAL, spatial_future(), rng.uniform(-0.8, 0.8, (4, 3))
    else:
        problem = PROBLEM
        future = future_of(PROBLEM, [0, 0, 0.3], rng.uniform(-3, 3, (5, 3, 2)), horizon=4)
        action = rng.uniform(-0.8, 0.8, (5, 2))
    value = jax.jit(lambda a: score(problem, future, a, level))
    gradient = np.asarray(jax.jit(jax.grad(value))(jnp.asarray(action)))
    assert np.abs(gradient).max() > 0.01
    for index in np.ndindex(*action.shape):
        step = np.zeros_like(action)
        step[index] = 1e-5
        difference = (float(value(action + step)) - float(value(action - step))) / 2e-5
        np.testing.assert_allclose(gradient[index], difference, atol=1e-6, rtol=1e-5)


def test_steps_after_the_horizon_and_absent_targets_do_not_count():
    rng = np.random.default_rng(2)
    state, action = rng.uniform(-3, 3, (5, 3, 2)), jnp.asarray(rng.uniform(-1, 1, (5, 2)))
    long = eqx.tree_at(
        lambda f: f.present, future_of(PROBLEM, [0, 0, 0], state, horizon=3), jnp.array([True, True, False])
    )
    short = future_of(PROBLEM, [0, 0, 0], state[:3, :2])
    worth = jax.jit(lambda f, a: score(PROBLEM, f, a, PAPER_SOFTNESS))
    np.testing.assert_allclose(worth(long, action), worth(short, action[:3]), rtol=1e-12)


def test_score_is_that_of_the_one_simulation():
    """The noise-free rollout of training, with the same actions."""
    suite = prepare(PROBLEM, PRESETS["paper"].scenario.scenes, [TWO], seed=3)
    episode = jax.tree.map(lambda x: x[0], suite.episodes)
    episode = eqx.tree_at(lambda e: e.truth, episode, None)
    action = jnp.asarray(np.random.default_rng(4).uniform(-1, 1, (TWO.horizon, 2)))
    simulated = jax.jit(lambda e: log_dets(PROBLEM, FixedActions(action), e, SURROGATE, jax.random.key(0)))(episode)
    mean = [episode.mean]
    for known_input in episode.inputs:
        mean.append(PROBLEM.motion.advance(mean[-1], known_input))
    Y = np.asarray(PROBLEM.prior_information)
    future = future_of(PROBLEM, episode.pose, mean[1:], np.linalg.inv(np.linalg.inv(Y) + np.asarray(PROBLEM.motion.W)))
    found = jax.jit(lambda f: final_log_det(PROBLEM, f, action, PAPER_SOFTNESS))(future)
    np.testing.assert_allclose(found, simulated[-1], rtol=1e-12)


TWO = Scene(id="two", agent=(0.0, 0.0, 0.5), targets=((4.0, 1.0), (-5.0, 2.0)), drift=((0.1, 0.0),) * 2, horizon=6)


def test_plans_are_as_good_as_brute_force():
    """All sequences of 3 steps over a grid of 5 speeds and 7 turn rates; the ascent may not end below their best."""
    state = np.array([[[3.0, 2.5], [-1.0, -2.0]]] * 3) + 0.3 * np.arange(3)[:, None, None]
    future = future_of(PROBLEM, [0, 0, 0], state)
    grid = np.array(list(itertools.product(np.linspace(-1, 1, 5), np.linspace(-1, 1, 7))))
    sequences = jnp.asarray([np.stack(rows) for rows in itertools.product(grid, repeat=3)])
    values = jax.jit(lambda a: jax.lax.map(lambda one: score(PROBLEM, future, one, None), a, batch_size=5000))(
        sequences
    )
    settings = PlanSettings(starts=32, iterations=100)
    best = jax.jit(lambda f: plan(PROBLEM, f, settings, jax.random.key(1)))(future)
    assert float(best.score) >= float(values.max()) - 1e-9


def test_levels_move_from_first_to_last():
    settings = PlanSettings(iterations=100, first=(3.0, 0.6), last=(0.5, 0.2), annealed=0.5)
    for iteration, expected in ((0, (3.0, 0.6)), (25, (1.75, 0.4)), (50, (0.5, 0.2)), (99, (0.5, 0.2))):
        np.testing.assert_allclose(level_at(settings, jnp.array(iteration)), expected, rtol=1e-6)


def test_settings_are_checked():
    for name, value in (("starts", 0), ("iterations", -1), ("learning_rate", 0.0), ("annealed", -0.1)):
        with pytest.raises(ValueError, match=f"{name} = {value}"):
            PlanSettings(**{name: value})
    with pytest.raises(ValueError, match="last"):
        PlanSettings(last=(0.3, 0.0))


def test_best_range_is_the_deepest_point_ahead():
    # Triangle of depth 2 and 120 deg: as far from the end as from the sides, 2 - x = x sin 60.
    np.testing.assert_allclose(best_range(PROBLEM.sensor.view), 2 / (1 + np.sin(np.pi / 3)), atol=0.03)
    np.testing.assert_allclose(best_range(ball([1.0, 0.0], 1.0)), 1.0, atol=0.03)
    assert best_range(SPATIAL.sensor.view) > 1
    np.testing.assert_array_equal(best_range(prism(PROBLEM.sensor.view)), best_range(PROBLEM.sensor.view))


def test_a_schedule_is_rejected():
    changing = Scenario(schedule=ScheduleSettings(tau_s=(1.0, 0.5))).problem()
    future = Future(
        pose=jnp.zeros(3),
        state=jnp.ones((2, 1, 2)),
        information=0.5 * jnp.eye(2)[None],
        present=jnp.array([True]),
        horizon=jnp.array(2),
    )
    with pytest.raises(ValueError, match="the scenario has a schedule"):
        score(changing, future, jnp.zeros((2, 2)), None)


def receding(settings=FEW, policy=None):
    steps = TWO.horizon
    return Receding(problem=PROBLEM, settings=settings, window=steps, horizon=jnp.array(steps), policy=policy)


def test_a_target_straight_ahead_is_always_seen():
    """Closed form, one number per axis: variance p' = p + W, Y' = 1 / p' + 1 / V at every step."""
    steps = 5
    future = future_of(PROBLEM, [0, 0, 0], np.full((steps, 1, 2), [4.0, 0.0]))
    best = jax.jit(lambda f: plan(PROBLEM, f, FEW, jax.random.key(0)))(future)
    reached = [0.5 + 1 / 0.2**2]
    for _ in range(steps - 1):
        reached.append(1 / (1 / reached[-1] + 0.05**2) + 1 / 0.2**2)
    # One step of up to 4 m brings the target into the view of 2 m.
    np.testing.assert_allclose(best.score, 2 * np.log(reached[-1]), rtol=1e-9)


@pytest.fixture(scope="module")
def climb():
    """Ascent over 3 steps in the real view, compiled."""
    future = future_of(PROBLEM, [0, 0, 0], np.full((3, 1, 2), [3.0, 1.0]))
    return lambda raw, settings: jax.jit(lambda raw: ascend(PROBLEM, future, raw, settings))(raw), future


def test_limits_hold_exactly_even_far_up_the_tanh(climb):
    best = climb[0](jnp.full((3, 2), 50.0), replace(FEW, learning_rate=5.0))
    control = np.asarray(jax.vmap(PROBLEM.agent.control)(best.action))
    assert (control >= np.asarray(PROBLEM.agent.lower)).all()
    assert (control <= np.asarray(PROBLEM.agent.upper)).all()
    assert (control[:, 0] == 4.0).all()
    assert np.isfinite(best.score)


def test_the_best_on_the_way_is_kept(climb):
    worse, best, broken = (Plan(jnp.zeros((1, 2)) + i, jnp.array(v)) for i, v in enumerate((1.0, 2.0, np.nan)))
    assert float(better(worse, best).score) == float(better(best, worse).score) == 2.0
    assert float(better(best, broken).score) == 2.0
    ascent, future = climb
    start = straight_ahead(PROBLEM, 3) + 0.1
    found = ascent(start, replace(FEW, learning_rate=30.0))  # throws every control to a limit at once
    assert float(found.score) >= float(jax.jit(lambda f: score(PROBLEM, f, jnp.tanh(start), None))(future))


def test_tours_look_at_every_target():
    position = np.array([[3.0, 3.0], [-3.0, 2.0], [0.0, -4.0]])
    future = future_of(PROBLEM, [0, 0, 0], np.broadcast_to(position, (15, 3, 2)))
    raw = jax.jit(lambda f: tours(PROBLEM, f, 16, jax.random.key(0)))(future)
    assert raw.shape == (16, 15, 2)
    assert len(np.unique(np.asarray(raw)[:, 0, 1])) == 16
    seen = jax.jit(jax.vmap(lambda one: final_log_det(PROBLEM, future, jnp.tanh(one), None)))(raw)
    assert (np.asarray(seen) > 3).mean() > 0.5, "most targets are seen by most tours, before any ascent"


class Gentle(Policy):
    """Turns by where the first target is, far from the limits, and counts its decisions."""

    def start(self, observation):
        return jnp.zeros(())

    def __call__(self, observation, memory, key):
        return 0.5 * jnp.tanh(observation.mean[0] - observation.pose[:2] + 0.1 * memory), memory + 1


def test_without_ascent_refinement_does_what_the_policy_does():
    suite = prepare(PROBLEM, PRESETS["paper"].scenario.scenes, [TWO], seed=3)
    refined = receding(replace(FEW, starts=1, iterations=0), Gentle())
    plain, same = (evaluate_traces(suite, policy, TRUE, chunk=1).action for policy in (Gentle(), refined))
    np.testing.assert_allclose(same, plain, atol=1e-12)


def changed_later(suite):
    """Other inputs and another truth from the second step on."""
    later = eqx.tree_at(
        lambda e: (e.inputs, e.truth.state),
        suite.episodes,
        (suite.episodes.inputs.at[:, 1:].add(0.7), suite.episodes.truth.state.at[:, 2:].add(1.3)),
    )
    return replace(suite, episodes=later, truth=later.truth)


def test_online_planners_do_not_see_the_future():
    suite = prepare(PROBLEM, PRESETS["paper"].scenario.scenes, [TWO], seed=3)
    settings = replace(FEW, starts=3, iterations=10, keep=PAPER)
    here, there = (
        evaluate_traces(one, receding(settings, Gentle()), SURROGATE, chunk=1).action[0]
        for one in (suite, changed_later(suite))
    )
    np.testing.assert_array_equal(here[0], there[0])
    assert np.abs(here[1:] - there[1:]).max() > 1e-3, "what it sees later, it uses"


def test_belief_about_later_inputs_is_their_mean_so_far():
    """The plan of the second step is the one for a future of the mean of two inputs."""
    observation = Observation(
        step=jnp.array(1),
        left=jnp.array(5),
        pose=jnp.zeros(3),
        mean=jnp.array([[1.0, 2.0]]),
        information=jnp.eye(2)[None],
        present=jnp.array([True]),
        known_input=jnp.array([[0.4, 0.0]]),
    )
    settings = replace(FEW, starts=1, iterations=2, keep=PAPER)
    policy = receding(settings)

    @jax.jit
    def both(observation):
        memory = eqx.tree_at(lambda m: m.total_input, policy.start(observation), jnp.array([[0.2, -0.2]]))
        future = believed_future(PROBLEM, observation, jnp.array([[0.3, -0.1]]), TWO.horizon, jnp.array(5))
        expected = plan(PROBLEM, future, settings, jax.random.key(0), straight_ahead(PROBLEM, TWO.horizon)[None])
        return future, expected.action[0], policy(observation, memory, jax.random.key(0))

    future, expected, (action, memory) = both(observation)
    np.testing.assert_allclose(future.state[:3, 0], [[1.0, 2.0], [1.3, 1.9], [1.6, 1.8]], rtol=1e-12)
    assert int(future.horizon) == 5, "of the six steps of the window one is done"
    np.testing.assert_allclose(action, expected, rtol=1e-9)
    np.testing.assert_allclose(memory.total_input, [[0.6, -0.2]], rtol=1e-12)
