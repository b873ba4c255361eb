"""`foveate train`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from foveate.cli.common import check_seed
from foveate.cli.options import Command, option
from foveate.errors import InputError
from foveate.names import Learner, Preset


@dataclass(kw_only=True)
class Train(Command):
    """Train a policy into a run folder.

    The folder holds config.toml, metrics.jsonl, TensorBoard events, the best checkpoint by held-out scenes, and, but
    for PPO, what --resume needs to go on. The same seed gives the same checkpoint, bit for bit, on the
    same machine.
    """

    preset: Annotated[Preset | None, option("NAME")] = None
    """paper (default): the paper's network, learner and budget (about 10 s on 2 cores). best: a network that weighs
    where to go next, trained by trying, for the paper's score and the real one alike (some 5 minutes). true-view: the
    same for what is really seen alone. search: the same where first beliefs err by as much as they claim, with a filter
    that also learns from looking in vain. quadrotor: a flying camera over constant-velocity targets in space, some
    minutes."""
    config: Annotated[Path | None, option("FILE.toml")] = None
    """Experiment in place of a preset, as written by `foveate fit` or as config.toml of another run."""
    algorithm: Annotated[Learner | None, option("NAME")] = None
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

    def prepare(self) -> None:
        """Become one of several processes where that is asked for, and use every core."""
        from foveate.learning.devices import join, use_cores

        check_seed(self.seed)
        if self.coordinator is not None or self.processes is not None or self.process_id is not None:
            join(self._coordinator(), self.processes, self.process_id)
        use_cores()

    def _coordinator(self) -> str:
        """Raise InputError where the options of several processes do not fit together."""
        if self.coordinator is None:
            raise InputError("--processes and --process-id: expected --coordinator HOST:PORT beside them")
        if self.coordinator != "auto":
            if self.processes is None or self.process_id is None:
                raise InputError(f"--coordinator {self.coordinator}: expected --processes N and --process-id I beside")
            if not 0 <= self.process_id < self.processes:
                raise InputError(f"--process-id {self.process_id}: expected from 0 to {self.processes - 1}")
        return self.coordinator

    @property
    def folder(self) -> Path:
        """The run folder."""
        if self.resume is not None:
            return self.resume
        named = (self.preset or "paper") if self.config is None else self.config.stem
        names = [named, self.algorithm, str(self.seed)]
        return self.out or Path("runs") / "-".join(name for name in names if name)
