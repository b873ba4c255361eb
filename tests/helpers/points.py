"""Scores of two methods under a factor of two values that no evaluation made, for the tests of a study's tables."""

import numpy as np

from foveate.scenario.factors import Factor
from foveate.study.robustness import Point

DOUBLING = Factor(name="f", label="f", values=(1.0, 2.0), trained=(1.0, 1.0), change=lambda scenario, value: scenario)
SCORES = np.random.default_rng(0).normal(3.0, 1.0, (2, 2, 12))
"""Of two training seeds, two values, twelve scenes."""


def random_points() -> list[Point]:
    def point(method, seed, value, scores):
        scores = tuple(float(score) for score in scores)
        return Point(factor="f", value=value, method=method, training_seed=seed, lower_bound=-1.0, scores=scores,
                     seen=(0.5,) * 12)  # fmt: skip

    net = [
        point("net", seed, value, SCORES[s, v]) for s, seed in enumerate((0, 10)) for v, value in ((0, 1.0), (1, 2.0))
    ]
    return [*net, point("omniscient", None, 1.0, [9.0] * 12), point("omniscient", None, 2.0, [7.0] * 12)]
