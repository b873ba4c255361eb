"""Methods of a verdict: what evaluate takes by name, for one robot, a team and detections without ids."""

from dataclasses import replace
from pathlib import Path

import pytest

from foveate.evaluation.rivals import ASSIGNED, heuristics_of, policies_of
from foveate.experiment.presets import PRESETS
from foveate.experiment.resolve import experiment_from
from foveate.names import ASSIGNMENTS, HEURISTICS, SEARCHERS
from foveate.planning.named import heuristic_in
from foveate.policies.assigned import Assigned
from foveate.scenario.team import TeamSettings

WORLDS = Path(__file__).parents[2] / "benchmarks" / "worlds"
POLICY = heuristic_in(PRESETS["paper"].scenario, "nearest")


@pytest.mark.parametrize(
    ("world", "more", "policies"),
    [
        ("paper", (), 1),
        ("discover-sparse", SEARCHERS, 1),
        ("team-discover", SEARCHERS, 1),
        ("team-lossy", [f"{name}+{rule}" for name in ASSIGNED for rule in ASSIGNMENTS], 1 + len(ASSIGNMENTS)),
    ],
)
def test_methods_of_each_kind_of_world(world, more, policies):
    experiment = experiment_from(WORLDS / f"{world}.toml")
    assert set(heuristics_of(experiment)) == {*HEURISTICS, *more}
    found = policies_of(experiment, POLICY)
    assert len(found) == policies
    assert found.pop("policy") is POLICY
    assert all(isinstance(policy, Assigned) and name == f"policy+{policy.rule}" for name, policy in found.items())


def test_a_team_of_one_robot_has_no_assignment():
    experiment = PRESETS["paper"]
    alone = replace(experiment, scenario=replace(experiment.scenario, team=TeamSettings(agents=1)))
    assert set(heuristics_of(alone)) == set(HEURISTICS)
    assert set(policies_of(alone, POLICY)) == {"policy"}
