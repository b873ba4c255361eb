"""What the benchmark's numbers mean; how large they are is no test's business."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest

from foveate.bench import workloads as benchmarks
from foveate.bench.workloads import dense_products, least_operations, real_steps, training_step
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS, TrainingSettings
from foveate.planning.shooting import PlanSettings
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

TINY = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=3)),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)),
    training=TrainingSettings(episodes=2, held_out=2),
)


def test_the_limit_counts_the_papers_network_on_real_targets_and_steps():
    """By hand: LI_FC 5-64-32 a target, AP_FC 3-32-32 and Out_FC 64-64-2 a decision; n targets for 3 n steps."""
    paper = PRESETS["paper"]
    policy = paper.policy.policy(paper.scenario.problem(), jax.random.key(0))
    assert dense_products(policy) == (5 * 64 + 64 * 32, 3 * 32 + 32 * 32 + 64 * 64 + 64 * 2)
    steps, target_steps = real_steps(paper.scenario.scenes)
    assert steps == np.mean([3 * n for n in range(3, 9)])
    assert target_steps == np.mean([n * 3 * n for n in range(3, 9)])
    operations = least_operations(policy, paper.scenario.scenes, 60)
    assert operations == pytest.approx(60 * 6 * (99.5 * 2368 + 16.5 * 5344))


@pytest.mark.slow
def test_a_training_step_is_told_beside_its_limit():
    found = {metric.key: metric for metric in training_step(TINY, 60, repeats=1)}
    step, rate = found["train_epoch_s_60"].value, found["train_episodes_per_s_60"].value
    assert rate * step == pytest.approx(60)
    assert found["train_target_steps_per_s_60"].value == pytest.approx(rate * 1.5 * 3)
    assert found["train_step_over_limit_60"].value > 1, "nothing is faster than its arithmetic"
    assert found["train_compile_s"].value > 0


def test_decisions_are_timed_for_every_number_of_targets(monkeypatch):
    monkeypatch.setattr(benchmarks, "TARGETS", (1, 3))
    for name, decisions in (("jax", benchmarks.decisions_jax), ("onnx", benchmarks.decisions_onnx)):
        keys = [metric.key for metric in decisions(TINY, 1)]
        assert keys == [f"decision_{name}_us_1", f"decision_{name}_us_3"]


def test_environments_are_stepped(monkeypatch):
    monkeypatch.setattr(benchmarks, "ENVIRONMENTS", 2)
    (metric,) = benchmarks.environments(TINY, 1)
    assert metric.key == "env_steps_per_s_2"
    assert metric.value > 0


@pytest.mark.slow
def test_what_is_simulated_and_planned_is_counted(monkeypatch):
    five = replace(TINY, scenario=Scenario(scenes=SceneSettings(targets_min=5, targets_max=5, steps=2)))
    monkeypatch.setattr(benchmarks, "ENVIRONMENTS", 2)
    monkeypatch.setattr(benchmarks, "PLANNED_SCENES", 1)
    monkeypatch.setattr(benchmarks, "OMNISCIENT", {"true": PlanSettings(starts=1, iterations=1)})
    found = {metric.key: metric.value for metric in benchmarks.simulation(five, 1)}
    per_episode = found["evaluation_target_steps_per_s"] / found["evaluation_episodes_per_s"]
    assert per_episode == pytest.approx(5 * 2)
    assert found["rollout_target_steps_per_s"] > 0
    (planned,) = benchmarks.planning(five, 1)
    assert (planned.key, planned.better) == ("planner_scenes_per_s", "higher")
    assert planned.value > 0


def test_the_second_of_two_processes_finds_what_the_first_compiled(monkeypatch):
    said = []
    monkeypatch.setattr(benchmarks, "_process", lambda *words, cache=None: said.append((words, cache)))
    cold, warm = benchmarks.whole_process()
    assert (cold.key, warm.key) == ("train_process_cold_s", "train_process_warm_s")
    (first, cache), (second, same) = said
    assert cache == same is not None
    assert first[-1] != second[-1], "another run folder"
    assert "paper" in first


def test_starting_is_timed_in_processes_of_its_own(monkeypatch):
    said = []
    monkeypatch.setattr(benchmarks, "_process", lambda *words: said.append(words))
    assert [metric.key for metric in benchmarks.starting(9)] == ["help_s", "import_s"]
    assert len(said) == 2 * (5 + 1), "no more than five, and a warm-up"


@pytest.mark.slow
def test_a_training_compiles_nothing_after_its_first_check(monkeypatch):
    """With a learner whose program has a size that changes, the count says so."""
    found = {metric.key: metric.value for metric in benchmarks.compiled(TINY)}
    assert found["train_late_compilations"] == 0
    assert found["train_compilations"] >= 2

    def grows(experiment, out, report):
        for size in (3, 4, 5):
            eqx.filter_jit(lambda x: x + 1.0)(np.ones(size))
            report(None, 3)

    monkeypatch.setattr(benchmarks, "train", grows)
    found = {metric.key: metric.value for metric in benchmarks.compiled(TINY)}
    assert found["train_late_compilations"] >= 2


def test_a_process_that_fails_says_how():
    with pytest.raises(ValueError, match="ended with 1: NameError"):
        benchmarks._process("-c", "nothing")
    assert benchmarks._process("-c", "import os; assert os.environ['JAX_COMPILATION_CACHE_DIR'] == 'x'", cache="x") > 0


def test_all_is_on_the_list():
    names = [name for name, _ in benchmarks.measurements((60, 1024), quick=True)]
    assert names[:2] == ["training step, 60 episodes", "training step, 1024 episodes"]
    longer = [name for name, _ in benchmarks.measurements((60,), quick=False)]
    assert "the paper's training, from command to checkpoint" in longer
