"""Measure the heuristics in a world of detections without ids: GOSPA, its parts, and the time of a decision.

python experiments/discover.py [WORLD ..] --scenes 1000 [--run RUN]

WORLD is the name of a file of benchmarks/worlds; default: regions.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from foveate.evaluation.evaluate import evaluate, prepare
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import load
from foveate.io.toml import load_toml
from foveate.planning.named import heuristic_in
from foveate.scenario.scenario import Scenario
from foveate.simulation.suites import SUITE_SEED, Cell, suite

WORLDS = Path(__file__).parents[1] / "benchmarks" / "worlds"
METHODS = ("lookahead", "explore", "alternate", "price", "window", "post", "lawnmower", "random", "still")


def main() -> None:
    """Print the methods of every world."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("world", nargs="*", default=["regions"])
    options.add_argument("--scenes", type=int, default=1000)
    options.add_argument("--method", nargs="+", default=METHODS)
    options.add_argument("--run", help="run folder of a policy that was trained there")
    given = options.parse_args()
    for world in given.world:
        print(world, flush=True)
        measure(load_toml(Experiment, WORLDS / f"{world}.toml").scenario, given.scenes, given.method, given.run)


def measure(scenario: Scenario, count: int, methods: Sequence[str], run: str | None) -> None:
    """Print a line a method; differences to the first are of the same scenes with the same noise."""
    problem, settings = scenario.problem(), scenario.scenes
    cells = [Cell(n, True) for n in range(settings.targets_min, settings.targets_max + 1)]
    scenes = suite(settings, problem, SUITE_SEED, cells, -(-count // len(cells)))
    prepared, first = prepare(problem, settings, scenes), None
    policies = {name: heuristic_in(scenario, name) for name in methods}
    if run:
        policies["policy"] = load(run)[1]
    for name, policy in policies.items():
        rows = evaluate(prepared, name, policy, ("true",))
        parts = ("gospa", "gospa_localisation", "gospa_missed", "gospa_false", "dropped")
        found = np.array([[getattr(row, part) for part in parts] for row in rows])
        first = found if first is None else first
        worse = found[:, 0] - first[:, 0]
        line = " ".join(f"{part} {mean:.1f}" for part, mean in zip(parts, found.mean(axis=0), strict=True))
        errors = [values.std(ddof=1) / len(rows) ** 0.5 for values in (found[:, 0], worse)]
        lead = f"worse than {methods[0]} by {worse.mean():.1f} +- {errors[1]:.2f}"
        print(f"{name}: {line} (+- {errors[0]:.2f}); {lead}; {1e3 * rows[0].step_time_s:.2f} ms a decision", flush=True)


if __name__ == "__main__":
    main()
