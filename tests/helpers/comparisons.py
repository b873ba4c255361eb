"""A comparison of made-up rows of a network of two training seeds, another method and the omniscient planner."""

import numpy as np

from foveate.evaluation.evaluate import Row
from foveate.study.comparison import Comparison, Part, compare

SCENES = 8
CELLS = (("unbiased", 3), ("biased", 5))
LOWEST = {("unbiased", 3): -1.0, ("biased", 5): -2.0}


def rows(method: str, scores: np.ndarray, protocol: str = "true", seconds: float = 1e-3) -> tuple[Row, ...]:
    """One row for each of `scores` (cell, scene)."""
    numbers = {"seen_fraction": 0.5, "seen_step_fraction": 0.25, "longest_unseen_s": 3.0, "entropy": 0.1}
    numbers |= {"rmse_m": 0.2, "nees": 2.0, "step_time_s": seconds, "episode": 0, "seed": 0}
    numbers |= {"rmse_seen_m": 0.1, "rmse_unseen_m": 0.4, "nees_seen": 1.5, "nees_unseen": 2.5}
    return tuple(
        Row(scene=f"{motion}-{n}-{i}", score=float(scores[c, i]), motion=motion, targets=n, method=method,
            protocol=protocol, **numbers)
        for c, (motion, n) in enumerate(CELLS)
        for i in range(scores.shape[1])
    )  # fmt: skip


RNG = np.random.default_rng(0)
BASE = RNG.normal(4.0, 2.0, (2, SCENES))
SEEDS = {0: BASE + 0.5, 10: BASE + RNG.normal(0, 0.3, (2, SCENES))}
OTHER = BASE + RNG.normal(1.0, 0.7, (2, SCENES))
ORACLE = np.full((2, SCENES), 9.0)


def made_up() -> Comparison:
    def part(method, family, scores, seed=None):
        return Part(method=method, family=family, training_seed=seed, protocol="true", rows=rows(method, scores))

    parts = [
        part("omniscient", "omniscient", ORACLE),
        *(part("net", "trained", scores, seed) for seed, scores in SEEDS.items()),
        part("other", "planned", OTHER),
    ]
    return compare(parts, "net", LOWEST, 2)
