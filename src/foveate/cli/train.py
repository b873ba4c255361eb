"""`foveate train`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from foveate.learning.judging import Check, Outcome
    from foveate.settings import Experiment

METHOD = Literal["policy-gradient", "ppo", "ppo-tuned"]


@dataclass(kw_only=True)
class Train:
    """Train a policy into a run folder.

    The folder holds config.toml, metrics.jsonl, TensorBoard events, the best checkpoint by held-out scenes, and, of
    the policy gradient, what --resume needs to go on. The same seed gives the same checkpoint, bit for bit, on the
    same machine.
    """

    preset: Literal["paper", "best", "true-view", "quadrotor"] = "paper"
    """paper: the paper's budget (about 20 s on 2 cores). best: another network, lessons and a damped gradient, higher
    scores by far where targets have to be really seen (1 to 2 minutes). quadrotor: a flying camera over
    constant-velocity targets in space, some minutes."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None
    """Experiment in place of a preset, as written by `foveate fit` or as config.toml of another run."""
    algorithm: METHOD | None = None
    """policy-gradient: the paper's, through the model (default, unless a file says otherwise). ppo: its model-free
    rival, Stable-Baselines3's PPO with its default settings (about 10 minutes; needs pip install 'foveate[ppo]'), on
    the same world with the same network. ppo-tuned: PPO with settings that suit this task."""
    epochs: int | None = None
    """Steps of gradient ascent (default: as in the preset or file)."""
    episodes: int | None = None
    """Episodes in each of them."""
    steps: int | None = None
    """Of PPO, steps of simulated episodes in all (default: a million, about what 1000 epochs of 60 episodes take)."""
    seed: int = 0
    """Seed of weights and scenes."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """Run folder to make (default: runs/PRESET-SEED, with the algorithm between them where one is given)."""
    resume: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """Go on with this run, with the settings and the seed it began with (policy gradient only)."""

    def run_command(self) -> int:
        """Train, and say how it went."""
        import sys

        from foveate.cli.common import check_seed
        from foveate.learning.training import stored_run

        check_seed(self.seed)
        if self.resume is not None:
            self._refuse_with_resume()
            experiment, seed = stored_run(self.resume)
            out = self.resume
        else:
            experiment, seed = self._experiment(), self.seed
            names = [self.preset if self.config is None else self.config.stem, self.algorithm, str(self.seed)]
            out = self.out or Path("runs") / "-".join(name for name in names if name)
        outcome = self._train(experiment, out, seed)
        print(
            f"{out}: best of {outcome.epochs} epochs at {outcome.best_epoch}, held-out score {outcome.best_score:.2f}"
        )
        if outcome.returns:
            print(f"{out}: collapsed and went back to its best {outcome.returns} times (metrics.jsonl says when)")
        if outcome.stopped:
            print(f"{out}: stopped early: {outcome.stopped}", file=sys.stderr)
            return 1
        return 0

    def _refuse_with_resume(self) -> None:
        for name in ("config", "algorithm", "epochs", "episodes", "steps", "out"):
            if getattr(self, name) is not None:
                raise ValueError(f"--{name} and --resume: a run goes on with the settings it began with")

    def _train(self, experiment: "Experiment", out: Path, seed: int) -> "Outcome":
        """Train with a bar that counts epochs, of PPO steps."""
        from foveate.cli.common import Bar
        from foveate.learning.learner import train
        from foveate.settings import PPOSettings

        settings = experiment.training
        by_ppo = isinstance(settings, PPOSettings)
        total, unit = (settings.steps, "steps") if by_ppo else (settings.epochs, "epochs")
        with Bar(f"training {out}", total, unit) as bar:

            def report(check: "Check", _: int) -> None:
                done, rate = check.epoch, check.epochs_per_s
                if by_ppo:
                    done, rate = check.env_steps, check.epochs_per_s * check.env_steps / check.epoch
                bar.update(done, f"held-out {check.held_out:.2f}  {rate:.0f}/s")
                if check.event:
                    bar.say(f"epoch {check.epoch}: {check.event}")

            try:
                return train(experiment, out, seed, self.resume is not None, report)
            except KeyboardInterrupt:
                how = "its best so far is kept" if by_ppo else f"go on with  foveate train --resume {out}"
                bar.say(f"interrupted: {how}")
                raise

    def _experiment(self) -> "Experiment":
        from foveate.configuration import load_toml
        from foveate.settings import PPO, PRESETS, Experiment, PPOSettings, TrainingSettings, with_learner

        experiment = PRESETS[self.preset] if self.config is None else load_toml(Experiment, self.config)
        if self.algorithm == "policy-gradient" and isinstance(experiment.training, PPOSettings):
            experiment = with_learner(experiment, TrainingSettings())
        keeps_own = self.algorithm == "ppo" and isinstance(experiment.training, PPOSettings)
        if self.algorithm in PPO and not keeps_own:
            experiment = with_learner(experiment, PPO[self.algorithm])
        training = experiment.training
        wanted = ("steps",) if isinstance(training, PPOSettings) else ("epochs", "episodes")
        for name in ("epochs", "episodes", "steps"):
            if (value := getattr(self, name)) is None:
                continue
            if name not in wanted:
                right = " or ".join(f"--{other}" for other in wanted)
                raise ValueError(f"--{name}: this algorithm does not count them: expected {right}")
            training = replace(training, **{name: value})
        return replace(experiment, training=training)
