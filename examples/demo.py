"""Train the paper's policy, and show it and the shipped policy true-view on the same scenes, in a table and a figure.

    make demo            (or: python examples/demo.py)

Writes config, checkpoint, metrics, tables and pictures to runs/demo/.
"""

import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

# Every core is a separate device: the programs of a training are too small to run on two cores at once. JAX reads this
# on import.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", str(os.cpu_count() or 1))

import foveate

OUT = Path("runs/demo")
SEED = 10
SHOWN = ("biased-3-00", "biased-7-00")
"""Scenes of the table to draw."""
PAPER = {
    ("unbiased", 3): (4.57, 6.71),
    ("unbiased", 5): (3.65, 6.56),
    ("unbiased", 7): (1.94, 5.41),
    ("biased", 3): (4.23, 6.87),
    ("biased", 5): (3.27, 5.96),
    ("biased", 7): (2.01, 4.92),
}
"""Means in the paper's table: PPO, and the paper's method."""
HEADER = """
Score per target [nat], means of 30 scenes. surrogate: the paper's, which credits targets near the view. true: of a
Kalman filter that only real detections inform. detected: targets detected at least once. drift: biased has one.

                   printed in the paper         its method, trained here          true-view, shipped
drift    targets    PPO     surrogate      surrogate    true    detected      true    detected"""


def main(epochs: int | None = None) -> None:
    """Train, evaluate, draw, and print the time it took; `epochs` shortens the training."""
    began = time.perf_counter()
    shutil.rmtree(OUT, ignore_errors=True)
    shipped = foveate.load("true-view")
    with ThreadPoolExecutor() as pool:
        # Beside the training, half of which is the work of one core: it is compiled.
        evaluated = pool.submit(foveate.evaluate, shipped, "table1", protocol="true", progress=False)
        # The median of the paper's seeds 0, 10 and 100; no verdict, since the paper's table has no heuristics.
        trained = foveate.train("paper", epochs=epochs, seed=SEED, out=OUT, verdict=False)
    trained, theirs = replace(trained, name="the paper's method"), evaluated.result()
    print(f"trained in {time.perf_counter() - began:.0f} s, compilation included: {trained}")

    ours = foveate.evaluate(trained, "table1")
    ours.to_json(OUT / "paper.json")
    theirs.to_json(OUT / "true-view.json")
    print_table(ours, theirs)

    # A scene's noise depends on its id, so these episodes are those of the table.
    scenes = [scene for scene in ours.scenes if scene.id in SHOWN]
    suite = foveate.prepare(trained.problem, trained.scenario.scenes, scenes)
    episodes = [foveate.suite_data(suite, policy.network, "true", policy.name) for policy in (trained, shipped)]
    foveate.trajectory_figure([row for pair in zip(*episodes, strict=True) for row in pair], OUT / "trajectories.png")
    foveate.learning_curve(OUT, OUT / "learning_curve.png")
    print(f"{OUT}: paper.json, true-view.json, trajectories.png, learning_curve.png")
    print(f"done in {time.perf_counter() - began:.0f} s; next, live in the browser:  foveate view true-view")


def print_table(ours: foveate.Evaluation, theirs: foveate.Evaluation) -> None:
    """Print the policy trained here, by both scores, beside the paper's numbers and the shipped policy."""
    cells = {(cell.protocol, cell.motion, cell.targets): cell for cell in ours.summary}
    others = {(cell.motion, cell.targets): cell for cell in theirs.summary}
    print(HEADER)
    for (motion, targets), (model_free, model_based) in PAPER.items():
        surrogate, true = (cells[protocol, motion, targets] for protocol in ("surrogate", "true"))
        other = others[motion, targets]
        print(
            f"{motion:9}{targets:>7}{model_free:>7.2f}{model_based:>14.2f}"
            f"{surrogate.mean:>15.2f}{true.mean:>8.2f}{true.seen_fraction:>12.0%}"
            f"{other.mean:>10.2f}{other.seen_fraction:>12.0%}"
        )
    print()


if __name__ == "__main__":
    main()
