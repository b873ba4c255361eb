"""Compare the cost of training in space and in the plane: seconds per episode step, same batch, targets and network.

    python experiments/space_cost.py [--rounds 7]

The two are interleaved within one process, so that a shared machine slows both alike; the result is the ratio of their
medians.
"""

import argparse
import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS, TrainingSettings
from foveate.learning.loop import advance_of
from foveate.learning.policy_gradient import begin
from foveate.policies.attention import AttentionSettings

ITERATIONS = 20

DEEPER = AttentionSettings(agent_widths=(64,), target_widths=(64, 64, 64), out_widths=(64, 64), information="asinh")
"""One layer deeper and twice as wide, with information matrices as asinh."""


def timed(experiment: Experiment):
    """Return a function that trains for ITERATIONS iterations and returns the seconds per episode step."""
    scenes, training = experiment.scenario.scenes, experiment.training
    learner = begin(experiment.new_policy(jax.random.key(0)), training)
    advance = advance_of(experiment)
    steps = scenes.horizon(scenes.targets_max) * training.episodes

    def run() -> float:
        began = time.perf_counter()
        jax.block_until_ready(advance(jnp.array(ITERATIONS), learner, jax.random.key(1))[1].objective)
        return (time.perf_counter() - began) / ITERATIONS / steps

    run()  # compilation
    return run


def main() -> None:
    """Measure both and print the ratio, for each network."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="measurements of each, interleaved (default 7)")
    rounds = parser.parse_args().rounds
    training = TrainingSettings()  # the paper's: 60 episodes, one level, no noise
    networks = {"the paper's network": AttentionSettings(), "a deeper network": DEEPER}
    for name, network in networks.items():
        runs = [timed(replace(PRESETS[preset], policy=network, training=training)) for preset in ("paper", "quadrotor")]
        planar, spatial = np.median([[run() for run in runs] for _ in range(rounds)], axis=0)
        print(
            f"{name}, {training.episodes} episodes of 3 to 8 targets: "
            f"plane {planar * 1e6:.2f} us, space {spatial * 1e6:.2f} us per episode step: ratio {spatial / planar:.2f}"
        )


if __name__ == "__main__":
    main()
