"""Every table of what names stand for has the keys of `foveate.names`."""

from typing import get_args

from foveate import names
from foveate.experiment import presets
from foveate.planning.named import heuristic_policy
from foveate.simulation.records import PROTOCOLS, Policy


def test_tables_have_these_keys():
    assert tuple(presets.PRESETS) == names.PRESET_NAMES
    assert tuple(presets.LEARNERS) == names.LEARNER_NAMES
    assert tuple(PROTOCOLS) == get_args(names.ProtocolName)
    assert ("policy", *names.HEURISTICS) == names.METHODS


def test_every_heuristic_can_be_made():
    problem = presets.PRESETS["paper"].scenario.problem()
    assert all(isinstance(heuristic_policy(name, problem, 2.0), Policy) for name in names.HEURISTICS)
