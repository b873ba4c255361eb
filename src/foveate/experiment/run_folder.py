"""Files of a run folder: their names, the record of a validation, and the outcome of a training."""

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.io.files import LOCK, is_temporary, read_text, write_atomic
from foveate.io.strict_json import parse_json

CONFIG, METRICS, EXTENDED, VERDICT = "config.toml", "metrics.jsonl", "extended.json", "verdict.json"
BEST, LAST = Path("checkpoint") / "best.npz", Path("checkpoint") / "last.npz"


@dataclass(frozen=True, kw_only=True)
class Validation:
    """A validation of a policy in training, a line of `metrics.jsonl`.

    An epoch is a step of the policy gradient, or an iteration of PPO: a rollout and all updates from it. `env_steps`
    counts the simulated steps of all epochs (their expectation if horizons are random). `objective` is the mean over
    the epochs since the last validation, `held_out` the score of the protocol that selects the best, `at_limit` the
    share of held-out commands with every axis at a limit. `gradient_norm` is null for PPO of Stable-Baselines3.
    """

    epoch: int
    objective: float
    gradient_norm: float | None
    held_out: float
    at_limit: float
    best: bool
    epochs_per_s: float
    elapsed_s: float
    event: str = ""
    env_steps: int = 0

    def numbers(self) -> dict[str, float]:
        """All numbers that are finite, by name, as loggers take them: `mlflow.log_metrics(metrics.numbers())`."""
        values = {name: value for name, value in asdict(self).items() if isinstance(value, int | float)}
        return {name: float(value) for name, value in values.items() if math.isfinite(value)}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a training; `stopped` is the reason if it ended early."""

    epochs: int
    best_epoch: int
    best_score: float
    rollbacks: int
    stopped: str


def outcome_of(record: dict[str, Any]) -> Outcome:
    """Read an outcome from its fields; `rollbacks` was called `returns` in version 0.1."""
    return Outcome(**{"rollbacks" if name == "returns" else name: value for name, value in record.items()})


def claim(out: Path, experiment: Experiment) -> None:
    """Create the run folder `out`, but not its config.toml, which is written last. Raises as `require_free`."""
    require_free(out, experiment)
    (out / BEST).parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out / METRICS, b"")


def require_free(out: Path, experiment: Experiment) -> None:
    """Raise InputError if `out` exists, unless it is empty or left by a training killed before its config.toml."""
    if out.exists() and not _is_free(out):
        resume = "" if isinstance(experiment.training, PPOSettings) else ", or resume the training in it"
        raise InputError(f"{out}: exists already: choose another folder{resume}")


def _is_free(out: Path) -> bool:
    if not out.is_dir() or (out / CONFIG).exists():
        return False
    inside = [path for path in out.rglob("*") if not is_temporary(path)]
    remains = {out / LOCK, out / METRICS, (out / LAST).parent, out / LAST}
    return set(inside) <= remains and all(path.stat().st_size == 0 for path in inside if path.name == METRICS)


def read_validations(file: Path) -> list[Validation]:
    """Read the validations of a `metrics.jsonl`, except for a truncated last line."""
    names, validations = {field.name for field in fields(Validation)}, []
    lines = [line for line in read_text(file, "metrics.jsonl of a run").splitlines() if line.strip()]
    for number, line in enumerate(lines, start=1):
        try:
            values = {name: value for name, value in parse_json(line).items() if name in names}
            validations.append(Validation(**values))
        except (ValueError, TypeError, AttributeError):
            if number < len(lines):
                raise InputError(f"{file}: line {number}: not a validation of a training") from None
    if not validations:
        raise InputError(f"{file}: no validation in it yet: expected at least one line")
    return validations
