"""Measures of the robots of a team, from arrays made by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.evaluation.team import team_measures
from foveate.scenario.scenes import Scene
from foveate.simulation.team.records import TeamTrace

SCENE = Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((0.0, 0.0), (1.0, 1.0)), horizon=2)


def trace():
    """One episode of two robots, two targets and two steps, padded to three of each."""
    log_det = np.full((1, 3, 2, 3), -99.0)
    log_det[0, :2, :, :2] = [[[1.0, 3.0], [8.0, 8.0]], [[5.0, 7.0], [2.0, 4.0]]]
    visible = np.zeros((1, 3, 2, 3), bool)
    visible[0, :2, 0, 0] = True
    visible[0, 2] = True
    nees = np.full((1, 3, 2, 3), 99.0)
    nees[0, 1, :, :2] = [[1.0, 2.0], [3.0, 4.0]]
    unused = np.zeros((1, 4, 2, 3)), np.zeros((1, 3, 2, 2))
    parts = (*unused, log_det, nees, visible, np.zeros((1, 3, 2, 2), bool))
    return jax.vmap(TeamTrace)(*map(jnp.asarray, parts))


@pytest.mark.parametrize(
    ("objective", "worst"), [(None, None), ("terminal", 3.0), ("mean", 4.0), ("seen", 0.0)], ids=str
)
def test_the_worst_robot_and_the_mean_of_all(objective, worst):
    (row,) = team_measures(trace(), [SCENE], objective)
    assert row == {"agents": 2, "worst_score": 3.0, "worst_objective": worst, "members_nees": 2.5}


def test_nothing_of_a_single_robot_and_nothing_without_targets():
    assert team_measures(None, [SCENE]) == [{}]
    empty = Scene(id="b", agent=(0.0, 0.0, 0.0), targets=(), horizon=1)
    assert team_measures(trace(), [empty]) == [{"agents": 2}]
