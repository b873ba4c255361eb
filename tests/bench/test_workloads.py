"""The list of measurements."""

import json
from pathlib import Path

import pytest

from foveate.bench import workloads
from foveate.bench.timing import Metric

BASELINE = Path(__file__).parents[2] / "benchmarks" / "baseline.json"


@pytest.fixture
def named(monkeypatch):
    """Every measurement gives one metric of its own name, and its arguments."""
    names = (
        "training_step",
        "iterations",
        "simulation",
        "evaluation",
        "environments",
        "jax_decisions",
        "onnx_decisions",
        "planning",
    )
    for name in (*names, "compilation_counts", "starting", "whole_training"):

        def measure(*arguments, name=name):
            rest = [x for x in arguments if isinstance(x, int)]
            return [Metric(key="-".join(map(str, [name, *rest])), value=1.0, unit="1", better="lower")]

        monkeypatch.setattr(workloads, name, measure)


@pytest.mark.usefixtures("named")
def test_every_workload_is_measured_once_with_its_repeats():
    def keys(sizes, quick):
        return [metric.key for _, measure in workloads.measurements(sizes, quick) for metric in measure(7)]

    quick = [
        *("training_step-60-7", "training_step-1024-7", "iterations-7", "simulation-7", "evaluation-7"),
        "environments-7",
        *("jax_decisions-7", "onnx_decisions-7", "planning-7", "compilation_counts", "starting-7"),
    ]
    assert keys((60, 1024), True) == quick
    assert keys((60,), False) == [quick[0], *quick[2:], "whole_training"]


def test_titles_name_the_measurements():
    titles = [title for title, _ in workloads.measurements((60, 1024), quick=False)]
    assert titles[:2] == ["training step, 60 episodes", "training step, 1024 episodes"]
    assert len(set(titles)) == len(titles) == 12


def test_the_committed_baseline_has_every_training_size():
    keys = [metric["key"] for metric in json.loads(BASELINE.read_text())["metrics"]]
    assert {"train_epoch_s_60", "train_epoch_s_1024"} <= set(keys)
