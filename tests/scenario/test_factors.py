"""A factor of robustness changes the model as its formula says, and nothing else."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from foveate.scenario.factors import FACTORS
from foveate.scenario.scenario import Scenario

BY_NAME = {factor.name: factor for factor in FACTORS}


def leaves(scenario):
    return {jax.tree_util.keystr(path): np.asarray(leaf)
            for path, leaf in jax.tree_util.tree_leaves_with_path(scenario.problem())}  # fmt: skip


CHANGED = {
    "W": (".motion.W", lambda v: v**2 * np.eye(2)),
    "V": (".sensor.V", lambda v: v**2 * np.eye(2)),
    "depth": (".sensor.view.vertices", lambda v: v * np.array([[0, 0], [1, -np.sqrt(3)], [1, np.sqrt(3)]])),
    "angle": (
        ".sensor.view.vertices",
        lambda v: 2 * np.array([[0, 0], [1, -np.tan(np.radians(v / 2))], [1, np.tan(np.radians(v / 2))]]),
    ),
    "speed": (".agent.upper", lambda v: np.array([v, np.pi / 3])),
    "turn": (".agent.upper", lambda v: np.array([4.0, np.radians(v)])),
    "drift": (None, None),
    "targets": (None, None),
}


@pytest.mark.parametrize("name", BY_NAME)
def test_a_factor_changes_only_its_own_quantity(name):
    factor, plain = BY_NAME[name], leaves(Scenario())
    where, expected = CHANGED[name]
    for value in factor.values:
        scenario = factor.change(Scenario(), value)
        found = leaves(scenario)
        for place, leaf in plain.items():
            if place == where:
                np.testing.assert_allclose(found[place], expected(value), atol=1e-9)
            elif not (name == "turn" and place == ".agent.lower"):  # a turn rate has two limits
                np.testing.assert_array_equal(found[place], leaf)
        scenes = {
            "drift": {"drift_m_s": (value, value)},
            "targets": dict.fromkeys(("targets_min", "targets_max"), int(value)),
        }
        assert scenario.scenes == replace(Scenario().scenes, **scenes.get(name, {}))
    if name != "targets":
        assert factor.change(Scenario(), factor.nominal).problem().tau == 1.0
        assert factor.trained == (factor.nominal, factor.nominal)
        np.testing.assert_allclose(
            np.concatenate([leaf.ravel() for leaf in leaves(factor.change(Scenario(), factor.nominal)).values()]),
            np.concatenate([leaf.ravel() for leaf in plain.values()]),
            atol=1e-9,
        )
