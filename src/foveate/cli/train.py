"""`foveate train`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from foveate.cli.common import check_seed
from foveate.cli.options import Changes, Command, option
from foveate.errors import InputError
from foveate.names import Learner, Preset


@dataclass(kw_only=True)
class Train(Command):
    """Train a policy into a run folder.

    The folder holds config.toml, metrics.jsonl, TensorBoard events, the checkpoint that is best on held-out scenes, and
    (except with PPO) the state for --resume. The same seed gives the same checkpoint, bit for bit, on one machine. At
    the end the policy is judged, in seconds, on scenes that neither trained nor selected it: by the score that it was
    trained for, beside every heuristic and a planner (verdict.json).
    """

    preset: Annotated[Preset | None, option("NAME")] = None
    """paper (default): the paper's network, learner and budget (10 s on 2 cores). best: a pointer network trained by
    actor-critic for the surrogate and the true score alike (5 minutes). true-view: the same for the true score alone.
    search: the same with consistent initial errors and a filter that uses missed detections. quadrotor: a flying camera
    over constant-velocity targets in space. pan, pan-tilt: a camera that only turns, in the plane and in space.
    rooms: a robot among walls, told ranges and ways around them. forest: the same of the flying camera among trunks.
    any: one policy for any robot in the plane. `foveate presets` prints more of each."""
    config: Annotated[Path | None, option("FILE.toml")] = None
    """Experiment in place of a preset: from `foveate fit` or `foveate config`, or a copy of config.toml of a run."""
    set: Changes = ()
    """Settings that replace those of the preset or file, as scenario.view.depth_m=5 training.learning_rate=3e-4.
    policy.begin_with= leaves that key out."""
    algorithm: Annotated[Learner | None, option("NAME")] = None
    """Another learner than that of the preset or file, with a network that it can train. policy-gradient: the paper's,
    through the differentiable simulation. actor-critic: PPO on full noisy episodes under the real filter. ppo: the
    paper's model-free baseline, PPO of Stable-Baselines3 with its defaults (10 minutes; needs pip install
    'foveate[ppo]'). ppo-tuned: the same with settings for this task."""
    epochs: Annotated[int | None, option("INT")] = None
    """Iterations of the learner (default: as in the preset or file); with --resume, more of them than before."""
    episodes: Annotated[int | None, option("INT")] = None
    """Episodes per iteration."""
    steps: Annotated[int | None, option("INT")] = None
    """Environment steps of PPO (default: a million, about as many as 1000 iterations of 60 episodes)."""
    seed: int = 0
    """Seed of weights and scenes."""
    out: Annotated[Path | None, option("RUN")] = None
    """Run folder to create (default: runs/PRESET-SEED or runs/PRESET-ALGORITHM-SEED)."""
    resume: Annotated[Path | None, option("RUN")] = None
    """Resume this run with its own settings and seed (not with PPO); a finished one with --epochs N continues to N."""
    verdict: bool = True
    """Judge the policy at the end."""
    remat: bool = False
    """For long horizons: store few states of an episode and recompute the others on the way back. The same gradient, a
    third more work, far less memory."""
    window: Annotated[int | None, option("STEPS")] = None
    """For long horizons: truncate the gradient every STEPS steps, so that it stays bounded. A different gradient: the
    effect of a decision is followed to the end of its window only."""
    coordinator: Annotated[str | None, option("HOST:PORT")] = None
    """Address of the first of several processes that share each batch, all started with the same options. auto: as
    SLURM, Kubernetes or MPI say, without the two options below."""
    processes: Annotated[int | None, option("N")] = None
    """Number of processes."""
    process_id: Annotated[int | None, option("I")] = None
    """Index of this process, from 0; process 0 writes the run folder."""

    def prepare(self) -> None:
        """Join the other processes if there are any, and use every core."""
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
