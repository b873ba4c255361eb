"""How the time of a training step grows with targets, steps and episodes; and the memory of a long horizon.

    python experiments/growth.py [--out experiments/growth] [--repeats 3]

Writes growth.json and growth.png. Slopes are fitted to logarithms, from where the work is more than the fixed cost of
a step: 1 is linear. The policy, its learner and everything else are the paper's.
"""

import argparse
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from foveate.learning.devices import use_cores

use_cores()

from foveate.bench.timing import in_turn, peak_memory_mib
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.learning.loop import advance_of
from foveate.learning.policy_gradient import begin

SIZES = {
    "targets": (4, 16, 64, 256, 1024, 4096),
    "steps": (8, 32, 128, 512, 2048, 4096),
    "episodes": (16, 64, 256, 1024, 4096, 16384, 65536),
}
FIXED = {"targets": 4, "steps": 8, "episodes": 16}
LONG = {"targets": 8, "steps": 4096, "episodes": 64}
PER_TARGET_M = 2.0
LEAST_S = 0.002
"""Below this a step is mostly what it costs whatever its size, and is left out of the fit."""


def experiment_of(targets: int, steps: int, episodes: int) -> Experiment:
    """The paper's, with so many targets in a box that holds five of its targets to the same area, and segments."""
    paper = PRESETS["paper"]
    scenes = replace(
        paper.scenario.scenes,
        targets_min=targets,
        targets_max=targets,
        steps=steps,
        half_side_m=(PER_TARGET_M * np.sqrt(5 * targets),) * 2,
        half_side_per_target_m=0.0,
    )
    segment = None if steps < 64 else round(np.sqrt(steps))
    training = replace(paper.training, episodes=episodes, segment=segment)
    return replace(paper, scenario=replace(paper.scenario, scenes=scenes), training=training)


def seconds_of(size: dict[str, int], repeats: int) -> float:
    """The median time of a step of training [s], compiled."""
    experiment = experiment_of(**size)
    problem = experiment.scenario.problem()
    learner = begin(experiment.policy.policy(problem, jax.random.key(0)), experiment.training)
    program = advance_of(experiment, problem)
    count = max(1, 4096 // (size["targets"] * size["steps"] * size["episodes"] // 128 + 1))
    return float(np.median(in_turn([lambda: program(jnp.array(count), learner, jax.random.key(1))], repeats))) / count


def slope(sizes: np.ndarray, seconds: np.ndarray) -> float:
    """Of the line through the logarithms, where a step takes longer than LEAST_S."""
    counts = seconds > LEAST_S
    return float(np.polyfit(np.log(sizes[counts]), np.log(seconds[counts]), 1)[0])


def long_horizon() -> dict[str, float]:
    """Memory and time of a step of training over a long horizon, in this process, which does nothing else."""
    seconds = seconds_of(LONG, 1)
    return {**LONG, "seconds": seconds, "peak_memory_mib": peak_memory_mib()}


def draw(found: dict[str, dict], path: Path) -> None:
    """Seconds a step over each size, with the fitted slopes."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), sharey=True, layout="constrained")
    for axis, (name, numbers) in zip(axes, found.items(), strict=True):
        sizes, seconds = np.array(numbers["sizes"], float), np.array(numbers["seconds"])
        axis.loglog(sizes, seconds, "o-", color="tab:blue", label=f"measured: slope {numbers['slope']:.2f}")
        axis.loglog(sizes, seconds[-1] * sizes / sizes[-1], ":", color="0.5", label="linear")
        others = ", ".join(f"{value} {other}" for other, value in FIXED.items() if other != name)
        axis.set(xlabel=name, title=others)
        axis.grid(alpha=0.3)
        axis.legend(frameon=False)
    axes[0].set_ylabel("a training step [s]")
    figure.savefig(path, dpi=130)


def main() -> None:
    """Measure, fit, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("experiments/growth"), help="folder to write to")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--long", action="store_true", help="only the long horizon, as JSON on standard output")
    given = parser.parse_args()
    if given.long:
        print(json.dumps(long_horizon()))
        return
    given.out.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, sizes in SIZES.items():
        seconds = []
        for size in sizes:
            seconds.append(seconds_of({**FIXED, name: size}, given.repeats))
            print(f"{size:6d} {name}: {seconds[-1]:.4f} s, load {os.getloadavg()[0]:.1f}", flush=True)
        found[name] = {"sizes": sizes, "seconds": seconds, "slope": slope(np.array(sizes), np.array(seconds))}
        print(f"{name}: slope {found[name]['slope']:.2f}")
    command = [sys.executable, __file__, "--long"]
    long = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    print(f"{LONG}: {long['seconds']:.1f} s a step, peak {long['peak_memory_mib']:.0f} MiB")
    text = json.dumps({"fixed": FIXED, "growth": found, "long_horizon": long}, indent=1)
    (given.out / "growth.json").write_text(text + "\n")
    draw(found, given.out / "growth.png")


if __name__ == "__main__":
    main()
