"""Measure how a training step's time grows with targets, steps and episodes, and the memory of a long horizon.

    python experiments/growth.py [--out experiments/growth] [--repeats 3]

Writes growth.json and growth.png. Slopes are fitted to logarithms, over the sizes whose work exceeds the fixed cost of
a step; 1 is linear. The policy, its learner and everything else are the paper's.
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
import numpy as np

from foveate.learning.devices import use_cores

use_cores()

from foveate.bench.timing import in_turn, peak_memory_mib
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.io.figures import BLUE, GREY, LEGEND, TITLE, WIDTH, new_figure, save, tidy
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
FIT_FROM_S = 0.002
"""Steps shorter than this are mostly fixed cost, and are left out of the fit."""


def experiment_of(targets: int, steps: int, episodes: int) -> Experiment:
    """Return the paper's experiment at this size.

    The box grows with the targets, at the density of five targets in the paper's; long horizons are rematerialised in
    segments.
    """
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
    """Median time of a compiled training step [s]."""
    experiment = experiment_of(**size)
    learner = begin(experiment.new_policy(jax.random.key(0)), experiment.training)
    program = advance_of(experiment)
    count = max(1, 4096 // (size["targets"] * size["steps"] * size["episodes"] // 128 + 1))
    return float(np.median(in_turn([lambda: program(jnp.array(count), learner, jax.random.key(1))], repeats))) / count


def slope(sizes: np.ndarray, seconds: np.ndarray) -> float:
    """Slope of the line through the logarithms of the steps that take longer than FIT_FROM_S."""
    long_enough = seconds > FIT_FROM_S
    return float(np.polyfit(np.log(sizes[long_enough]), np.log(seconds[long_enough]), 1)[0])


def long_horizon() -> dict[str, float]:
    """Memory and time of a training step over a long horizon, measured in a process of its own."""
    seconds = seconds_of(LONG, 1)
    return {**LONG, "seconds": seconds, "peak_memory_mib": peak_memory_mib()}


def plot(growth: dict[str, dict], path: Path) -> None:
    """Plot the seconds of a training step over each size, with the fitted slopes."""
    figure = new_figure(WIDTH, 3.2)
    axes = figure.subplots(1, 3, sharey=True)
    for axis, (name, numbers) in zip(axes, growth.items(), strict=True):
        sizes, seconds = np.array(numbers["sizes"], float), np.array(numbers["seconds"])
        axis.loglog(sizes, seconds, "o-", color=BLUE, lw=1.5, ms=4.5, label="measured")
        axis.loglog(sizes, seconds[-1] * sizes / sizes[-1], ":", color=GREY, lw=1.4, label="linear")
        tidy(axis, name)
        others = ", ".join(f"{value} {other}" for other, value in FIXED.items() if other != name)
        axis.set_title(f"{others}: slope {numbers['slope']:.2f}", **TITLE)
    axes[0].set_ylabel("training step [s]", fontsize=9.5)
    figure.legend(*axes[0].get_legend_handles_labels(), ncols=2, fontsize=9, **LEGEND)
    save(figure, path)


def main() -> None:
    """Measure the steps, fit the slopes, write both files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("experiments/growth"), help="folder to write to")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--long", action="store_true", help="only the long horizon, as JSON on standard output")
    given = parser.parse_args()
    if given.long:
        print(json.dumps(long_horizon()))
        return
    given.out.mkdir(parents=True, exist_ok=True)
    growth = {}
    for name, sizes in SIZES.items():
        seconds = []
        for size in sizes:
            seconds.append(seconds_of({**FIXED, name: size}, given.repeats))
            print(f"{size:6d} {name}: {seconds[-1]:.4f} s, load {os.getloadavg()[0]:.1f}", flush=True)
        growth[name] = {"sizes": sizes, "seconds": seconds, "slope": slope(np.array(sizes), np.array(seconds))}
        print(f"{name}: slope {growth[name]['slope']:.2f}")
    command = [sys.executable, __file__, "--long"]
    long = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    print(f"{LONG}: {long['seconds']:.1f} s per step, peak {long['peak_memory_mib']:.0f} MiB")
    text = json.dumps({"fixed": FIXED, "growth": growth, "long_horizon": long}, indent=1)
    (given.out / "growth.json").write_text(text + "\n")
    plot(growth, given.out / "growth.png")


if __name__ == "__main__":
    main()
