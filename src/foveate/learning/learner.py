"""The one place that knows which learner an experiment asks for."""

from collections.abc import Callable
from pathlib import Path

from foveate.checkpoint import CONFIG
from foveate.files import LOCK, sole_writer
from foveate.learning import ppo, training
from foveate.learning.judging import Check, Outcome, require_free
from foveate.settings import Experiment, PPOSettings


def train(
    experiment: Experiment,
    out: Path,
    seed: int = 0,
    resume: bool = False,
    report: Callable[[Check, int], None] = lambda check, total: None,
) -> Outcome:
    """Train a policy into the run folder `out` by the experiment's own algorithm; `report` is called at every check.

    Raises ValueError where `out` already holds a run (or, resumed, another one), or another process trains into it, and
    where PPO is to be resumed.
    """
    by_ppo = isinstance(experiment.training, PPOSettings)
    if resume and by_ppo:
        raise ValueError(f"{out}: PPO cannot go on where it was: train it anew")
    if resume and not (out / CONFIG).exists():
        raise ValueError(f"{out}: holds no training to go on with: begin one there")
    if not resume:
        require_free(out, experiment)
        out.mkdir(parents=True, exist_ok=True)
    with sole_writer(out):
        try:
            if by_ppo:
                return ppo.train(experiment, out, seed, report)
            return training.train(experiment, out, seed, resume, report)
        except ValueError:
            if [path.name for path in out.iterdir()] == [LOCK]:  # refused before anything was written
                (out / LOCK).unlink()
                out.rmdir()
            raise
