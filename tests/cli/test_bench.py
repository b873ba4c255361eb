"""`foveate bench`: its report, its comparison with an earlier one, and its exit status."""

import json
from pathlib import Path

import jax
import pytest
from helpers.commands import check_contract

from foveate.bench import timing
from foveate.bench import workloads as benchmarks
from foveate.bench.report import read_ratios, regressions
from foveate.bench.timing import Metric
from foveate.cli.main import main

ROOT = Path(__file__).parents[2]
BASELINE = ROOT / "benchmarks" / "baseline.json"


def metric(key, value, better="lower"):
    return Metric(key=key, value=value, unit="s" if better == "lower" else "1/s", better=better, per="matmul")


@pytest.fixture
def machine(monkeypatch):
    """A machine of one operation a second, on which two things are measured; cache settings are put back."""
    values = {"slow_s": 2.0, "rate_per_s": 10.0}
    kept = jax.config.jax_enable_compilation_cache

    def measurements(sizes, quick):
        metrics = [metric("slow_s", values["slow_s"]), metric("rate_per_s", values["rate_per_s"], "higher")]
        metrics.append(metric("never_s", 0.0))  # nothing to divide by
        return [("two things", lambda repeats: metrics)]

    monkeypatch.setattr(benchmarks, "measurements", measurements)
    monkeypatch.setattr(timing, "measure_references", lambda repeats: {"matmul": 1.0, "python": 1.0})
    yield values
    jax.config.update("jax_enable_compilation_cache", kept)


def test_a_regression_is_reported_with_exit_status_one(machine, tmp_path, capsys):
    first = tmp_path / "first.json"
    assert main(["bench", "--quick", "--json", str(first)]) == 0
    report = json.loads(first.read_text())
    reported = {each["key"]: each for each in report["metrics"]}
    assert (reported["slow_s"]["value"], reported["slow_s"]["ratio"], reported["slow_s"]["better"]) == (
        2.0,
        2.0,
        "lower",
    )
    assert "cores" in report["machine"]
    compare = ["bench", "--quick", "--baseline", str(first)]
    assert main(compare) == 0
    machine["slow_s"] = 2.9
    assert main(compare) == 0, "within the tolerance"
    machine["slow_s"] = 3.1
    assert main(compare) == 1
    assert "worse than the baseline: slow_s by a factor of 1.55" in capsys.readouterr().out
    assert main([*compare, "--tolerance", "0.6"]) == 0
    machine.update(slow_s=2.0, rate_per_s=5.0)
    assert main(compare) == 1
    assert "rate_per_s by a factor of 2.00" in capsys.readouterr().out


def test_improvements_and_tiny_changes_are_no_regression():
    metrics = [metric("a", 1.0), metric("b", 1.0, "higher"), metric("tiny", 0.01)]
    before = {"a": 3.0, "b": 0.2, "tiny": 1e-9}
    assert regressions(metrics, {"a": 1.0, "b": 1.0, "tiny": 1.0}, before, 0.5) == {}
    assert regressions(metrics, {"a": 1.0, "b": 1.0, "tiny": 1.0}, {"new": 1.0}, 0.5) == {}


def test_wrong_input_is_rejected_in_one_line(machine, tmp_path, capsys):
    broken = tmp_path / "broken.json"
    broken.write_text('{"metrics": [{"key": "a"}]}')
    for options, words in (
        (["--baseline", str(broken)], "no report of foveate bench"),
        (["--baseline", str(tmp_path / "none.json")], "no such file"),
        (["--episodes", "0"], "--episodes 0: expected >= 1"),
        (["--tolerance", "0"], "--tolerance 0.0: expected > 0"),
    ):
        assert main(["bench", *options]) == 2
        assert words in capsys.readouterr().err


def test_the_committed_baseline_is_a_report_that_keeps_the_contract():
    ratios = read_ratios(BASELINE)
    assert ratios["train_step_over_limit_60"] > 1
    check_contract("bench", BASELINE)
