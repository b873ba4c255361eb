"""Draw two methods in the same scenes, with the shipped policies: the pictures of trajectories beside the tables.

    python experiments/duels.py experiments

Redraws table1/trajectories-surrogate.png, table1/trajectories-true.png and true-view/trajectories-true.png there, each
with the first drifting scene of 3, 5 and 7 targets.
"""

import sys
from pathlib import Path

import foveate
from foveate.study.comparison_figures import duel_figure

FIGURES = {
    "table1/trajectories-surrogate.png": ("surrogate", "best", "paper"),
    "table1/trajectories-true.png": ("true", "best", "paper"),
    "true-view/trajectories-true.png": ("true", "true-view", "uncertain"),
}
"""Protocol and two methods of each figure."""


def main(folder: Path) -> None:
    """Simulate and draw all of them."""
    shipped = foveate.load("paper")
    scenes = [
        scene
        for scene in foveate.table1(shipped.problem)
        if scene.id.startswith("biased-") and scene.id.endswith("-00")
    ]
    suite = foveate.prepare(shipped.problem, shipped.scenario.scenes, scenes)
    for name, (protocol, *methods) in FIGURES.items():
        episodes = []
        for method in methods:
            loaded = foveate.heuristic(method, shipped.scenario) if method == "uncertain" else foveate.load(method)
            episodes.append(foveate.suite_data(suite, loaded.network, protocol, method))
        duel_figure((methods[0], methods[1]), list(zip(*episodes, strict=True)), folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
