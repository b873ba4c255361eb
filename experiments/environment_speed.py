"""Measure the steps per second of the vector environment, without the sampling of actions.

python experiments/environment_speed.py [--environments 1024] [--seconds 5]
"""

import argparse
import os
import time

import gymnasium
import numpy as np

import foveate.gym.envs


def main() -> None:
    """Step for some seconds with each kind of observation, under each protocol."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--environments", type=int, default=1024)
    options.add_argument("--seconds", type=float, default=5.0)
    given = options.parse_args()
    count, rng = given.environments, np.random.default_rng(0)
    for observation in ("flat", "dict"):
        for protocol in ("true", "surrogate"):
            envs = gymnasium.make_vec(
                foveate.gym.ID, num_envs=count, observation=observation, protocol=protocol, horizon="terminated"
            )
            envs.reset(seed=0)
            actions = rng.uniform(-1, 1, (32, count, 2)).astype(np.float32)
            for action in actions:
                envs.step(action)
            rounds, began = 0, time.perf_counter()
            while time.perf_counter() - began < given.seconds:
                for action in actions:
                    envs.step(action)
                rounds += len(actions)
            rate = rounds * count / (time.perf_counter() - began)
            print(
                f"{observation}, {protocol}: {rate:,.0f} steps/s, {count} environments, load {os.getloadavg()[0]:.1f}"
            )


if __name__ == "__main__":
    main()
