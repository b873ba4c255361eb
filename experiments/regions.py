"""Measure the heuristics in benchmarks/worlds/regions.toml: GOSPA, its parts, and the time of a decision.

python experiments/regions.py --scenes 1000 [--run RUN]
"""

import argparse
from pathlib import Path

import numpy as np

from foveate.evaluation.evaluate import evaluate, prepare
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import load
from foveate.io.toml import load_toml
from foveate.planning.named import heuristic_in
from foveate.simulation.suites import SUITE_SEED, Cell, suite

WORLD = Path(__file__).parents[1] / "benchmarks" / "worlds" / "regions.toml"
METHODS = ("lookahead", "explore", "alternate", "random", "still", "lawnmower")


def main() -> None:
    """Print a line a method; differences to the first are of the same scenes with the same noise."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--scenes", type=int, default=1000)
    options.add_argument("--method", nargs="+", default=METHODS)
    options.add_argument("--run", help="run folder of a policy that was trained there")
    given = options.parse_args()

    scenario = load_toml(Experiment, WORLD).scenario
    problem = scenario.problem()
    scenes = suite(scenario.scenes, problem, SUITE_SEED, [Cell(1, True)], given.scenes)
    prepared, first = prepare(problem, scenario.scenes, scenes), None
    policies = {name: heuristic_in(scenario, name) for name in given.method}
    if given.run:
        policies["policy"] = load(given.run)[1]
    for name, policy in policies.items():
        rows = evaluate(prepared, name, policy, ("true",))
        parts = ("gospa", "gospa_localisation", "gospa_missed", "gospa_false", "dropped")
        found = np.array([[getattr(row, part) for part in parts] for row in rows])
        first = found if first is None else first
        worse = found[:, 0] - first[:, 0]
        line = " ".join(f"{part} {mean:.1f}" for part, mean in zip(parts, found.mean(axis=0), strict=True))
        errors = [values.std(ddof=1) / len(rows) ** 0.5 for values in (found[:, 0], worse)]
        lead = f"worse than {given.method[0]} by {worse.mean():.1f} +- {errors[1]:.2f}"
        print(f"{name}: {line} (+- {errors[0]:.2f}); {lead}; {1e3 * rows[0].step_time_s:.2f} ms a decision")


if __name__ == "__main__":
    main()
