"""The sensor manager in real Stone Soup runs: its Kalman filter, its managers and its geometry are the oracles."""

import datetime
import importlib
import re
import runpy
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

pytest.importorskip("stonesoup", reason="needs the extra stonesoup")

from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange, CartesianToElevationBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity, RandomWalk
from stonesoup.models.transition.nonlinear import ConstantTurn
from stonesoup.platform import Platform
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, KalmanPredictor
from stonesoup.sensor.radar.radar import RadarBearingRangeRate
from stonesoup.sensor.sensor import SimpleSensor
from stonesoup.types.detection import Clutter
from stonesoup.types.groundtruth import GroundTruthState
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, State
from stonesoup.types.track import Track
from stonesoup.updater.kalman import ExtendedKalmanUpdater, KalmanUpdater

from foveate.deploy.tracker import Tracker
from foveate.errors import InputError
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import BEST
from foveate.geometry import fov_planar
from foveate.geometry.fov_spatial import frustum
from foveate.geometry.space import Spatial
from foveate.models import belief
from foveate.models.agent import Agent
from foveate.planning.named import heuristic_policy
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Policy
from foveate.stonesoup import BodyMovable, PolicySensorManager, ViewSensor, pose_of, problem_of
from foveate.stonesoup.manager import state_order

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "stonesoup.md"
EXPERIMENT = runpy.run_path(str(ROOT / "experiments" / "stone_soup.py"))
START, SECOND = datetime.datetime(2026, 1, 1), datetime.timedelta(seconds=1)
PROBLEM = PRESETS["best"].scenario.problem()
V = np.array([[0.04, 0.01], [0.01, 0.09]])
PLAIN = {"ndim_state": 4, "position_mapping": (0, 2), "noise_covar": V}
ORDER = [0, 2, 1, 3]
"""Of Stone Soup's [x, vx, y, vy] to foveate's [x, y, vx, vy]."""


def body_of(agent=PROBLEM.agent, state=(0.0, 0.0), mapping=(0, 1), yaw=0.0, **options):
    orientation = np.array([[0.0], [0.0], [yaw]])
    return BodyMovable(
        states=State(list(state), timestamp=START),
        position_mapping=mapping,
        agent=agent,
        orientation=orientation,
        **options,
    )


def mounted(body, sensor=None, **options):
    """A sensor, by default one with the preset's view, and the platform that carries it."""
    given = {**PLAIN, "view": PROBLEM.sensor.view, "space": body.agent.space} | options
    sensor = ViewSensor(**given) if sensor is None else sensor
    return sensor, Platform(movement_controller=body, sensors=[sensor])


def walking():
    return CombinedLinearGaussianTransitionModel([ConstantVelocity(0.05), ConstantVelocity(0.02)])


@jax.jit
def ours(problem, mean, information, z, seen):
    """One step of foveate's own filter for every target."""
    mean = problem.motion.advance(mean, jnp.zeros((len(mean), 2)))
    information = jax.vmap(belief.predict_information, (0, None))(information, problem.motion)
    H, covariance = problem.sensor.H, problem.sensor.V
    correct = jax.vmap(lambda p, P, z: belief.correct_mean(belief.Belief(p, P), z, H, covariance))
    gain = problem.sensor.information(covariance)
    mean = jnp.where(seen[:, None], correct(mean, information, z), mean)
    return mean, jax.vmap(belief.update_information, (0, None, 0))(information, gain, seen.astype(float))


@eqx.filter_jit
def decide(policy, seen):
    return policy(seen, policy.start(seen), jax.random.key(0))


def in_triangle(pose, point):
    """The preset's view, 2 m deep and 120 degrees wide, by its two inequalities."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ahead, left = np.array([[c, s], [-s, c]]) @ (point - pose[:2])
    return bool(ahead <= 2.0 and abs(left) <= np.tan(np.pi / 3) * ahead)


def test_a_run_in_which_the_filters_agree():
    """Every belief of Stone Soup's tracks, of foveate's filter and of its tracker, from the same detections."""
    body = body_of()
    sensor, platform = mounted(body, seed=5)
    predictor, updater, P = KalmanPredictor(walking()), KalmanUpdater(None), np.diag([2.0, 0.3, 1.5, 0.2])
    problem = problem_of(sensor, predictor, 1.0, P)
    policy = heuristic_policy("nearest", problem, 2.0)
    manager = PolicySensorManager(platforms={platform}, predictor=predictor, policy=policy, pad_to=5)
    rng, tracker = np.random.default_rng(1), Tracker(problem, gate=None, forget_after_s=1e9)
    truth = np.array([[2.0, 0.0, 1.0, 0.0], [-3.0, 0.0, 2.0, 0.0], [1.0, 0.0, -2.0, 0.0]])
    tracks = [Track([GaussianState(row, P, timestamp=START)], id=str(i)) for i, row in enumerate(truth)]
    first = P[np.ix_(ORDER, ORDER)]
    for i, row in enumerate(truth):
        tracker.add(i, row[[0, 2]], first)
    mean, information = jnp.array(truth[:, ORDER]), jnp.tile(jnp.linalg.inv(first), (3, 1, 1))
    updates = 0
    for k in range(1, 16):
        now = START + k * SECOND
        ((actionable, (command,)),) = manager.choose_actions(set(tracks), now)[0].items()
        tracker.predict()
        seen = tracker.observation(platform.pose, 8)
        wanted, _ = decide(policy, seen)
        np.testing.assert_allclose(command.target_value, problem.agent.control(wanted), atol=1e-5)
        actionable.add_actions((command,))
        actionable.act(now)
        truth = truth @ walking().matrix(time_interval=SECOND).T + rng.normal(0, 0.05, truth.shape)
        found = [sensor.measure({GroundTruthState(row, timestamp=now)}) for row in truth]
        inside = [in_triangle(body.pose, row[[0, 2]]) for row in truth]
        assert [bool(detections) for detections in found] == inside
        for track, detections in zip(tracks, found, strict=True):
            predicted = predictor.predict(track.state, timestamp=now)
            track.append(updater.update(SingleHypothesis(predicted, *detections)) if detections else predicted)
        z = {i: np.array(detection.state_vector)[:, 0] for i, one in enumerate(found) for detection in one}
        tracker.update(platform.pose, z)
        rows = jnp.array([z.get(i, np.zeros(2)) for i in range(3)])
        mean, information = ours(problem, mean, information, rows, jnp.array(inside))
        theirs = np.array([np.asarray(track.state.mean)[ORDER, 0] for track in tracks])
        spread = np.array([np.asarray(track.state.covar)[np.ix_(ORDER, ORDER)] for track in tracks])
        for ours_mean, ours_spread in ((mean, jnp.linalg.inv(information)), (tracker.mean, tracker.covariance)):
            np.testing.assert_allclose(ours_mean, theirs, atol=1e-9)
            np.testing.assert_allclose(ours_spread, spread, atol=1e-9)
        updates += sum(inside)
    assert 8 < updates < 45


def test_beside_stone_soups_own_managers():
    """The experiment in small: with one sensor the greedy manager is the brute-force one."""
    scene = Scene(
        id="tiny-00", agent=(0.0, 0.0, 0.0), targets=((1.0, 0.5), (-6.0, 1.0)), drift=((0.0, 0.0),) * 2, horizon=6
    )
    policies, found, took = {"uncertain": heuristic_policy("uncertain", PROBLEM, 2.0)}, {}, {}
    for name in ("uncertain", "brute force", "greedy"):
        world = EXPERIMENT["World"](PROBLEM, scene, (3, 3), steers=name == "greedy")
        found[name], seen, times = world.run(EXPERIMENT["manager_of"](name, policies, world, PROBLEM))
        took[name] = np.median(times)
        assert len(world.body.states) == 7
        assert seen[:, 0].any()
    np.testing.assert_allclose(found["greedy"], found["brute force"], rtol=1e-9)
    assert found["uncertain"][-1].mean() > found["brute force"][-1].mean() + 1.0
    assert took["uncertain"] < took["brute force"]


def test_a_body_follows_its_commands():
    """In the plane an arc; a command that has ended leaves the body as still as it can be."""
    body = body_of(state=(1.0, 9.0, 2.0, 9.0), mapping=(0, 2), yaw=0.5)
    (generator,) = body.actions(START + SECOND)
    v, w = 2.0, -0.8
    body.add_actions([generator.action_from_value(np.array([v, w]))])
    for k, seconds in enumerate((0.25, 1.0, 3.0, 3.0)):
        body.move(START + seconds * SECOND)
        t = min(seconds, 1.0)
        expected = [1 + v / w * (np.sin(0.5 + w * t) - np.sin(0.5)), 2 - v / w * (np.cos(0.5 + w * t) - np.cos(0.5))]
        np.testing.assert_allclose(body.pose, [*expected, 0.5 + w * t], atol=1e-12)
        assert len(body.states) == min(k + 2, 4)  # no time, no state
    assert generator.action_from_value(np.array([2.0, -0.8])) in generator
    assert np.array([4.1, 0.0]) not in generator
    assert next(iter(generator)).target_value.tolist() == [0.0, -np.pi / 3]
    assert len(list(generator)) == 25


def test_a_body_with_a_set_of_commands_offers_these():
    agent = PROBLEM.agent
    commands = jnp.array([[0.0, -1.0], [0.0, 1.0], [2.0, 0.0]])
    body = body_of(Agent(agent.space, agent.axes, agent.lower, agent.upper, commands), (1.0, 2.0), (0, 1))
    (generator,) = body.actions(START + SECOND)
    np.testing.assert_array_equal([action.target_value for action in generator], commands)


def test_a_body_and_its_view_in_space():
    """Poses against scipy's exponential; what is in the frustum against the angles that Stone Soup measures itself."""
    axes = tuple(range(6))
    agent = Agent(space=Spatial(), axes=axes, lower=jnp.full(6, -3.0), upper=jnp.full(6, 3.0))
    body = body_of(agent, (1.0, 2.0, 3.0), (0, 1, 2), levels=(2,) * 6)
    sensor, _ = mounted(
        body, ndim_state=3, position_mapping=(0, 1, 2), noise_covar=np.eye(3), view=frustum(0.5, 6.0, 1.4, 0.9)
    )
    rng, T, checked = np.random.default_rng(3), np.eye(4), []
    T[:3, 3] = [1, 2, 3]
    for k in range(1, 6):
        u = rng.uniform(-1.5, 1.5, 6)
        now = START + k * SECOND
        (generator,) = body.actions(now)
        body.add_actions([generator.action_from_value(u)])
        body.move(now)
        hat = np.zeros((4, 4))
        hat[:3, :3], hat[:3, 3] = np.cross(np.eye(3), u[3:]), u[:3]
        T = T @ expm(hat)
        np.testing.assert_allclose(body.pose, T, atol=1e-9)
        np.testing.assert_allclose(pose_of(sensor, Spatial())[:3, 0], T[:3, 0], atol=1e-9)
        angles = CartesianToElevationBearingRange(
            ndim_state=3,
            mapping=(0, 1, 2),
            noise_covar=np.eye(3),
            translation_offset=body.position,
            rotation_offset=body.orientation,
        )
        for point in T[:3, 3] + T[:3, 0] * 3 + rng.normal(0, 2.0, (20, 3)):
            elevation, bearing, away = np.array(angles.function(State(point))[:, 0], float)
            x = away * np.cos(elevation) * np.cos(bearing)
            y, z = away * np.cos(elevation) * np.sin(bearing), away * np.sin(elevation)
            inside = bool(0.5 <= x <= 6 and abs(y) <= x * np.tan(0.7) and abs(z) <= x * np.tan(0.45))
            assert sensor.is_detectable(State(point)) == inside
            assert sensor.is_clutter_detectable(Clutter(point)) == inside
            checked.append(inside)
    assert 10 < sum(checked) < 90


class Ending(Policy):
    """Drive faster the nearer the end is, and turn to a random side."""

    def __call__(self, observation, memory, key):
        del memory
        return jnp.stack([2 / observation.left - 1, jax.random.uniform(key)]), ()


def test_the_horizon_and_random_keys_are_those_of_a_rollout():
    body = body_of()
    sensor, _ = mounted(body, steers=True)
    given = {"sensors": {sensor}, "predictor": KalmanPredictor(walking()), "policy": Ending()}
    track = Track([GaussianState(np.zeros(4), np.eye(4), timestamp=START)])
    turns = []
    for options, left in (({"end_time": START + 5 * SECOND}, [5, 4, 3]), ({"steps_left": 7, "seed": 1}, [7, 7, 7])):
        manager = PolicySensorManager(**given, **options)
        for k, steps in enumerate(left):
            now = body.state.timestamp + SECOND
            end = options.get("end_time")
            steps = steps if end is None else round((end - body.state.timestamp) / SECOND)
            assert k or steps == left[0]
            ((actionable, (command,)),) = manager.choose_actions({track} if k else set(), now)[0].items()
            assert actionable is sensor
            np.testing.assert_allclose(command.target_value[0], 4 / steps, atol=1e-6)
            turns.append(float(command.target_value[1]))
            actionable.add_actions((command,))
            actionable.act(now)
            assert body.state.timestamp == now
    assert len(set(turns)) == 6


class Camera(SimpleSensor):
    """A user's own: linear, with range and angle named as Stone Soup's radars name them."""

    max_range, fov_angle = 7.0, 1.0
    measurement_model = property(lambda self: LinearGaussian(ndim_state=2, mapping=(1, 0), noise_covar=V))

    def is_detectable(self, state, measurement_model=None):
        return True

    is_clutter_detectable = is_detectable


def test_the_problem_is_derived_from_stone_soup_models():
    body = body_of()
    camera = Camera()
    Platform(movement_controller=body, sensors=[camera])
    model = CombinedLinearGaussianTransitionModel([RandomWalk(0.1), RandomWalk(0.4)])
    problem = problem_of(camera, KalmanPredictor(model), 0.5, np.diag([2.0, 3.0]))
    assert problem.agent is PROBLEM.agent
    np.testing.assert_allclose(problem.sensor.V, V)
    np.testing.assert_allclose(problem.sensor.H, np.eye(2))  # it measures y, x: as its state is read
    np.testing.assert_allclose(problem.motion.W, np.diag([0.2, 0.05]))
    np.testing.assert_allclose(problem.prior_information, np.diag([1 / 3, 1 / 2]))
    np.testing.assert_allclose(problem.tau, 0.5)
    assert eqx.tree_equal(problem.sensor.view, fov_planar.sector(7.0, 1.0))


def test_order_of_states():
    assert state_order((0, 2), 4) == (0, 2, 1, 3)
    assert state_order((0, 1), 4) == (0, 1, 2, 3)
    assert state_order((2, 0), 4) == (2, 0, 3, 1)
    assert state_order((0, 3), 6) == (0, 3, 1, 4, 2, 5)
    assert state_order((0, 1, 2), 3) == (0, 1, 2)
    for mapping, size in (((0, 1), 3), ((1, 2), 4), ((0, 0), 2)):
        with pytest.raises(ValueError, match="position_mapping"):
            state_order(mapping, size)


def test_a_differing_scenario_gives_a_warning():
    body = body_of(replace_limits(PROBLEM.agent))
    view = fov_planar.sector(3.0, 1.0)
    plain = {"ndim_state": 2, "position_mapping": (0, 1), "noise_covar": 0.04 * np.eye(2)}
    _, platform = mounted(body, view=view, **plain)
    model = CombinedLinearGaussianTransitionModel([RandomWalk(0.05**2)] * 2)
    given = {"policy": Ending(), "predictor": KalmanPredictor(model), "trained_for": PROBLEM}
    with pytest.warns(UserWarning, match="another problem: body and its limits, field of view$"):
        PolicySensorManager(platforms={platform}, **given)
    _, platform = mounted(body_of(), **plain)
    PolicySensorManager(platforms={platform}, **given)  # no warning, or this test fails


def replace_limits(agent):
    return Agent(space=agent.space, axes=agent.axes, lower=agent.lower, upper=2 * agent.upper)


def test_unsupported_models_are_rejected_in_one_line():
    linear, given = KalmanPredictor(walking()), {"policy": Ending()}

    def rejected(match, platforms=(), sensors=(), predictor=linear):
        with pytest.raises(ValueError, match=match) as caught:
            PolicySensorManager(platforms=set(platforms), sensors=set(sensors), predictor=predictor, **given)
        assert "\n" not in str(caught.value)

    radar = RadarBearingRangeRate(ndim_state=4, position_mapping=(0, 2), velocity_mapping=(1, 3), noise_covar=np.eye(3))
    wrong = "RadarBearingRangeRate has a CartesianToBearingRangeRate: expected a linear-Gaussian"
    rejected(wrong, [mounted(body_of(), radar)[1]])
    turning = ExtendedKalmanPredictor(ConstantTurn([0.1, 0.1], 0.1))
    rejected("ExtendedKalmanPredictor has a ConstantTurn: expected", [mounted(body_of())[1]], predictor=turning)
    fixed = ViewSensor(**PLAIN, view=PROBLEM.sensor.view, space=PROBLEM.agent.space, position=np.zeros((2, 1)))
    rejected("carried by FixedMovable: expected a BodyMovable", sensors=[fixed])
    rejected("0 sensors: expected one")
    rejected("platforms is empty", sensors=[mounted(body_of())[0]])
    rejected("has an offset", [mounted(body_of(), mounting_offset=np.array([[1.0], [0.0]]))[1]])
    with pytest.raises(ValueError, match="expected 2 entries"):
        body_of(state=(0.0, 0.0, 0.0), mapping=(0, 1, 2))
    with pytest.raises(ValueError, match=r"levels = \(3,\): expected 2 numbers"):
        body_of(levels=(3,))
    manager = PolicySensorManager(platforms={mounted(body_of())[1]}, predictor=linear, **given)
    with pytest.raises(ValueError, match="nchoose = 2"):
        manager.choose_actions(set(), START + SECOND, nchoose=2)
    bare = Track([State(np.zeros(4), timestamp=START)], id="a")
    with pytest.raises(ValueError, match="track a: State: expected a Gaussian state"):
        manager.choose_actions({bare}, START + SECOND)


def test_without_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "stonesoup", None)
    monkeypatch.delitem(sys.modules, "foveate.stonesoup")
    with pytest.raises(ImportError, match=r"pip install 'foveate\[stonesoup\]'"):
        importlib.import_module("foveate.stonesoup")


def test_the_page_runs(tmp_path, monkeypatch):
    """docs/stonesoup.md, with the first weights of the paper's network: a body that moves within its limits."""
    run, experiment = tmp_path / "runs" / "first", Experiment()
    (run / BEST).parent.mkdir(parents=True)
    write_config(run, experiment)
    policy = experiment.policy.policy(PROBLEM, jax.random.key(0))
    save_tree(run / BEST, policy, experiment, "policy", {})
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    names = {}
    exec(compile(block, str(PAGE), "exec"), names)
    way = np.diff([np.array(state.state_vector)[:, 0] for state in names["body"].states], axis=0)
    assert len(way) == 6
    assert 0 < np.linalg.norm(way, axis=1).max() <= 4.0


def test_a_sensor_of_range_and_bearing_measures_and_is_known_in_stone_soups_coordinates():
    """Its problem expects what Stone Soup's own model of it measures; a policy decides on its tracks."""
    noise = np.diag([0.02, 0.2]) ** 2  # bearing [rad], range [m]: Stone Soup's order
    body = body_of(state=(1.0, -2.0), yaw=0.7)
    sensor, platform = mounted(body, model=CartesianToBearingRange, noise_covar=noise)
    problem = problem_of(sensor, KalmanPredictor(walking()), 1.0, np.eye(4))
    assert problem.sensor.polar is not None
    assert problem.sensor.polar.coordinates == ("bearing", "range")
    state = np.array([2.2, 0.1, -1.3, 0.0])
    theirs = np.asarray(sensor.measurement_model.function(State(state[:, None]), noise=False), float)[:, 0]
    pose = pose_of(sensor, body.agent.space)
    position_body = body.agent.space.to_body(jnp.asarray(pose), jnp.asarray([2.2, -1.3]))
    expected = problem.sensor.expected(jnp.asarray([state[ORDER]]), position_body[None])
    np.testing.assert_allclose(expected[0], theirs, rtol=1e-6)
    truth = GroundTruthState(state[:, None], timestamp=START)
    (detection,) = sensor.measure({truth}, noise=False)
    np.testing.assert_allclose(np.asarray(detection.state_vector, float)[:, 0], theirs, rtol=1e-6)
    track = Track([GaussianState(state[:, None], np.eye(4), timestamp=START)])
    updater = ExtendedKalmanUpdater(sensor.measurement_model)
    prediction = KalmanPredictor(walking()).predict(track.state, timestamp=START)
    track.append(updater.update(SingleHypothesis(prediction, detection)))
    manager = PolicySensorManager(
        platforms={platform}, policy=heuristic_policy("nearest", problem, 2.0), predictor=KalmanPredictor(walking())
    )
    ((command,),) = [actions.values() for actions in manager.choose_actions({track}, START + SECOND)]
    assert np.isfinite(command[0].target_value).all()


def test_a_model_that_is_none_of_its_own_frame_is_refused():
    sensor, _ = mounted(body_of(), model=LinearGaussian)
    with pytest.raises(InputError, match="expected one of CartesianToBearingRange"):
        _ = sensor.measurement_model
