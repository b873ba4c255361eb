"""Decisions timed for every number of targets."""

import pytest

from foveate.bench import decisions


@pytest.mark.parametrize("name", ["jax", "onnx"])
def test_the_time_is_that_of_one_decision(name, tiny, monkeypatch, clock):
    """Calls of 2 s make 4,000 decisions for one target, but never fewer than 20."""
    if name == "onnx":
        pytest.importorskip("onnxruntime")
    monkeypatch.setattr(decisions, "TARGETS", (1, 400))
    monkeypatch.setattr(decisions, "in_turn", clock)
    measure = {"jax": decisions.jax_decisions, "onnx": decisions.onnx_decisions}[name]
    metrics = {metric.key: metric.value for metric in measure(tiny, 1)}
    assert metrics == {
        f"decision_{name}_us_1": pytest.approx(1e6 * 2.0 / 4000),
        f"decision_{name}_us_400": pytest.approx(1e6 * 2.0 / 20),
    }


def test_more_targets_take_longer(tiny, monkeypatch):
    """A thousandfold of them, so that the work shows beside the overhead of a call."""
    monkeypatch.setattr(decisions, "TARGETS", (1, 100_000))
    few, many = (metric.value for metric in decisions.jax_decisions(tiny, 3))
    assert many > 3 * few
