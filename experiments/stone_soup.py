"""Compare foveate policies with Stone Soup's sensor managers in its simulation, on the same scenes and noise.

python experiments/stone_soup.py [--run RUN ..] [--targets 3 5 7] [--scenes 10] [--fine]

Scenes are the unbiased ones of table1, for 3 n steps: targets are random walks with the scenario's W, which all methods
know, and no drift. Stone Soup's managers evaluate a grid of the same commands (5 speeds, 7 turn rates; --fine: 9, 13)
and choose the one that shrinks the covariances most in one step (UncertaintyRewardFunction).
"""

import argparse
import datetime
import time
from pathlib import Path

import numpy as np
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.platform import Platform
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.sensormanager import BruteForceSensorManager, GreedySensorManager, RandomSensorManager
from stonesoup.sensormanager.reward import UncertaintyRewardFunction
from stonesoup.types.groundtruth import GroundTruthState
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, State
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

from foveate.experiment.checkpoint import load_run
from foveate.experiment.presets import PRESETS
from foveate.planning.named import heuristic_policy
from foveate.simulation.suites import table1
from foveate.stonesoup import BodyMovable, PolicySensorManager, ViewSensor

START = datetime.datetime(2026, 1, 1)
STONE_SOUP = {"brute force": BruteForceSensorManager, "greedy": GreedySensorManager, "random": RandomSensorManager}


class World:
    """One scene in Stone Soup: a platform, one track per target, true positions and the noise of every measurement."""

    def __init__(self, problem, scene, levels, steers=False):
        n, rng = len(scene.targets), np.random.default_rng([len(scene.targets), int(scene.id[-2:])])
        W, V, tau = (np.asarray(x, float) for x in (problem.motion.W, problem.sensor.V, problem.tau))
        self.interval, steps = datetime.timedelta(seconds=float(tau)), scene.horizon
        process_noise = rng.multivariate_normal(np.zeros(2), W, (steps, n))
        self.truth = np.array(scene.targets) + np.concatenate([np.zeros((1, n, 2)), np.cumsum(process_noise, axis=0)])
        self.noise = rng.multivariate_normal(np.zeros(2), V, (steps, n))
        first = self.truth[0] + rng.multivariate_normal(np.zeros(2), V, n)
        P = np.linalg.inv(np.asarray(problem.prior_information, float))
        states = [GaussianState(mean, P, timestamp=START) for mean in first]
        self.tracks = [Track([state], id=f"target {i}") for i, state in enumerate(states)]
        x, y, yaw = scene.agent
        self.body = BodyMovable(
            states=State([x, y], timestamp=START),
            position_mapping=(0, 1),
            orientation=np.array([[0.0], [0.0], [yaw]]),
            agent=problem.agent,
            levels=levels,
        )
        self.sensor = ViewSensor(
            ndim_state=2,
            position_mapping=(0, 1),
            noise_covar=V,
            view=problem.sensor.view,
            space=problem.agent.space,
            steers=steers,
        )
        self.platform = Platform(movement_controller=self.body, sensors=[self.sensor])
        model = LinearGaussianTimeInvariantTransitionModel(transition_matrix=np.eye(2), covariance_matrix=W)
        self.predictor, self.updater = KalmanPredictor(model), KalmanUpdater(None)
        self.end = START + steps * self.interval

    def run(self, manager):
        """Return log det of information and visibility for every step and target, and the time of each decision."""
        information, seen, times = [], [], []
        for k, truth in enumerate(self.truth[1:]):
            now = START + (k + 1) * self.interval
            began = time.perf_counter()
            (chosen,) = manager.choose_actions(set(self.tracks), now)
            times.append(time.perf_counter() - began)
            for actionable, actions in chosen.items():
                actionable.add_actions(actions)
                actionable.act(now)
            looks = zip(self.tracks, truth, self.noise[k], strict=True)
            seen.append([self._look(*look, now) for look in looks])
            information.append([-np.linalg.slogdet(track.covar)[1] for track in self.tracks])
        return np.array(information), np.array(seen), times

    def _look(self, track, truth, noise, now):
        """Predict a track, and update it if its target is in view."""
        prediction = self.predictor.predict(track.state, timestamp=now)
        state = GroundTruthState(truth, timestamp=now)
        detections = self.sensor.measure({state}, noise=noise[:, None])
        for detection in detections:
            prediction = self.updater.update(SingleHypothesis(prediction, detection))
        track.append(prediction)
        return bool(detections)


def manager_of(name, policies, world, problem):
    """Return the sensor manager of that name: a policy's, or one of Stone Soup's."""
    if name in policies:
        return PolicySensorManager(
            platforms={world.platform},
            policy=policies[name],
            predictor=world.predictor,
            end_time=world.end,
            trained_for=problem,
        )
    reward = UncertaintyRewardFunction(world.predictor, world.updater)
    # The greedy one rewards each actionable alone, and a platform, which measures nothing, would have no reward.
    alone = {"sensors": {world.sensor}} if name == "greedy" else {"platforms": {world.platform}}
    return STONE_SOUP[name](**alone, reward_function=reward)


def main() -> None:
    """Print a row for every method and number of targets."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--run", nargs="*", type=Path, default=[])
    options.add_argument("--targets", nargs="*", type=int, default=[3, 5, 7])
    options.add_argument("--scenes", type=int, default=10)
    options.add_argument("--fine", action="store_true")
    given = options.parse_args()
    problem = PRESETS["best"].scenario.problem()
    policies = {run.name: load_run(run)[1] for run in given.run}
    policies["uncertain"] = heuristic_policy("uncertain", problem, 2.0)
    print(f"| method | targets | log det at 1/3 | at 2/3 | at the end | ever seen | ms per decision |\n{'|---' * 7}|")
    for n in given.targets:
        scenes = [scene for scene in table1(problem) if scene.id.startswith(f"unbiased-{n}-")][: given.scenes]
        for name in [*policies, *STONE_SOUP]:
            np.random.seed(0)  # noqa: NPY002  # Stone Soup's random manager draws from the global generators
            found, ever, times = [], [], []
            for scene in scenes:
                world = World(problem, scene, (9, 13) if given.fine else (5, 7), steers=name == "greedy")
                information, seen, took = world.run(manager_of(name, policies, world, problem))
                found.append([information[len(information) * third // 3 - 1].mean() for third in (1, 2, 3)])
                ever.append(seen.any(axis=0).mean())
                times += took[1:]  # the first includes compilation
            numbers = " | ".join(f"{x:.2f}" for x in np.mean(found, axis=0))
            print(f"| {name} | {n} | {numbers} | {np.mean(ever):.0%} | {1000 * np.median(times):.1f} |", flush=True)


if __name__ == "__main__":
    main()
