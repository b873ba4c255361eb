"""The files of a run folder: their names, the record of each validation, and how a run ended."""

import json
from dataclasses import dataclass, fields
from pathlib import Path

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.io.files import LOCK, is_temporary, read_text, write_atomic

CONFIG = "config.toml"


BEST = Path("checkpoint") / "best.npz"


LAST = Path("checkpoint") / "last.npz"


METRICS = "metrics.jsonl"


@dataclass(frozen=True, kw_only=True)
class Validation:
    """One judgement of a policy in training, a line of `metrics.jsonl`.

    An epoch is one step of the policy gradient, or of PPO one rollout with all passes over it; `env_steps` is how many
    steps of simulated episodes all epochs took (in the mean over the scenes drawn, where they are not counted).
    `objective` is the mean over the epochs since the last check, `held_out` the score of the protocol that selects
    the best, `at_limit` the share of held-out commands with every axis at a limit; PPO tells no `gradient_norm`.
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


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a training ended."""

    epochs: int
    best_epoch: int
    best_score: float
    rollbacks: int
    stopped: str


def claim(out: Path, experiment: Experiment) -> None:
    """Make the run folder `out`, but for its config.toml: that is written last, where there is something to go on with.

    What a training left that was killed before that is no run. Raises ValueError where something else is there.
    """
    require_free(out, experiment)
    (out / BEST).parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out / METRICS, b"")


def require_free(out: Path, experiment: Experiment) -> None:
    """Raise ValueError where a run, or something else, is there already."""
    if out.exists() and not _is_free(out):
        resume = "" if isinstance(experiment.training, PPOSettings) else f", or go on with --resume {out}"
        raise InputError(f"{out}: exists already: choose another --out{resume}")


def _is_free(out: Path) -> bool:
    """A folder without anything, or with a beginning from before the first check."""
    if not out.is_dir() or (out / CONFIG).exists():
        return False
    inside = [path for path in out.rglob("*") if not is_temporary(path)]
    remains = {out / LOCK, out / METRICS, (out / LAST).parent, out / LAST}
    return set(inside) <= remains and all(path.stat().st_size == 0 for path in inside if path.name == METRICS)


def read_validations(file: Path) -> list[Validation]:
    """The checks of a `metrics.jsonl`; a last line that was cut while it was written is passed over."""
    names, checks = {field.name for field in fields(Validation)}, []
    lines = [line for line in read_text(file, "metrics.jsonl of a run").splitlines() if line.strip()]
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            checks.append(Validation(**{name: value for name, value in row.items() if name in names}))
        except (ValueError, TypeError, AttributeError):
            if number < len(lines):
                raise InputError(f"{file}: line {number}: not a check of a training") from None
    if not checks:
        raise InputError(f"{file}: no check in it yet: expected at least one line")
    return checks
