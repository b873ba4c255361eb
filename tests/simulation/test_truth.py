"""Targets in a region against a plain loop in numpy, one target and one axis at a time."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode

from foveate.errors import InputError
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.scenario.sensor import ScheduleSettings
from foveate.scenario.target import AccelerationTarget, DriftTarget, StaticTarget, VelocityTarget
from foveate.simulation.episodes import Drawn, Noise, draw, draw_size, episode_of
from foveate.simulation.suites import scene_episodes

LOW, HIGH = np.array([-3.0, -2.0]), np.array([4.0, 2.5])
YARD = RegionSettings(low_m=tuple(LOW.tolist()), high_m=tuple(HIGH.tolist()))
SCENES = SceneSettings(targets_min=4, targets_max=4, shared_drift=False, initial_error="consistent")
STEPS, TARGETS = 120, 4


def rebound(value, low, high, e):
    """One number after a bounce off its border, and +1 or -1 where it was beyond, else 0."""
    if value > high:
        return max(low, high - e * (value - high)), 1
    if value < low:
        return min(high, low + e * (low - value)), -1
    return value, 0


def plain(problem, first, drift, inputs, pushes, e, stops):
    """States and inputs by a loop over steps, targets and axes: blocks of a state are derivatives of its position."""
    taus, entries = np.asarray(problem.period.tau), len(problem.period.tau)
    states, executed, velocity = [first], [], drift.copy()
    for k in range(len(inputs)):
        motion = jax.tree.map(lambda part, k=k: np.asarray(part[k % entries]), problem.period.motion)
        known = inputs[k] + taus[k % entries] * (velocity - drift) if motion.B.shape[1] == first.shape[1] else inputs[k]
        after = states[-1] @ motion.A.T + known @ motion.B.T + pushes[k]
        for j in range(after.shape[0]):
            for axis in range(2):
                after[j, axis], side = rebound(after[j, axis], LOW[axis], HIGH[axis], 0.0 if stops else e)
                for block in range(2 + axis, after.shape[1], 2):
                    if after[j, block] * side > 0:
                        after[j, block] *= 0.0 if stops else -e
                if velocity[j, axis] * side > 0:
                    velocity[j, axis] *= 0.0 if stops else -e
        states.append(after)
        executed.append(known)
    return np.array(states), np.array(executed)


def numbers(n_y):
    """Scene and noise of an episode."""
    rng, box = np.random.default_rng(3), (TARGETS, 2)
    scene = {
        "pose": np.zeros(3),
        "position": rng.uniform(LOW, HIGH, box),
        "drift": rng.uniform(-1, 1, box),
        "present": np.ones(TARGETS, bool),
        "horizon": np.array(STEPS),
    }
    noise = {
        "jitter": rng.uniform(-1, 1, (STEPS, TARGETS, 2)),
        "process": rng.normal(size=(STEPS, TARGETS, n_y)),
        "measurement": rng.normal(size=(STEPS, TARGETS, 2)),
        "first": rng.normal(size=(TARGETS, n_y)),
    }
    return scene, noise


def made(scenario, scene, noise):
    """Their episode as numpy arrays."""
    problem = scenario.problem()
    make = jax.jit(lambda s, n: episode_of(problem, scenario.scenes, Drawn(**s), Noise(**n)))
    return jax.tree.map(np.asarray, make(scene, noise))


def roots(W):
    """Roots by numpy; positions that drift have none of their own noise in the paper's model."""
    return np.linalg.cholesky(np.asarray(W)) if np.any(W) else np.zeros_like(W)


CASES = {
    "velocity": VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.05),
    "acceleration": AccelerationTarget(kind="constant_acceleration", jerk_m2_s5=0.02),
    "drift": DriftTarget(process_std_m=0.1),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(("e", "targets"), [(1.0, "bounce"), (0.4, "bounce"), (1.0, "stop")])
def test_targets_in_a_region(name, e, targets):
    schedule = ScheduleSettings(tau_s=(0.5, 1.0)) if name == "velocity" else ScheduleSettings()
    region = replace(YARD, restitution=e, targets=targets)
    scenario = Scenario(target=CASES[name], scenes=SCENES, region=region, schedule=schedule)
    problem = scenario.problem()
    n_y, period = problem.motion.state_size, problem.period
    scene, noise = numbers(n_y)
    episode = made(scenario, scene, noise)
    first = np.zeros((TARGETS, n_y))
    first[:, :2] = scene["position"]
    inputs = np.zeros((STEPS, TARGETS, problem.motion.input_size))
    if n_y == 2:
        inputs = float(problem.tau) * (scene["drift"] + SCENES.jitter_m_s * noise["jitter"])
    else:
        first[:, 2:4] = scene["drift"]
    W = np.asarray(period.motion.W)
    pushes = np.stack([noise["process"][k] @ roots(W[k % len(W)]).T for k in range(STEPS)])
    states, executed = plain(problem, first, scene["drift"], inputs, pushes, e, targets == "stop")
    np.testing.assert_allclose(episode.truth.state, states, atol=1e-9)
    np.testing.assert_allclose(episode.inputs, executed, atol=1e-9)
    position = episode.truth.state[..., :2]
    assert (position >= LOW - 1e-12).all()
    assert (position <= HIGH + 1e-12).all()
    assert not np.array_equal(executed, inputs) or n_y > 2, "no drift was turned: nothing tested"
    free = made(replace(scenario, region=None), scene, noise)
    apart = np.abs(free.truth.state[..., :2] - position).max(axis=(0, 2))
    assert (apart > 1.0).sum() >= 3, "most targets must meet a border"


def test_targets_at_rest_stay_and_start_inside():
    scenario = Scenario(target=StaticTarget(kind="static"), region=YARD, scenes=replace(SCENES, drift_m_s=(0.0, 0.0)))
    episode = training_episode(scenario.problem(), scenario.scenes, jax.random.key(0), noise=True)
    state = np.asarray(episode.truth.state)
    assert (state == state[0]).all()
    assert (state >= LOW).all()
    assert (state <= HIGH).all()


@pytest.mark.parametrize("agent", ["stop", "free"])
def test_starts_beyond_a_border_are_moved_onto_it(agent):
    """The box of the scenes, 8 m to each side, is larger than the region."""
    scenario = Scenario(scenes=SCENES, region=replace(YARD, agent=agent))
    problem, open_world = scenario.problem(), Scenario(scenes=SCENES).problem()
    numbers = jax.random.uniform(jax.random.key(4), (300, draw_size(SCENES, problem)), minval=-1.0)
    kept, free = (jax.jit(jax.vmap(lambda x, p=p: draw(SCENES, p, x)))(numbers) for p in (problem, open_world))
    np.testing.assert_array_equal(kept.position, np.clip(free.position, LOW, HIGH))
    start = np.asarray(free.pose)[:, :2]
    np.testing.assert_array_equal(kept.pose[:, :2], start if agent == "free" else np.clip(start, LOW, HIGH))
    np.testing.assert_array_equal(kept.pose[:, 2], free.pose[:, 2])


def test_a_scene_with_a_target_outside_is_rejected():
    scenario = Scenario(scenes=SCENES, region=YARD)
    scene = Scene(id="a", agent=(9.0, 0.0, 0.0), targets=((4.0, 2.5), (0.0, 3.0)), drift=((0.0, 0.0),) * 2, horizon=3)
    with pytest.raises(
        InputError, match=r"scene 'a': target = \(0\.0, 3\.0\): expected inside of the scenario's region"
    ):
        scene_episodes(scenario.problem(), SCENES, [scene], 0, 1)
    edge = replace(scene, targets=((4.0, 2.5), (-3.0000001, 0.0)))
    assert scene_episodes(scenario.problem(), SCENES, [edge], 0, 1).truth is not None
    free = Scenario(scenes=SCENES, region=replace(YARD, targets="free"))
    assert scene_episodes(free.problem(), SCENES, [scene], 0, 1).truth is not None


def test_borders_need_a_truth():
    scenario = Scenario(scenes=SCENES, region=YARD)
    with pytest.raises(InputError, match="noise = False: expected True"):
        training_episode(scenario.problem(), SCENES, jax.random.key(0), noise=False)
    free = Scenario(scenes=SCENES, region=replace(YARD, targets="free"))
    assert training_episode(free.problem(), SCENES, jax.random.key(0), noise=False).truth is None
    assert jnp.isfinite(training_episode(scenario.problem(), SCENES, jax.random.key(0), noise=True).mean).all()
