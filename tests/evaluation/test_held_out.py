"""Scores on held-out episodes: those of a policy by itself, by every objective, in scenes that no training has met."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest

from foveate.errors import InputError
from foveate.evaluation.held_out import held_out, planner_scores, planning_work, policy_scores
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.learning.validation import held_out_episodes
from foveate.planning.named import heuristic_policy
from foveate.planning.receding import Receding
from foveate.planning.shooting import PlanSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings
from foveate.simulation.records import PROTOCOLS
from foveate.simulation.rollout import rollout

SCENES = SceneSettings(targets_min=1, targets_max=3, steps_per_target=2, drift_m_s=(0.1, 0.1))
EXPERIMENT = Experiment(
    scenario=Scenario(scenes=SCENES),
    policy=PointerSettings(kind="pointer"),
    training=ActorCriticSettings(algorithm="actor-critic", held_out=6),
)
PROBLEM = EXPERIMENT.scenario.problem()
FEW = PlanSettings(starts=2, iterations=2)


simulated = eqx.filter_jit(rollout)


def by(objective: str) -> Experiment:
    return replace(EXPERIMENT, training=replace(EXPERIMENT.training, objective=objective))


def alone(given, policy, count: int, objective: str) -> list[float]:
    """The score of every episode, from a trace of its own, in numpy."""
    scores = []
    for i in range(count):
        episode = jax.tree.map(lambda x, i=i: x[i], given.episodes)
        trace = simulated(PROBLEM, policy, episode, PROTOCOLS["true"], given.keys[i])
        steps, n = int(episode.horizon), int(episode.present.sum())
        log_det, visible = np.asarray(trace.log_det[:steps, :n]), np.asarray(trace.visible[:steps, :n])
        scores.append({"terminal": log_det[-1], "mean": log_det, "seen": visible}[objective].mean())
    return scores


@pytest.mark.parametrize("objective", ["terminal", "mean", "seen"])
def test_policies_together_score_as_each_alone(objective: str):
    """Also one with a memory (lawnmower) and one with random numbers."""
    given = held_out(by(objective), 4, seed=1)
    policies = {name: heuristic_policy(name, PROBLEM, 2.0) for name in ("lawnmower", "random", "uncertain")}
    done = []
    found = policy_scores(given, policies, done.append)
    assert list(found) == list(policies)
    assert done == [1, 2, 3]
    for name, policy in policies.items():
        np.testing.assert_allclose(found[name], alone(given, policy, 4, objective), atol=1e-6)
    assert len({tuple(values) for values in found.values()}) == 3, "else nothing is told apart"


@pytest.mark.slow
def test_the_planner_plans_the_first_episodes():
    """Five episodes are more than a batch; their horizons differ."""
    given, done = held_out(EXPERIMENT, 6, seed=1), []
    planner = Receding(problem=PROBLEM, settings=FEW, window=SCENES.horizon(SCENES.targets_max))
    found = planner_scores(given, FEW, 5, done.append)
    assert done == [4, 5]
    assert len(found) == 5
    for i in range(5):
        episode = jax.tree.map(lambda x, i=i: x[i], given.episodes)
        trace = simulated(PROBLEM, planner, episode, PROTOCOLS["true"], given.keys[i])
        last, n = int(episode.horizon) - 1, int(episode.present.sum())
        assert found[i] == pytest.approx(np.asarray(trace.log_det[last, :n]).mean(), abs=1e-5)


def test_a_schedule_has_no_planner():
    scenario = replace(EXPERIMENT.scenario, schedule=ScheduleSettings(tau_s=(1.0, 0.5)))
    given = held_out(replace(EXPERIMENT, scenario=scenario), 1, seed=1)
    with pytest.raises(InputError, match="the scenario has a schedule"):
        planner_scores(given, FEW, 1)


def test_episodes_are_none_of_a_training():
    """Neither those of its validation, nor those of another seed; the same ones every time."""
    first, again, other = (held_out(EXPERIMENT, 6, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.episodes.mean, again.episodes.mean)
    ((_, validation),) = held_out_episodes(EXPERIMENT, jax.random.split(jax.random.key(5), 4)[1])
    for different in (other.episodes, validation):
        assert not np.isin(np.asarray(first.episodes.pose), np.asarray(different.pose)).any()


def test_work_of_a_planner_grows_with_all_its_sizes():
    plain = planning_work(EXPERIMENT, FEW)
    assert plain == 6 * 6 * 2 * 2 * 3 * 4
    assert planning_work(EXPERIMENT, replace(FEW, starts=8)) == 4 * plain
    scenes = replace(SCENES, steps=300)
    longer = replace(EXPERIMENT, scenario=replace(EXPERIMENT.scenario, scenes=scenes))
    assert planning_work(longer, FEW) == 300 * 30 * 2 * 2 * 3 * 4, "the window bounds how far it looks ahead"
