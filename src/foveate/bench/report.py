"""Report of the benchmarks: metrics, their ratios to the machine's own speed, and a comparison with a baseline."""

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from foveate.bench import timing, workloads
from foveate.bench.timing import Metric, Unit, spread
from foveate.io.files import file_error, read_json, write_json
from foveate.io.progress import Bar
from foveate.io.tables import Table

REPEATS, QUICK_REPEATS, REFERENCE_REPEATS = 9, 3, 3

NOISE = {"s": 0.05, "us": 1.0, "1": 0.5, "MiB": 32.0}
"""Values up to this, by unit, are noise, and not compared with a baseline."""

NOTE = (
    "↓ lower is better, ↑ higher is better. ratio: to this machine's own speed, comparable between machines. spread: "
    "between the quartiles of the repeats, as a share of the median; * too wide to trust."
)


@dataclass(frozen=True, kw_only=True)
class Report:
    """Metrics, first those of the machine itself; `ratios` by their keys, `repeats` of each."""

    machine: str
    repeats: int
    metrics: tuple[Metric, ...]
    ratios: dict[str, float]

    def to_json(self, path: str | Path) -> None:
        """Write the metrics as JSON, as `foveate bench --json`."""
        metrics = [{**asdict(metric), "ratio": self.ratios[metric.key]} for metric in self.metrics]
        write_json(path, {"machine": self.machine, "repeats": self.repeats, "metrics": metrics})

    def table(self, before: dict[str, float]) -> Table:
        """Return a table, one line for each metric, beside the ratios of a baseline."""
        rows = []
        for metric in self.metrics:
            ratio, baseline = self.ratios[metric.key], before.get(metric.key)
            relative = f"{ratio / baseline:.2f}" if baseline else ""
            spread_text = f"{metric.spread:.0%}{'*' * (metric.spread > timing.MAX_SPREAD)}" if metric.spread else "-"
            unit = f"{metric.unit} {'↓' if metric.better == 'lower' else '↑'}"
            rows.append((metric.key, unit, f"{metric.value:.4g}", f"{ratio:.4g}", relative, spread_text))
        table = Table(
            title=f"{self.machine}: medians of {self.repeats} repeats",
            note=NOTE,
            header=("metric", "unit", "value", "ratio", "over baseline", "spread"),
            rows=tuple(rows),
            details=() if before else ("over baseline",),
        )
        return table.brief

    def doubts(self, before: dict[str, float]) -> list[str]:
        """List metrics that are unreliable or missing, a line each."""
        lines, keys = [], {metric.key for metric in self.metrics}
        if wide := [metric.key for metric in self.metrics if metric.spread > timing.MAX_SPREAD]:
            load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
            lines.append(f"repeats differ widely (load {load}), measure again: {', '.join(wide)}")
        if "decision_onnx_us_8" not in keys:
            lines.append("decisions by ONNX Runtime need pip install 'foveate[onnx]'")
        if missing := sorted(set(before) - keys):
            lines.append(f"in the baseline, and not measured here: {', '.join(missing)}")
        return lines


def measure(episodes: Sequence[int], quick: bool = False) -> Report:
    """Run all benchmarks, with training steps of each number of `episodes`."""
    work, repeats = workloads.measurements(tuple(dict.fromkeys(episodes)), quick), QUICK_REPEATS if quick else REPEATS
    metrics: list[Metric] = []
    ratios: dict[str, float] = {}
    with Bar("measuring", len(work), "parts") as bar:
        # References before and after each part, since the load of the machine varies.
        references = [timing.measure_references(REFERENCE_REPEATS)]
        for i, (name, run) in enumerate(work):
            bar.update(i, name)
            part = run(repeats)
            references.append(timing.measure_references(REFERENCE_REPEATS))
            rates = {name: (references[-2][name] + references[-1][name]) / 2 for name in references[-1]}
            ratios |= {metric.key: metric.ratio(rates) for metric in part}
            metrics += part
        bar.update(len(work))
    speeds = _machine_metrics(references)
    ratios |= {metric.key: 1.0 for metric in speeds}
    return Report(machine=_machine(), repeats=repeats, metrics=(*speeds, *metrics), ratios=ratios)


def _machine_metrics(references: Sequence[dict[str, float]]) -> list[Metric]:
    """The machine's own speed, the reference of the ratios."""

    def metric(key: str, reference: str, unit: Unit, size: float) -> Metric:
        rates = [each[reference] for each in references]
        return Metric(key=key, value=float(np.median(rates)) / size, unit=unit, better="higher", spread=spread(rates))

    return [metric("matmul_gflop_s", "matmul", "GFLOP/s", 1e9), metric("python_loops_per_s", "python", "1/s", 1.0)]


def _machine() -> str:
    """Cores and model of the processor, and the accelerator if any."""
    device, facts = jax.devices()[0], Path("/proc/cpuinfo")
    lines = facts.read_text().splitlines() if facts.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = models[0] if models else platform.processor() or platform.machine()
    cores = f"{os.cpu_count()} cores, {processor}"
    return cores if device.platform == "cpu" else f"{device.device_kind}, {cores}"


def read_ratios(path: Path) -> dict[str, float]:
    """Read the ratios of a report from its JSON file."""
    data: Any = read_json(path, "report of foveate bench")
    try:
        ratios = {metric["key"]: float(metric["ratio"]) for metric in data["metrics"]}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise file_error(path, f"is no report of foveate bench ({error!r}): give its --json FILE") from error
    if wrong := [key for key, ratio in ratios.items() if ratio < 0]:
        raise file_error(path, f"{wrong[0]}: ratio {ratios[wrong[0]]}: expected >= 0")
    return ratios


def regressions(
    metrics: Sequence[Metric], ratios: dict[str, float], before: dict[str, float], tolerance: float
) -> dict[str, float]:
    """Return the factors by which metrics are worse than before, by more than the tolerance."""
    worse = {}
    for metric in metrics:
        lower, higher = before.get(metric.key), ratios[metric.key]
        if lower is None or (metric.better == "lower" and metric.value <= NOISE.get(metric.unit, 0.0)):
            continue
        if metric.better == "higher":
            lower, higher = higher, lower
        if higher > (1.0 + tolerance) * lower:
            worse[metric.key] = higher / lower if lower > 0 else float("inf")
    return worse
