"""The report of the benchmarks: metrics with their ratios to the machine's own speed, and a comparison with an earlier
one.
"""

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from foveate.bench import timing, workloads
from foveate.bench.timing import Metric, spread
from foveate.io.files import file_error, read_json, write_json
from foveate.io.progress import Bar
from foveate.io.tables import Table

REPEATS, QUICK_REPEATS, REFERENCE_REPEATS = 9, 3, 3


LEAST = {"s": 0.05, "us": 1.0, "1": 0.5, "MiB": 32.0}
"""Values up to this, by unit, are noise, and are not held against a baseline."""


@dataclass(frozen=True, kw_only=True)
class Report:
    """Metrics of this machine, those of the machine itself in front; `ratios` by their keys, `repeats` of each."""

    machine: str
    repeats: int
    metrics: tuple[Metric, ...]
    ratios: dict[str, float]

    def to_json(self, path: str | Path) -> None:
        """Write the metrics for programs, as `foveate bench --json`."""
        metrics = [{**asdict(metric), "ratio": self.ratios[metric.key]} for metric in self.metrics]
        write_json(path, {"machine": self.machine, "repeats": self.repeats, "metrics": metrics})

    def table(self, before: dict[str, float]) -> Table:
        """One line a metric, beside the ratios of a baseline."""
        rows = [
            (
                metric.key,
                metric.unit,
                f"{metric.value:.4g}",
                f"{self.ratios[metric.key]:.4g}",
                "" if not (then := before.get(metric.key)) else f"{self.ratios[metric.key] / then:.2f}",
                metric.better,
                f"{metric.spread:.0%}{' wide' * metric.is_wide}",
            )
            for metric in self.metrics
        ]
        header = ("metric", "unit", "value", "ratio", "over baseline", "better", "spread")
        return Table(title=f"{self.machine}: medians of {self.repeats} repeats", header=header, rows=tuple(rows))

    def doubts(self, before: dict[str, float]) -> list[str]:
        """What is not to be trusted, and what is missing: each a line."""
        lines, keys = [], {metric.key for metric in self.metrics}
        if wide := [metric.key for metric in self.metrics if metric.is_wide]:
            load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
            lines.append(f"repeats differ widely (load {load}), measure again: {', '.join(wide)}")
        if "decision_onnx_us_8" not in keys:
            lines.append("decisions by ONNX Runtime need pip install 'foveate[onnx]'")
        if missing := sorted(set(before) - keys):
            lines.append(f"in the baseline, and not measured here: {', '.join(missing)}")
        return lines


def measure(episodes: Sequence[int], quick: bool = False) -> Report:
    """Run all benchmarks, with training steps of that many `episodes`."""
    work, repeats = workloads.measurements(tuple(dict.fromkeys(episodes)), quick), QUICK_REPEATS if quick else REPEATS
    metrics: list[Metric] = []
    ratios: dict[str, float] = {}
    with Bar("measuring", len(work), "parts") as bar:
        # Before and after each part, since other work on the machine comes and goes.
        references = [timing.measure_references(REFERENCE_REPEATS)]
        for i, (name, run) in enumerate(work):
            bar.update(i, name)
            part = run(repeats)
            references.append(timing.measure_references(REFERENCE_REPEATS))
            rates = {name: (references[-2][name] + references[-1][name]) / 2 for name in references[-1]}
            ratios |= {metric.key: metric.ratio(rates) for metric in part}
            metrics += part
        bar.update(len(work))
    own = _machine_metrics(references)
    ratios |= {metric.key: 1.0 for metric in own}
    return Report(machine=machine(), repeats=repeats, metrics=(*own, *metrics), ratios=ratios)


def _machine_metrics(references: Sequence[dict[str, float]]) -> tuple[Metric, Metric]:
    """The machine's own speed, that ratios are taken to."""
    products, loops = ([rates[name] for rates in references] for name in ("matmul", "python"))
    product = Metric(
        key="matmul_gflop_s",
        value=float(np.median(products)) / 1e9,
        unit="GFLOP/s",
        better="higher",
        spread=spread(products),
    )
    loop = Metric(
        key="python_loops_per_s", value=float(np.median(loops)), unit="1/s", better="higher", spread=spread(loops)
    )
    return product, loop


def machine() -> str:
    """Cores and model of the processor, and the accelerator if any."""
    device = jax.devices()[0]
    cores = f"{os.cpu_count()} cores, {_processor()}"
    return cores if device.platform == "cpu" else f"{device.device_kind}, {cores}"


def _processor() -> str:
    facts = Path("/proc/cpuinfo")
    lines = facts.read_text().splitlines() if facts.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def read_ratios(path: Path) -> dict[str, float]:
    """The ratios of a report's file. Raises InputError where it is none."""
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
    """By which factor each metric is worse than before, of those that are so by more than the tolerance."""
    worse = {}
    for metric in metrics:
        now, then = ratios[metric.key], before.get(metric.key)
        if then is None or (metric.better == "lower" and metric.value <= LEAST.get(metric.unit, 0.0)):
            continue
        good, bad = (then, now) if metric.better == "lower" else (now, then)
        if bad > (1.0 + tolerance) * good:
            worse[metric.key] = bad / good if good > 0 else float("inf")
    return worse
