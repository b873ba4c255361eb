"""The one place that knows which learner an experiment asks for."""

from collections.abc import Callable
from pathlib import Path

from foveate.learning import ppo, training
from foveate.learning.judging import Check, Outcome
from foveate.settings import Experiment, PPOSettings


def train(
    experiment: Experiment,
    out: Path,
    seed: int = 0,
    resume: bool = False,
    report: Callable[[Check, int], None] = lambda check, total: None,
) -> Outcome:
    """Train a policy into the run folder `out` by the experiment's own algorithm; `report` is called at every check.

    Raises ValueError where `out` already holds a run (or, resumed, another one), and where PPO is to be resumed.
    """
    if not isinstance(experiment.training, PPOSettings):
        return training.train(experiment, out, seed, resume, report)
    if resume:
        raise ValueError(f"{out}: PPO cannot go on where it was: train it anew")
    return ppo.train(experiment, out, seed, report)
