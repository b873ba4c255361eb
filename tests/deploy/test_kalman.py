"""The robot's filter in numpy against the filter of the simulation in JAX, on the same random sequences, in float64."""

from collections import Counter
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.deploy.belief import Belief as NumpyBelief
from foveate.deploy.belief import predicted
from foveate.deploy.tracker import Tracker
from foveate.models.belief import Belief, correct_mean, predict_information, update_information
from foveate.models.gate import RESTART_AFTER, gate_limit, one_point, squared_distance
from foveate.models.missed_detection import condition_on_missed_detection
from foveate.names import GATE
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import VelocityTarget

STEPS, TARGETS = 60, 5
SENSOR = SensorSettings(V=((0.04, 0.01), (0.01, 0.09)), frame="body", range_growth_per_m=0.1)
SCENARIO = Scenario(
    view=SectorView(depth_m=3.0),
    sensor=SENSOR,
    target=VelocityTarget(kind="constant_velocity"),
    schedule=ScheduleSettings(tau_s=(0.5, 1.0)),
    scenes=SceneSettings(initial_error="consistent"),
)


def reference(problem):
    """One step of one target with the functions of `models`: its belief, and whether the measurement was accepted."""
    limit, space = gate_limit(GATE, 2), problem.agent.space

    @jax.jit
    def predict(belief, known_input, step):
        motion = problem.at(step).motion
        return Belief(motion.advance(belief.mean, known_input), predict_information(belief.information, motion))

    def noise(pose, point_world, step):
        sensor = problem.at(step).sensor
        return sensor, sensor.covariance(space.rotation(pose), space.to_body(pose, point_world))

    @jax.jit
    def update(prediction, z, pose, step):
        sensor, V = noise(pose, problem.motion.position(prediction.mean), step)
        accepted = squared_distance(prediction, z, sensor.H, V) <= limit
        information = update_information(prediction.information, sensor.information(V), jnp.array(1.0))
        return Belief(correct_mean(prediction, z, sensor.H, V), information), accepted

    @jax.jit
    def begin(z, pose, step):
        sensor, V = noise(pose, z, step)
        return one_point(problem.prior_information, z, sensor.H, V)

    @jax.jit
    def miss(prediction, pose, before, was_missed):
        def shows(pose, points_world):
            return problem.sensor.view.contains(space.to_body(pose, points_world))

        def is_inside(points_world):
            return shows(pose, points_world) & ~(was_missed & shows(before, points_world))

        return condition_on_missed_detection(prediction, problem.motion.Z, is_inside)

    return predict, update, begin, miss


@pytest.mark.parametrize("missed_detections", ["used", None])
def test_tracker_equals_the_filter_of_the_simulation(missed_detections):
    """Predict, update, gate, restart after a jump, missed detections, noise in the body frame that grows with range."""
    sensor = replace(SENSOR, missed_detections=missed_detections)
    problem, rng = replace(SCENARIO, sensor=sensor).problem(), np.random.default_rng(7)
    predict, update, begin, miss = reference(problem)
    tracker, beliefs, rejections = Tracker(problem, forget_after_s=1e9), {}, Counter()
    happened = Counter()
    before, missed = jnp.zeros(3), set()
    truth = rng.normal(0, 2, (TARGETS, 2))
    for step in range(STEPS):
        known = {i: rng.normal(0, 0.1, 2) for i in beliefs}
        tracker.predict(known_inputs=known)
        beliefs = {i: predict(belief, known[i], step) for i, belief in beliefs.items()}
        truth += rng.normal(0, 0.1, truth.shape)
        truth[rng.integers(TARGETS)] += 60.0 * (step % 20 == 10)
        pose = jnp.asarray([*rng.normal(0, 1, 2), rng.uniform(-np.pi, np.pi)])
        detections = {i: truth[i] + rng.normal(0, 0.2, 2) for i in range(TARGETS) if rng.random() < 0.7}
        tracker.update(pose, detections)
        for i in range(TARGETS):
            if i not in detections:
                if i in beliefs and missed_detections:
                    beliefs[i] = miss(beliefs[i], pose, before, i in missed)
                    happened["missed"] += 1
                continue
            z = jnp.asarray(detections[i])
            corrected, accepted = update(beliefs[i], z, pose, step) if i in beliefs else (None, False)
            rejections[i] = 0 if accepted else rejections[i] + 1
            if accepted:
                beliefs[i] = corrected
            elif i not in beliefs or rejections[i] >= RESTART_AFTER:
                happened["restarts"] += i in beliefs
                beliefs[i], rejections[i] = begin(z, pose, step), 0
            else:
                happened["rejected"] += 1
        before, missed = pose, set(beliefs) - set(detections)
        assert set(tracker.ids) == set(beliefs)
        for i, mean, covariance in zip(tracker.ids, tracker.mean, tracker.covariance, strict=True):
            np.testing.assert_allclose(mean, beliefs[i].mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(covariance, np.linalg.inv(beliefs[i].information), rtol=1e-9, atol=1e-9)
    assert happened["rejected"] > 4
    assert happened["restarts"] > 0
    assert (happened["missed"] > 10) == (missed_detections == "used")


def test_predicted_belief_equals_the_filter_of_the_simulation():
    problem, rng = SCENARIO.problem(), np.random.default_rng(8)
    root = rng.normal(size=(3, 4, 4))
    mean, covariance, known = rng.normal(size=(3, 4)), root @ root.swapaxes(1, 2) + np.eye(4), rng.normal(size=(3, 2))
    predict = reference(problem)[0]
    for step in range(3):
        ours = predicted(NumpyBelief(mean, covariance=covariance), problem, known, step)
        for i in range(3):
            before = Belief(jnp.asarray(mean[i]), jnp.linalg.inv(covariance[i]))
            theirs = predict(before, jnp.asarray(known[i]), step)
            np.testing.assert_allclose(ours.mean[i], theirs.mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(ours.information[i], theirs.information, rtol=1e-9, atol=1e-9)
