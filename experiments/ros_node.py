"""Processor time of the ROS node beyond its policy, with eight targets: a decision, and a message of detections.

python experiments/ros_node.py
"""

import time
from typing import Any

import numpy as np

from foveate.experiment.presets import PRESETS
from foveate.recordings.definitions import typestore
from foveate.ros.core import Core, CoreSettings
from foveate.ros.messages import Messages, detections_of_vision, odometry_of
from foveate.ros.model import RobotModel
from foveate.ros.records import Detections, Odometry

TARGETS, ROUNDS = 8, 400


def core_of(preset: str) -> Core:
    scenario = PRESETS[preset].scenario
    problem = scenario.problem()
    axes = tuple(problem.agent.space.axes[axis] for axis in problem.agent.axes)
    command = np.zeros(len(axes))
    return Core(RobotModel(name=preset, scenario=scenario, axes=axes, decide=lambda *_: command), CoreSettings())


def main() -> None:
    find: Any = typestore("ros2_humble").types.__getitem__
    make, rng = Messages(find=find), np.random.default_rng(0)
    for preset in ("paper", "pan", "quadrotor"):
        core, spent = core_of(preset), {"detections": [], "decision": []}
        for k in range(ROUNDS):
            now_s = 100.0 + 0.05 * k
            record = Odometry(now_s, "odom", "base_link", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            odometry = make.odometry(record, (0.0,) * 6)
            places = rng.normal(0, 0.05, (TARGETS, 3)) + np.arange(TARGETS)[:, None]
            points = {f"t{i}": tuple(place) for i, place in enumerate(places.tolist())}
            found = make.detections(Detections(now_s - 0.02, "base_link", points))
            began = time.process_time()
            core.on_odometry(odometry_of(odometry))
            core.on_detections(detections_of_vision(found)[0], now_s)
            middle = time.process_time()
            decision = core.decide(now_s)
            make.twist(decision.twist)
            spent["detections"].append(middle - began)
            spent["decision"].append(time.process_time() - middle)
        assert not decision.stopped, decision.stopped
        assert len(decision.estimates) == TARGETS
        for name, times in spent.items():
            print(f"{name:<11} {preset:<10} {1e6 * np.median(times[ROUNDS // 4 :]):6.0f} us")


if __name__ == "__main__":
    main()
