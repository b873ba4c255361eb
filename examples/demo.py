"""Train the paper's policy, evaluate it on the paper's test distribution, and draw it.

    make demo            (or: python examples/demo.py)

Writes config, checkpoint, metrics, table and pictures to runs/demo/.
"""

import os
import shutil
import time
from pathlib import Path

# Every core is a separate device: the programs of a training are too small to run on two cores at once. JAX reads this
# on import.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", str(os.cpu_count() or 1))

import foveate

OUT = Path("runs/demo")
SHOWN = ("biased-3-00", "biased-5-00", "biased-7-00")
"""Scenes of the paper's table to draw."""
PAPER = {
    ("unbiased", 3): ("4.57 ± 2.13", "6.71 ± 1.47"),
    ("unbiased", 5): ("3.65 ± 1.54", "6.56 ± 0.55"),
    ("unbiased", 7): ("1.94 ± 1.70", "5.41 ± 0.85"),
    ("biased", 3): ("4.23 ± 1.77", "6.87 ± 1.21"),
    ("biased", 5): ("3.27 ± 1.30", "5.96 ± 0.96"),
    ("biased", 7): ("2.01 ± 1.67", "4.92 ± 1.07"),
}
"""Table of the paper: PPO and the model-based method, mean and standard deviation."""


def main(epochs: int | None = None) -> None:
    """Train, evaluate, draw, and print the time it took; `epochs` shortens the training."""
    began = time.perf_counter()
    shutil.rmtree(OUT, ignore_errors=True)
    policy = foveate.train("paper", epochs=epochs, out=OUT)
    print(f"trained in {time.perf_counter() - began:.0f} s, compilation included: {policy}")

    found = foveate.evaluate(policy, "table1")
    found.to_json(OUT / "table1.json")
    print_table(found)

    # This policy was trained for the surrogate score, as in the paper. A scene's noise depends on its id, so it is the
    # same as in the table.
    scenes = [scene for scene in found.scenes if scene.id in SHOWN]
    suite = foveate.prepare(policy.problem, policy.scenario.scenes, scenes)
    episodes = foveate.suite_data(suite, policy.network, "surrogate", "paper")
    foveate.trajectory_figure(episodes, OUT / "trajectories.png")
    foveate.animate(episodes[1], OUT / "episode.gif")
    foveate.learning_curve(OUT, OUT / "learning_curve.png")
    print(f"{OUT}: table1.json, trajectories.png, learning_curve.png, episode.gif")
    print(f"done in {time.perf_counter() - began:.0f} s")


def print_table(found: foveate.Evaluation) -> None:
    """Print our two scores beside those of the paper."""
    cells = {(cell.protocol, cell.motion, cell.targets): cell for cell in found.summary}
    print(
        "\nScore per target [nat], 30 scenes a cell: the paper's surrogate score, and the true one of a Kalman filter"
    )
    print("motion   targets    paper: PPO  paper: model    surrogate         true  targets seen")
    for (motion, targets), (model_free, model_based) in PAPER.items():
        surrogate, true = (cells[protocol, motion, targets] for protocol in ("surrogate", "true"))
        ours = [f"{cell.mean:.2f} ± {cell.std:.2f}" for cell in (surrogate, true)]
        numbers = "".join(f"{text:>13}" for text in (model_free, model_based, *ours))
        print(f"{motion:10}{targets:>6}{numbers}{true.seen_fraction:>12.0%}")
    print()


if __name__ == "__main__":
    main()
