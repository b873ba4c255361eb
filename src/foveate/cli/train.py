"""`foveate train`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(kw_only=True)
class Train:
    """Train a policy into a run folder.

    The folder holds config.toml, metrics.jsonl, TensorBoard events, the best checkpoint by held-out scenes, and what
    --resume needs to go on. The same seed gives the same checkpoint, bit for bit, on the same machine.
    """

    preset: Literal["paper", "best", "quadrotor"] = "paper"
    """paper: the paper's budget (about 20 s on 2 cores). best: higher scores, up to 10 minutes. quadrotor: a flying
    camera over constant-velocity targets in space, some minutes."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None
    """Experiment in place of a preset, as written by `foveate fit` or as config.toml of another run."""
    epochs: int | None = None
    """Steps of gradient ascent (default: as in the preset or file)."""
    episodes: int | None = None
    """Episodes in each of them."""
    seed: int = 0
    """Seed of weights and scenes."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """Run folder to make (default: runs/PRESET-SEED)."""
    resume: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """Go on with this run, with the settings and the seed it began with."""

    def run_command(self) -> int:
        """Train, and say how it went."""
        import sys

        from foveate.cli.common import Bar, check_seed
        from foveate.learning.training import Check, stored_run, train

        check_seed(self.seed)
        if self.resume is not None:
            given = {"--config": self.config, "--epochs": self.epochs, "--episodes": self.episodes, "--out": self.out}
            for name, value in given.items():
                if value is not None:
                    raise ValueError(f"{name} and --resume: a run goes on with the settings it began with")
            experiment, seed = stored_run(self.resume)
            out = self.resume
        else:
            experiment, seed = self._experiment(), self.seed
            name = self.preset if self.config is None else self.config.stem
            out = self.out or Path("runs") / f"{name}-{self.seed}"
        with Bar(f"training {out}", experiment.training.epochs, "epochs") as bar:

            def report(check: Check, total: int) -> None:
                bar.update(check.epoch, f"held-out {check.held_out:.2f}  {check.epochs_per_s:.0f}/s")
                if check.event:
                    bar.say(f"epoch {check.epoch}: {check.event}")

            try:
                outcome = train(experiment, out, seed, self.resume is not None, report)
            except KeyboardInterrupt:
                bar.say(f"interrupted: go on with  foveate train --resume {out}")
                raise
        print(
            f"{out}: best of {outcome.epochs} epochs at {outcome.best_epoch}, held-out score {outcome.best_score:.2f}"
        )
        if outcome.returns:
            print(f"{out}: collapsed and went back to its best {outcome.returns} times (metrics.jsonl says when)")
        if outcome.stopped:
            print(f"{out}: stopped early: {outcome.stopped}", file=sys.stderr)
            return 1
        return 0

    def _experiment(self):
        from foveate.configuration import load_toml
        from foveate.settings import PRESETS, Experiment

        experiment = PRESETS[self.preset] if self.config is None else load_toml(Experiment, self.config)
        training = experiment.training
        if self.epochs is not None:
            training = replace(training, epochs=self.epochs)
        if self.episodes is not None:
            training = replace(training, episodes=self.episodes)
        return replace(experiment, training=training)
