"""Training steps beside their limit, and compilations that are counted."""

import equinox as eqx
import jax
import numpy as np
import pytest

from foveate.bench import training
from foveate.bench.operations import per_episode
from foveate.bench.training import compilation_counts, minimum_operations, training_step
from foveate.experiment.presets import PRESETS


def test_the_limit_counts_the_papers_network_on_real_targets_and_steps():
    """By hand: LI_FC 5-64-32 a target, AP_FC 3-32-32 and Out_FC 64-64-2 a decision; n targets for 3 n steps."""
    paper = PRESETS["paper"]
    problem, scenes = paper.scenario.problem(), paper.scenario.scenes
    policy = paper.policy.policy(problem, jax.random.key(0))
    steps, target_steps = (np.mean([each(n) * 3 * n for n in range(3, 9)]) for each in (lambda n: 1, lambda n: n))
    assert (steps, target_steps) == (scenes.mean_horizon, per_episode(float, scenes)) == (16.5, 99.5)
    per_target, per_decision = 5 * 64 + 64 * 32, 3 * 32 + 32 * 32 + 64 * 64 + 64 * 2
    operations = minimum_operations(problem, policy, scenes, 60)
    assert operations == pytest.approx(60 * 6 * (target_steps * per_target + steps * per_decision))


@pytest.mark.slow
def test_a_training_step_beside_its_limit(tiny):
    metrics = {metric.key: metric for metric in training_step(tiny, 60, repeats=1)}
    step, rate = metrics["train_epoch_s_60"].value, metrics["train_episodes_per_s_60"].value
    assert rate * step == pytest.approx(60)
    assert metrics["train_target_steps_per_s_60"].value == pytest.approx(rate * 1.5 * 3)
    assert metrics["train_step_over_limit_60"].value > 1, "nothing is faster than its arithmetic"
    assert metrics["train_compile_s"].value > 20 * step, "a step that is compiled already is no compilation"


def test_times_are_those_of_one_step(tiny, monkeypatch, clock):
    """A call of 2 s is 20 steps of 60 episodes; its reference does its operations in 2 s, too."""
    monkeypatch.setattr(training, "in_turn", clock)
    metrics = {metric.key: metric.value for metric in training_step(tiny, 60, repeats=1)}
    assert metrics["train_epoch_s_60"] == pytest.approx(2.0 / 20)
    assert metrics["train_episodes_per_s_60"] == pytest.approx(60 / 0.1)
    # 60 episodes of 3 steps, 1.5 targets: layers 5-4 a target, 3-4, 8-4 and 4-2 a decision.
    operations = 60 * 6 * 3 * (1.5 * 20 + 12 + 32 + 8)
    limit = 2.0 * operations / training.matrix_product()[1]
    for name in ("train_step_over_limit_60", "network_over_limit_60"):
        assert metrics[name] == pytest.approx(0.1 / limit)


@pytest.mark.slow
def test_a_training_does_not_compile_after_its_first_validation(tiny, monkeypatch):
    """With a learner whose program has a size that changes, the count shows it."""
    metrics = {metric.key: metric.value for metric in compilation_counts(tiny)}
    assert metrics["train_late_compilations"] == 0
    assert metrics["train_compilations"] >= 2

    def grows(experiment, out, on_validation):
        for size in (3, 4, 5):
            eqx.filter_jit(lambda x: x + 1.0)(np.ones(size))
            on_validation(None, 3)

    monkeypatch.setattr(training, "train", grows)
    metrics = {metric.key: metric.value for metric in compilation_counts(tiny)}
    assert metrics["train_late_compilations"] >= 2
