"""Measure planners in a team: in turn, and with assigned targets, beside heuristics with assigned targets.

    python experiments/team_planners.py [--robots 3] [--targets 6] [--scenes 24]

The world is the paper's, with several robots and a radio by which every message arrives. The score is the objective of
`benchmarks/worlds/paper.toml`, by real measurements; differences are paired, with the first method.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from foveate.evaluation.evaluate import evaluate, prepare
from foveate.evaluation.plan import PlanOptions
from foveate.experiment.experiment import Experiment
from foveate.io.toml import load_toml
from foveate.planning.named import assigned_in, heuristic_in
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.suites import SUITE_SEED, Cell, suite

WORLD = Path(__file__).parents[1] / "benchmarks" / "worlds" / "paper.toml"
METHODS = ("price+hungarian", "window+hungarian", "uncertain+greedy", "icr-4", "icr-4+hungarian", "icr-16")
STEPS = 24


def main() -> None:
    """Print a line a method."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--robots", type=int, default=3)
    options.add_argument("--targets", type=int, default=6)
    options.add_argument("--scenes", type=int, default=24)
    options.add_argument("--method", nargs="+", default=METHODS)
    given = options.parse_args()
    experiment = load_toml(Experiment, WORLD)
    scenario = replace(experiment.scenario, team=TeamSettings(agents=given.robots, radio=RadioSettings()))
    scenes = suite(scenario.scenes, scenario.problem(), SUITE_SEED, [Cell(given.targets, True)], given.scenes)
    prepared = prepare(scenario.problem(), scenario.scenes, scenes, objective=experiment.training.objective)
    first = None
    for method in given.method:
        name, _, rule = method.partition("+")
        kind, _, starts = name.partition("-")
        if kind == "icr":
            policy = PlanOptions(starts=int(starts)).planner(scenario.problem(), "true", None, STEPS)
        else:
            policy = heuristic_in(scenario, name)
        rows = evaluate(prepared, method, assigned_in(scenario, policy, rule) if rule else policy, ("true",))
        found = np.array([row.objective for row in rows])
        first = found if first is None else first
        more, root = found - first, len(found) ** 0.5
        errors = found.std(ddof=1) / root, more.std(ddof=1) / root
        line = f"{found.mean():.2f} +- {errors[0]:.2f}; {more.mean():+.2f} +- {errors[1]:.2f} beside {given.method[0]}"
        print(f"{method}: {line}; {1e3 * rows[0].step_time_s:.1f} ms a decision", flush=True)


if __name__ == "__main__":
    main()
