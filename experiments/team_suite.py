"""Measure policies with assigned targets in the suite's teams, beside heuristics with assigned targets.

    python experiments/team_suite.py [WORLD ..] [--policy RUN] [--agents M] [--silent] [--scenes 90] [--seed 2023]

The policies are the presets `any` and, among rooms, `rooms`, trained in none of these teams: a network trained for one
robot, of which each robot is shown its own targets only; or that of RUN. The score is the objective of the
world, by all measurements; leads are paired, over the best heuristic with assigned targets. `--agents` has another
number of robots, and with `--silent` no message arrives.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from foveate.evaluation.evaluate import evaluate, prepare
from foveate.experiment.resolve import experiment_from, subject_of
from foveate.names import ASSIGNMENTS
from foveate.scenario.scenario import Scenario
from foveate.scenario.team import RadioSettings
from foveate.simulation.suites import SUITE_SEED, Cell, suite

FOLDER = Path(__file__).parents[1] / "benchmarks" / "worlds"
PRESET_OF = {"team-patrol": "any", "team-tracking": "any", "team-lossy": "any", "team-rooms": "rooms"}
HEURISTICS = ("uncertain", "price", "window", "nearest")


def main() -> None:
    """Print the methods of every world."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("world", nargs="*", default=list(PRESET_OF))
    options.add_argument("--policy")
    options.add_argument("--agents", type=int)
    options.add_argument("--silent", action="store_true")
    options.add_argument("--scenes", type=int, default=90)
    options.add_argument("--seed", type=int, default=SUITE_SEED)
    given = options.parse_args()
    for world in given.world:
        print(world, flush=True)
        scenario = changed(experiment_from(FOLDER / f"{world}.toml").scenario, given.agents, given.silent)
        measure(given.policy or PRESET_OF[world], scenario, given.scenes, given.seed)


def changed(scenario: Scenario, agents: int | None, silent: bool) -> Scenario:
    """The scenario with another number of robots, and without a radio."""
    assert scenario.team is not None, "of a team's world"
    team = replace(scenario.team, agents=agents or scenario.team.agents)
    return replace(scenario, team=replace(team, radio=RadioSettings(loss=1.0)) if silent else team)


def measure(policy: str, scenario: Scenario, count: int, seed: int) -> None:
    """Print a line a method: of the policies the lead over the best heuristic in the same scenes."""
    subject, problem, settings = subject_of(policy, scenario), scenario.problem(), scenario.scenes
    cells = [Cell(n, True) for n in range(settings.targets_min, settings.targets_max + 1)]
    scenes = suite(settings, problem, seed, cells, -(-count // len(cells)))
    prepared = prepare(problem, settings, scenes, objective=subject.objective)

    def scores(method: str) -> np.ndarray:
        found = np.array([row.objective for row in evaluate(prepared, method, subject.policy(method), ("true",))])
        print(f"{method}: {found.mean():.2f} +- {found.std(ddof=1) / len(found) ** 0.5:.2f}", flush=True)
        return found

    assigned = {f"{name}+{rule}": scores(f"{name}+{rule}") for name in HEURISTICS for rule in ASSIGNMENTS}
    best = max(assigned, key=lambda method: assigned[method].mean())
    for method in ("policy", *(f"policy+{rule}" for rule in ASSIGNMENTS)):
        lead = scores(method) - assigned[best]
        print(f"    leads {best} by {lead.mean():.2f} +- {lead.std(ddof=1) / len(lead) ** 0.5:.2f}", flush=True)


if __name__ == "__main__":
    main()
