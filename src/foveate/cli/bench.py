"""`foveate bench`."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from foveate.cli.options import option
from foveate.errors import InputError

if TYPE_CHECKING:
    from foveate.bench.timing import Metric


REPEATS, QUICK_REPEATS, REFERENCE_REPEATS = 9, 3, 3


LEAST = {"s": 0.05, "us": 1.0, "1": 0.5, "MiB": 32.0}
"""What is no more than this is noise, and is not held against a baseline."""


@dataclass(kw_only=True)
class Bench:
    """Measure how fast training, deciding, simulating, planning and starting are on this machine.

    A training step is told beside its limit: the arithmetic of its network alone, at the rate of a large matrix product
    that is measured in the same run. Times are medians of repeats after a warm-up. Each stands beside a ratio to the
    machine's own speed; with a baseline, an earlier --json FILE, ratios that are worse than there by more than the
    tolerance make the command end with status 1.

      foveate bench --quick
      foveate bench --json bench.json --baseline benchmarks/baseline.json
    """

    quick: bool = False
    """Few repeats, and no whole training: a minute or two."""
    episodes: tuple[int, ...] = (60, 1024)
    """Episodes of the training steps that are measured; on a GPU up to a million."""
    baseline: Annotated[Path | None, option("FILE.json")] = None
    """Report of an earlier run to be compared with."""
    tolerance: float = 0.5
    """By what share a ratio may be worse than in the baseline."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the metrics for programs."""

    def run_command(self) -> int:
        """Measure, print, write, compare."""
        from foveate.cli.common import check_least, check_output, print_table
        from foveate.io.files import write_json

        check_output(self.json)
        if not self.episodes:
            raise InputError("--episodes: expected at least one number")
        for size in self.episodes:
            check_least("--episodes", size, 1)
        if not self.tolerance > 0:
            raise InputError(f"--tolerance {self.tolerance}: expected > 0")
        before = None if self.baseline is None else read_ratios(self.baseline)
        metrics, ratios = self._measure()
        if self.json is not None:
            told = [{**asdict(metric), "ratio": ratios[metric.key]} for metric in metrics]
            write_json(self.json, {"machine": machine(), "repeats": self._repeats, "metrics": told})
        worse = {} if before is None else regressions(metrics, ratios, before, self.tolerance)
        rows = [
            (
                metric.key,
                metric.unit,
                f"{metric.value:.4g}",
                f"{ratios[metric.key]:.4g}",
                "" if not (then := (before or {}).get(metric.key)) else f"{ratios[metric.key] / then:.2f}",
                metric.better,
                f"{metric.spread:.0%}{' wide' * metric.is_wide}",
            )
            for metric in metrics
        ]
        header = ("metric", "unit", "value", "ratio", "over baseline", "better", "spread")
        print_table(f"{machine()}: medians of {self._repeats} repeats", header, rows)
        self._warn(metrics, before)
        for key, factor in worse.items():
            print(f"worse than the baseline: {key} by a factor of {factor:.2f}")
        return 1 if worse else 0

    @property
    def _repeats(self) -> int:
        return QUICK_REPEATS if self.quick else REPEATS

    def _measure(self) -> "tuple[list[Metric], dict[str, float]]":
        """All metrics, with the yardsticks in front, and their ratios."""
        import jax
        import numpy as np

        # So that compilation is what is timed. Before the first array is made, since JAX looks once.
        jax.config.update("jax_enable_compilation_cache", False)
        from foveate.learning.devices import use_cores

        use_cores()
        from foveate.bench.timing import Metric, measure_references, spread
        from foveate.bench.workloads import measurements
        from foveate.io.progress import Bar

        work = measurements(tuple(dict.fromkeys(self.episodes)), self.quick)
        found: list[Metric] = []
        ratios: dict[str, float] = {}
        with Bar("measuring", len(work), "parts") as bar:
            # Before and after each part, since other work on the machine comes and goes.
            beside = [measure_references(REFERENCE_REPEATS)]
            for i, (what, measure) in enumerate(work):
                bar.update(i, what)
                part = measure(self._repeats)
                beside.append(measure_references(REFERENCE_REPEATS))
                rates = {name: (beside[-2][name] + beside[-1][name]) / 2 for name in beside[-1]}
                ratios |= {metric.key: metric.ratio(rates) for metric in part}
                found += part
            bar.update(len(work))
        matmul, python = ([each[name] for each in beside] for name in ("matmul", "python"))
        first = [
            Metric(
                key="matmul_gflop_s",
                value=float(np.median(matmul)) / 1e9,
                unit="GFLOP/s",
                better="higher",
                spread=spread(matmul),
            ),
            Metric(
                key="python_loops_per_s",
                value=float(np.median(python)),
                unit="1/s",
                better="higher",
                spread=spread(python),
            ),
        ]
        ratios |= {metric.key: 1.0 for metric in first}
        return first + found, ratios

    def _warn(self, metrics: "list[Metric]", before: dict[str, float] | None) -> None:
        """On standard error, what is not to be trusted and what is missing."""
        import os
        import sys

        if wide := [metric.key for metric in metrics if metric.is_wide]:
            load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
            print(f"foveate: repeats differ widely (load {load}), measure again: {', '.join(wide)}", file=sys.stderr)
        keys = {metric.key for metric in metrics}
        if "decision_onnx_us_8" not in keys:
            print("foveate: decisions by ONNX Runtime need pip install 'foveate[onnx]'", file=sys.stderr)
        if before is not None and (missing := sorted(set(before) - keys)):
            print(f"foveate: in the baseline, and not measured here: {', '.join(missing)}", file=sys.stderr)


def machine() -> str:
    """Cores and model of the processor, and the accelerator where there is one."""
    import os

    import jax

    device = jax.devices()[0]
    cores = f"{os.cpu_count()} cores, {_processor()}"
    return cores if device.platform == "cpu" else f"{device.device_kind}, {cores}"


def _processor() -> str:
    import platform

    facts = Path("/proc/cpuinfo")
    lines = facts.read_text().splitlines() if facts.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def read_ratios(path: Path) -> dict[str, float]:
    """The ratios of a report. Raises ValueError where the file is no such report."""
    from foveate.io.files import file_error, read_json

    data: Any = read_json(path, "report of foveate bench")
    try:
        ratios = {metric["key"]: float(metric["ratio"]) for metric in data["metrics"]}
    except (KeyError, TypeError, ValueError) as error:
        raise file_error(path, f"is no report of foveate bench ({error!r}): give its --json FILE") from error
    if wrong := [key for key, ratio in ratios.items() if ratio < 0]:
        raise file_error(path, f"{wrong[0]}: ratio {ratios[wrong[0]]}: expected >= 0")
    return ratios


def regressions(
    metrics: "list[Metric]", ratios: dict[str, float], before: dict[str, float], tolerance: float
) -> dict[str, float]:
    """By which factor each metric is worse than before, of those that are so by more than the tolerance."""
    found = {}
    for metric in metrics:
        now, then = ratios[metric.key], before.get(metric.key)
        if then is None or (metric.better == "lower" and metric.value <= LEAST.get(metric.unit, 0.0)):
            continue
        good, bad = (then, now) if metric.better == "lower" else (now, then)
        if bad > (1.0 + tolerance) * good:
            found[metric.key] = bad / good if good > 0 else float("inf")
    return found
