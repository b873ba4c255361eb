"""`foveate train`."""

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from foveate.cli.options import option
from foveate.errors import InputError

if TYPE_CHECKING:
    from foveate.experiment.experiment import Experiment
    from foveate.experiment.run_folder import Outcome


LEARNERS = Literal["policy-gradient", "actor-critic", "ppo", "ppo-tuned"]


@dataclass(kw_only=True)
class Train:
    """Train a policy into a run folder.

    The folder holds config.toml, metrics.jsonl, TensorBoard events, the best checkpoint by held-out scenes, and, but
    for PPO, what --resume needs to go on. The same seed gives the same checkpoint, bit for bit, on the
    same machine.
    """

    preset: Annotated[Literal["paper", "best", "true-view", "search", "quadrotor"] | None, option("NAME")] = None
    """paper (default): the paper's network, learner and budget (about 10 s on 2 cores). best: a network that weighs
    where to go next, trained by trying, for the paper's score and the real one alike (some 5 minutes). true-view: the
    same for what is really seen alone. search: the same where first beliefs err by as much as they claim, with a filter
    that also learns from looking in vain. quadrotor: a flying camera over constant-velocity targets in space, some
    minutes."""
    config: Annotated[Path | None, option("FILE.toml")] = None
    """Experiment in place of a preset, as written by `foveate fit` or as config.toml of another run."""
    algorithm: Annotated[LEARNERS | None, option("NAME")] = None
    """By another learner than the preset or file says, and with a network that this can train. policy-gradient: the
    paper's, through the model. actor-critic: by trying, in whole batches of noisy episodes under the real filter. ppo:
    the paper's model-free rival, Stable-Baselines3's PPO with its default settings (about 10 minutes; needs pip install
    'foveate[ppo]'), on the paper's network. ppo-tuned: the same with settings that suit this task."""
    epochs: Annotated[int | None, option("INT")] = None
    """Steps of gradient ascent, or batches of tries (default: as in the preset or file)."""
    episodes: Annotated[int | None, option("INT")] = None
    """Episodes in each of them."""
    steps: Annotated[int | None, option("INT")] = None
    """Of PPO, steps of simulated episodes in all (default: a million, about what 1000 epochs of 60 episodes take)."""
    seed: int = 0
    """Seed of weights and scenes."""
    out: Annotated[Path | None, option("RUN")] = None
    """Run folder to make (default: runs/PRESET-SEED, with the algorithm between them where one is given)."""
    resume: Annotated[Path | None, option("RUN")] = None
    """Go on with this run, with the settings and the seed it began with (not of PPO)."""
    remat: bool = False
    """For long horizons: remember a few states of an episode, and run what lies between again on the gradient's way
    back. The same gradient, a third more work, far less memory."""
    window: Annotated[int | None, option("STEPS")] = None
    """For long horizons: let the gradient end at every so many steps, so that it stays bounded. Another gradient: what
    a decision does is followed no further than to the end of its window."""
    coordinator: Annotated[str | None, option("HOST:PORT")] = None
    """Train in several processes that share out each batch of episodes, all started with the same options: address of
    the first one. auto: as SLURM, Kubernetes or MPI say, without the two options below."""
    processes: Annotated[int | None, option("N")] = None
    """How many processes there are."""
    process_id: Annotated[int | None, option("I")] = None
    """Which of them this one is, from 0; that one writes the run folder."""

    def run_command(self) -> int:
        """Train, and say how it went."""
        import sys

        from foveate.cli.common import check_seed

        check_seed(self.seed)
        if self.coordinator is not None or self.processes is not None or self.process_id is not None:
            self._join()
        from foveate.learning.devices import ProcessLost, use_cores

        use_cores()

        try:
            return self._run()
        except ProcessLost as error:
            how = f"its last check is kept: go on with  foveate train --resume {self._folder()}"
            print(f"foveate: {error}; {how}", file=sys.stderr, flush=True)
            # Not by sys.exit, which would wait for who is gone.
            os._exit(1)

    def _join(self) -> None:
        """Become one of several processes."""
        from foveate.learning.devices import join

        if self.coordinator is None:
            raise InputError("--processes and --process-id: expected --coordinator HOST:PORT beside them")
        if self.coordinator != "auto":
            if self.processes is None or self.process_id is None:
                raise InputError(f"--coordinator {self.coordinator}: expected --processes N and --process-id I beside")
            if not 0 <= self.process_id < self.processes:
                raise InputError(f"--process-id {self.process_id}: expected from 0 to {self.processes - 1}")
        join(self.coordinator, self.processes, self.process_id)

    def _run(self) -> int:
        """Train in this process."""
        import sys

        from foveate.learning.run_files import stored_run

        if self.resume is not None:
            self._reject_with_resume()
            experiment, seed = stored_run(self.resume)
            experiment, out = self._for_long_horizons(experiment), self._folder()
        else:
            experiment, seed, out = self._experiment(), self.seed, self._folder()
        outcome = self._train(experiment, out, seed)
        print(
            f"{out}: best of {outcome.epochs} epochs at {outcome.best_epoch}, held-out score {outcome.best_score:.2f}"
        )
        if outcome.rollbacks:
            print(f"{out}: collapsed and went back to its best {outcome.rollbacks} times (metrics.jsonl says when)")
        if outcome.stopped:
            print(f"{out}: stopped early: {outcome.stopped}", file=sys.stderr)
            return 1
        return 0

    def _folder(self) -> Path:
        """The run folder."""
        if self.resume is not None:
            return self.resume
        named = (self.preset or "paper") if self.config is None else self.config.stem
        names = [named, self.algorithm, str(self.seed)]
        return self.out or Path("runs") / "-".join(name for name in names if name)

    def _reject_with_resume(self) -> None:
        for name in ("preset", "config", "algorithm", "epochs", "episodes", "steps", "out", "window", "remat"):
            if getattr(self, name) not in (None, False):
                raise InputError(f"--{name} and --resume: a run goes on with the settings it began with")
        if self.seed != 0:
            raise InputError("--seed and --resume: a run goes on with the seed it began with")

    def _train(self, experiment: "Experiment", out: Path, seed: int) -> "Outcome":
        """Train, and say how to go on where it is interrupted or fails."""
        import sys

        from foveate.experiment.learners import PPOSettings
        from foveate.experiment.run_folder import CONFIG
        from foveate.learning.devices import folder_of_this_process
        from foveate.learning.train import train_watched

        try:
            with folder_of_this_process(out, self.resume is not None) as folder:
                return train_watched(experiment, folder, str(out), seed, self.resume is not None)
        except (KeyboardInterrupt, OSError) as error:
            by_hand = isinstance(error, KeyboardInterrupt)
            if by_hand or (out / CONFIG).exists():
                how = _kept(out, isinstance(experiment.training, PPOSettings))
                print(f"{'interrupted' if by_hand else 'failed'}: {how}", file=sys.stderr)
            raise

    def _experiment(self) -> "Experiment":
        from foveate.experiment.experiment import Experiment
        from foveate.experiment.presets import PRESETS, adjusted
        from foveate.io.toml import load_toml

        if self.preset is not None and self.config is not None:
            raise InputError("--preset and --config: each is a whole experiment: give one of them")
        experiment = load_toml(Experiment, self.config) if self.config is not None else PRESETS[self.preset or "paper"]
        return self._for_long_horizons(adjusted(experiment, self.algorithm, self.epochs, self.episodes, self.steps))

    def _for_long_horizons(self, experiment: "Experiment") -> "Experiment":
        """The experiment with --remat and --window. Raises ValueError where its learner cannot do what is asked."""
        from foveate.experiment.learners import TrainingSettings

        training, scenes = experiment.training, experiment.scenario.scenes
        if not self.remat and self.window is None and self.coordinator is None:
            return experiment
        if not isinstance(training, TrainingSettings):
            raise InputError("--remat, --window, --coordinator: expected a training by the policy gradient")
        if self.window is not None:
            training = replace(training, window=self.window)
        if self.remat:
            # As many segments as steps in each: least is remembered in all.
            training = replace(training, segment=math.isqrt(scenes.horizon(scenes.targets_max) - 1) + 1)
        return replace(experiment, training=training)


def _kept(out: Path, by_ppo: bool) -> str:
    """What there is of a training that did not come to its end."""
    from foveate.experiment.run_folder import BEST, CONFIG

    if by_ppo:
        return "its best so far is kept" if (out / BEST).exists() else "there is no policy of it yet"
    if not (out / CONFIG).exists():
        return "nothing was trained yet"
    return f"its last check is kept: go on with  foveate train --resume {out}"
