"""Kill training processes (SIGKILL) at random, compare what they leave with a training left alone: `make kill`.

A killed training of a JAX learner is resumed, and killed again; PPO, which cannot be resumed, begins anew after each
kill, and what it has left must be a part of what it leaves when it is left alone. Half of the processes have a slow
disk and are killed within a write. Prints for each learner the number of kills, the progress at each of them, how many
left a temporary file, and whether all files are the same.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from foveate.experiment.checkpoint import VERSION, load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings, PPOSettings
from foveate.experiment.presets import TrainingSettings
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS
from foveate.io.files import is_temporary
from foveate.io.npz import load_arrays
from foveate.io.toml import dumps_toml
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

MODEL = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=4, drift_m_s=(0.1, 0.1))),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,)),
    training=TrainingSettings(epochs=40, episodes=8, learning_rate=1e-2, held_out=16, check_every=2),
)
ACTOR_CRITIC = replace(
    MODEL,
    policy=PointerSettings(kind="pointer", target_widths=(8, 8), heads=2, context_widths=(8,), mode_width=8, modes=1),
    training=ActorCriticSettings(
        algorithm="actor-critic", epochs=40, episodes=8, minibatches=2, held_out=16, check_every=2
    ),
)


TESTS = Path(__file__).parents[1]
PPO = replace(
    MODEL,
    training=PPOSettings(
        algorithm="ppo", steps=8000, environments=8, rollout_steps=8, batch=32, check_every=64, held_out=16
    ),
)


@dataclass
class Kills:
    """Numbers of validations at the kills, and how many of them left a temporary file."""

    at: list[int] = field(default_factory=list)
    within_a_write: int = 0


def start(folder: Path, *arguments: object, slow: bool = False) -> subprocess.Popen:
    """Start `foveate train` in a process of its own; without a compilation cache it gets one in the folder."""
    environment = {"JAX_COMPILATION_CACHE_DIR": str(folder / "programs"), **os.environ}
    module = "endurance.slow_disk" if slow else "foveate.cli.main"
    environment["PYTHONPATH"] = os.pathsep.join([str(TESTS), *filter(None, [environment.get("PYTHONPATH")])])
    command = [sys.executable, "-m", module, "train", "--no-verdict", *map(str, arguments)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen) -> tuple[int, str]:
    """Wait for the process; return its exit status and output."""
    out, err = process.communicate(timeout=600)
    return process.returncode, out + err


def checks(run: Path) -> int:
    """Number of validations in a run's metrics."""
    return (run / METRICS).read_bytes().count(b"\n") if (run / METRICS).exists() else 0


def await_checks(process: subprocess.Popen, run: Path, count: int) -> None:
    """Wait until `count` validations are written, or the process has ended."""
    while checks(run) < count and process.poll() is None:
        time.sleep(0.002)


def differences(one: Path, other: Path) -> list[str]:
    """Files that differ between two runs: settings, best policy, and the state that a training resumes from."""
    found = [str(path) for path in (Path(CONFIG), BEST) if (one / path).read_bytes() != (other / path).read_bytes()]
    (_, a), (_, b) = (load_arrays(run / LAST, "training", VERSION) for run in (one, other))
    if set(a) != set(b) or any(a[name].tobytes() != b[name].tobytes() for name in a):
        found.append(str(LAST))
    return found


def temporary_files(run: Path) -> list[Path]:
    """Files that a write has begun and not yet ended."""
    return [path for path in run.rglob(".*") if is_temporary(path)] if run.exists() else []


def kill_once(process: subprocess.Popen, run: Path, rng: np.random.Generator, slow: bool, kills: Kills) -> bool:
    """Kill a training at a random moment, of a slow one within a write. Return False if it has ended before."""
    # A short process spends most of its time starting: three of four kills wait for its first validation.
    if slow:
        await_checks(process, run, checks(run) + int(rng.integers(0, 3)))
        time.sleep(rng.uniform(0, 0.3))
        pause = rng.uniform(0, 0.05)
        while process.poll() is None:
            if temporary_files(run):
                time.sleep(pause)
                if temporary_files(run):
                    break
            time.sleep(0.001)
    elif rng.random() < 0.25:
        time.sleep(rng.uniform(0, 4.0))
    else:
        await_checks(process, run, checks(run) + int(rng.integers(1, 6)))
        time.sleep(rng.uniform(0, 0.3))
    has_ended = process.poll() is not None
    process.send_signal(signal.SIGKILL)
    said = process.communicate()
    if has_ended:
        print(f"ended by itself with status {process.returncode}: {said[1][-500:]}")
        return False
    kills.at.append(checks(run))
    kills.within_a_write += bool(temporary_files(run))
    return True


def kill(experiment: Experiment, count: int, rng: np.random.Generator, folder: Path) -> tuple[Kills, list[str]]:
    """Train once alone and once with this many kills, resuming; return the kills and what differs."""
    config = folder / "experiment.toml"
    config.write_text(dumps_toml(experiment))
    status, said = finish(start(folder, "--config", config, "--seed", 3, "--out", folder / "alone"))
    assert status == 0, said
    run, kills = folder / "killed", Kills()
    while len(kills.at) < count:
        resumes = (run / CONFIG).exists()
        given = ("--resume", run) if resumes else ("--config", config, "--seed", 3, "--out", run)
        slow = len(kills.at) % 2 == 1
        if not kill_once(start(folder, *given, slow=slow), run, rng, slow, kills):
            break
    assert (run / CONFIG).exists(), "killed too early every time"
    status, said = finish(start(folder, "--resume", run))
    assert status == 0, said
    left = [f"{path.name} left" for path in temporary_files(run)]
    return kills, differences(folder / "alone", run) + left + [f"only {len(kills.at)} kills"] * (len(kills.at) < count)


def kill_ppo(experiment: Experiment, count: int, rng: np.random.Generator, folder: Path) -> tuple[Kills, list[str]]:
    """Train once alone and kill this many others of the same seed; return the kills and what is not a part of it."""
    config, kills, found = folder / "experiment.toml", Kills(), []
    config.write_text(dumps_toml(experiment))
    given = ("--config", config, "--seed", 3, "--out")
    status, said = finish(start(folder, *given, folder / "alone"))
    assert status == 0, said
    whole = untimed(folder / "alone")
    while len(kills.at) < count:
        run, slow = folder / f"killed-{len(kills.at)}", len(kills.at) % 2 == 1
        if not kill_once(start(folder, *given, run, slow=slow), run, rng, slow, kills):
            return kills, [*found, f"only {len(kills.at)} kills"]
        found += [f"{run.name}: {line}" for line in remains(experiment, run, whole)]
    return kills, found


def remains(expected: Experiment, run: Path, whole: list[dict]) -> list[str]:
    """What is wrong with the files of a killed training of PPO, whose validations left alone are `whole`."""
    lines = untimed(run) if (run / METRICS).exists() else []
    wrong = [] if lines == whole[: len(lines)] else ["other validations than of a training left alone"]
    best = [row for row in lines if row["best"]]
    if not best and not (run / BEST).exists():
        return wrong
    experiment, _, facts = load_run(run)
    # Its best is written before its line.
    behind = [row["epoch"] for row in whole[: len(lines) + 1] if row["best"]]
    if experiment != expected or facts["epoch"] not in (best[-1]["epoch"] if best else None, behind[-1]):
        wrong.append("not its best policy")
    return wrong


def untimed(run: Path) -> list[dict]:
    """Whole lines of a run's metrics, without times."""
    lines = [json.loads(line) for line in (run / METRICS).read_bytes().split(b"\n")[:-1]]
    return [{k: v for k, v in line.items() if k not in ("elapsed_s", "epochs_per_s")} for line in lines]


def main() -> int:
    """Kill trainings of all three learners; return the exit status."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--kills", type=int, default=20, help="of each learner")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    total, within, bad = 0, 0, []
    attempts: dict[str, tuple[Callable[..., tuple[Kills, list[str]]], Experiment]] = {
        "policy gradient": (kill, replace(MODEL, training=replace(MODEL.training, epochs=1500))),
        "actor-critic": (kill, replace(ACTOR_CRITIC, training=replace(ACTOR_CRITIC.training, epochs=1500))),
        "PPO": (kill_ppo, PPO),
    }
    for name, (attempt, experiment) in attempts.items():
        with tempfile.TemporaryDirectory() as folder:
            kills, found = attempt(experiment, given.kills, np.random.default_rng(given.seed), Path(folder))
        print(f"{name}: killed {len(kills.at)} times, after these numbers of checks: {kills.at};", end=" ")
        print(f"{kills.within_a_write} left a temporary file; {', '.join(found) or 'every file is right'}", flush=True)
        total, within, bad = total + len(kills.at), within + kills.within_a_write, bad + found
    print(f"{total} kills, {within} of them within a write; {len(bad)} wrong")
    return min(len(bad), 1)


if __name__ == "__main__":
    sys.exit(main())
