"""Targets of every kind: discretised by Van Loan's matrix exponential, and filtered by filterpy with what changes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import expm

from foveate.policies.heuristics import Nearest
from foveate.scenario.agent import DifferentialDrive, FreeBody
from foveate.scenario.field_of_view import BallView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import AccelerationTarget, StaticTarget, VelocityTarget, integrators
from foveate.simulation.episodes import draw, draw_noise, draw_size, episode_of, first_error
from foveate.simulation.records import TRUE, Episode, Truth
from foveate.simulation.rollout import rollout

TAUS = (0.5, 1.3, 0.2)
Q = ((0.3, 0.1, 0.0), (0.1, 0.2, 0.05), (0.0, 0.05, 0.4))


def van_loan(order, tau, density):
    """A, B, W of a chain of integrators driven by white noise, from one matrix exponential (Van Loan 1978)."""
    d = len(density)
    F = np.kron(np.eye(order, k=1), np.eye(d))
    L = np.kron(np.eye(order)[:, -1:], np.eye(d))
    n = len(F)
    block = expm(tau * np.block([[-F, L @ density @ L.T], [np.zeros((n, n)), F.T]]))
    A = block[n:, n:].T
    held = expm(tau * np.block([[F, L], [np.zeros((d, n + d))]]))
    return A, held[:n, n:], A @ block[:n, n:]


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_integrators_are_van_loan_s(order, dimension):
    density = np.array(Q)[:dimension, :dimension]
    for tau in TAUS:
        A, B, W, Z = integrators(order, tau, density)
        for ours, theirs in zip((A, B, W), van_loan(order, tau, density), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-14)
        np.testing.assert_array_equal(Z, np.eye(dimension, order * dimension))


@pytest.mark.parametrize("memory", [0.03, 0.5, 4.0, 1e7])
def test_velocities_decay_as_ornstein_uhlenbeck(memory):
    """Van Loan's exponential with a velocity that decays; with a long memory the chain of integrators."""
    density = np.array(Q)
    target = VelocityTarget(kind="constant_velocity", Q=Q, memory_s=memory)
    eye, nothing = np.eye(3), np.zeros((3, 3))
    F = np.block([[nothing, eye], [nothing, -eye / memory]])
    L = np.concatenate([nothing, eye])
    for tau in (0.1, 0.5):
        A, B, W, _ = target.motion(3, tau)
        block = expm(tau * np.block([[-F, L @ density @ L.T], [np.zeros((6, 6)), F.T]]))
        held = expm(tau * np.block([[F, L], [np.zeros((3, 9))]]))
        np.testing.assert_allclose(A, block[6:, 6:].T, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(B, held[:6, 6:], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(W, block[6:, 6:].T @ block[:6, 6:], rtol=1e-7, atol=1e-12)
    if memory == 1e7:
        for ours, chain in zip(target.motion(3, 0.5), integrators(2, 0.5, density), strict=True):
            np.testing.assert_allclose(ours, chain, rtol=1e-6, atol=1e-9)
    with pytest.raises(ValueError, match="memory_s"):
        target.motion(3, 21 * memory)


def test_initial_belief_and_drift_of_each_kind():
    velocity = VelocityTarget(kind="constant_velocity", initial_variance_m2=3.0, initial_velocity_variance_m2_s2=0.5)
    np.testing.assert_array_equal(np.diag(velocity.prior_covariance(2)), [3.0, 3.0, 0.5, 0.5])
    acceleration = AccelerationTarget(kind="constant_acceleration", initial_acceleration_variance_m2_s4=0.1)
    np.testing.assert_array_equal(np.diag(acceleration.prior_covariance(3)), [2.0] * 3 + [1.0] * 3 + [0.1] * 3)
    still = SceneSettings(drift_m_s=(0.0, 0.0))
    assert not Scenario(target=StaticTarget(kind="static"), scenes=still).problem().motion.takes_drift
    assert Scenario(target=velocity).problem().motion.takes_drift
    assert Scenario(target=acceleration).problem().motion.state_size == 6
    with pytest.raises(ValueError, match=r"scenes.drift_m_s = \(0.8, 0.8\): expected 0"):
        Scenario(target=StaticTarget(kind="static"))


def scheduled(target, dimension=3, V=(), W=()):
    """An agent that sees all around, with steps of three lengths."""
    drive = DifferentialDrive(space="spatial" if dimension == 3 else "planar")
    return Scenario(
        agent=drive,
        view=BallView(shape="ball", radius_m=1e6, center_m=(0.0,) * dimension),
        sensor=SensorSettings(std_m=0.3),
        target=target,
        scenes=SceneSettings(
            centre_m=(0.0,) * dimension, half_side_m=(5.0,) * dimension, drift_m_s=(0.5,) * dimension, steps=12
        ),
        schedule=ScheduleSettings(tau_s=TAUS, V=V, W=W),
    )


def drawn(scenario, steps):
    """A scene and its episode with truth."""
    problem, settings = scenario.problem(), scenario.scenes

    @jax.jit
    def both(key, noise_key):
        scene = draw(settings, problem, jax.random.uniform(key, (draw_size(settings, problem),), minval=-1.0))
        return scene, episode_of(problem, settings, scene, draw_noise(problem, noise_key, steps, settings.targets_max))

    return both(jax.random.key(1), jax.random.key(2))


def spd(rng, size, scale):
    root = rng.normal(size=(size, size))
    return tuple(map(tuple, scale * (root @ root.T + 0.2 * np.eye(size))))


@pytest.mark.parametrize("case", ["velocity 4", "velocity 6", "acceleration 9, full W_k and V_k"])
def test_a_schedule_is_filtered_as_filterpy_does(case):
    rng = np.random.default_rng(len(case))
    dimension = 2 if case == "velocity 4" else 3
    if case.startswith("velocity"):
        kind, order = VelocityTarget(kind="constant_velocity", Q=tuple(r[:dimension] for r in Q[:dimension])), 2
        scenario = scheduled(kind, dimension)
    else:
        order = 3
        kind = AccelerationTarget(kind="constant_acceleration", Q=Q)
        W = tuple(spd(rng, 9, 0.01) for _ in TAUS)
        scenario = scheduled(kind, V=tuple(spd(rng, 3, 0.1) for _ in TAUS), W=W)
    problem, steps = scenario.problem(), 12
    motion, n_y = problem.motion, order * dimension
    truth = rng.normal(size=(steps + 1, 1, n_y))
    noise = rng.normal(size=(steps, 1, dimension))
    first = rng.normal(size=n_y)
    episode = Episode(
        pose=problem.agent.space.identity(),
        mean=jnp.asarray(first)[None],
        present=jnp.array([True]),
        inputs=jnp.asarray(0.1 * rng.normal(size=(steps, 1, dimension))),
        horizon=jnp.asarray(steps),
        truth=Truth(jnp.asarray(truth), jnp.asarray(noise)),
    )
    trace = eqx.filter_jit(rollout)(problem, Nearest(problem, 1.0), episode, TRUE, jax.random.key(0))

    other = KalmanFilter(dim_x=n_y, dim_z=dimension, dim_u=dimension)
    other.x, other.P = first[:, None].copy(), np.linalg.inv(problem.prior_information)
    other.H = np.asarray(motion.Z)
    for k in range(steps):
        tau = TAUS[k % 3]
        other.F, other.B, W = van_loan(order, tau, np.array(Q)[:dimension, :dimension])
        other.Q = np.array(scenario.schedule.W[k % 3]) if scenario.schedule.W else W
        other.R = np.array(scenario.schedule.V[k % 3]) if scenario.schedule.V else 0.09 * np.eye(dimension)
        other.predict(u=np.asarray(episode.inputs[k, 0])[:, None])
        measured = other.H @ truth[k + 1, 0] + np.linalg.cholesky(other.R) @ noise[k, 0]
        other.update(measured[:, None])
        np.testing.assert_allclose(trace.mean[k + 1, 0], other.x[:, 0], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(np.linalg.inv(trace.information[k + 1, 0]), other.P, rtol=1e-10, atol=1e-10)


def test_scheduled_steps_move_agent_and_truth_for_as_long_as_they_last():
    target = VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.0)
    scenario = scheduled(target)
    problem, (scene, episode) = scenario.problem(), drawn(scenario, 12)
    elapsed = np.cumsum([0.0, *np.tile(TAUS, 4)])
    np.testing.assert_allclose(np.diff(elapsed), problem.step_lengths_s(12))
    straight = scene.position[None] + elapsed[:, None, None] * scene.drift[None]
    np.testing.assert_allclose(episode.truth.state[..., :3], straight, rtol=1e-12, atol=1e-12)
    drive = FreeBody(kind="body", axes=("vx",), lower=(1.0,), upper=(2.0,)).agent()
    move = jax.jit(lambda pose, k: drive.move(pose, jnp.ones(1), problem.at(k).tau))
    pose = problem.agent.space.identity()
    for k in range(4):
        pose = move(pose, jnp.asarray(k))
    np.testing.assert_allclose(pose[0, 3], 2.0 * elapsed[4], rtol=1e-12)


def test_the_first_error_of_the_paper_has_the_first_v():
    """25 m^2 at the first step: the first mean errs by 5 m, not by the sensor's own 0.2 m."""
    scenario = Scenario(schedule=ScheduleSettings(V=(((25.0, 0.0), (0.0, 25.0)),)))
    normal = jnp.asarray(np.random.default_rng(0).normal(size=(2000, 2)))
    error = first_error(scenario.problem(), scenario.scenes, normal)
    np.testing.assert_allclose(np.abs(error), 5.0 * np.abs(normal), rtol=1e-12)


def test_a_known_drift_of_positions_is_scaled_by_each_step():
    scenario = Scenario(schedule=ScheduleSettings(tau_s=TAUS), scenes=SceneSettings(jitter_m_s=0.0))
    scene, episode = drawn(scenario, 6)
    np.testing.assert_allclose(episode.inputs, np.tile(TAUS, 2)[:, None, None] * scene.drift[None], rtol=1e-12)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"tau_s": (0.5, 0.0)}, "tau_s = "),
        ({"tau_s": (0.5, 0.5), "V": (((1.0,),),)}, "expected lists of one length"),
        ({"W": (((1.0, 2.0), (2.0, 1.0)),)}, "no negative eigenvalue"),
        ({"V": (((0.0,),),)}, "positive definite"),
    ],
)
def test_bad_schedules(settings, words):
    with pytest.raises(ValueError, match=words):
        ScheduleSettings(**settings)


def test_schedules_of_another_size():
    with pytest.raises(ValueError, match=r"schedule\.V = \(\(1\.0,\),\): expected 2 x 2"):
        Scenario(schedule=ScheduleSettings(V=(((1.0,),),)))
    with pytest.raises(ValueError, match=r"schedule\.W = \(\(1\.0,\),\): expected 2 x 2"):
        Scenario(schedule=ScheduleSettings(W=(((1.0,),),)))
