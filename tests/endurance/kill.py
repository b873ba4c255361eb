"""Kill training processes (SIGKILL) at random, resume them, compare with a training left alone: `make kill`.

Prints for each learner the number of kills, the progress at each of them, and whether all files are the same.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from foveate.experiment.checkpoint import VERSION
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.presets import TrainingSettings
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS
from foveate.io.npz import load_arrays
from foveate.io.toml import dumps_toml
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

MODEL = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=4, drift_m_s=(0.1, 0.1))),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,)),
    training=TrainingSettings(epochs=40, episodes=8, learning_rate=1e-2, held_out=16, check_every=2),
)
ACTOR_CRITIC = replace(
    MODEL,
    policy=PointerSettings(
        kind="pointer", target_widths=(8, 8), heads=2, context_widths=(8,), mode_widths=(8,), modes=1
    ),
    training=ActorCriticSettings(
        algorithm="actor-critic", epochs=40, episodes=8, minibatches=2, held_out=16, check_every=2
    ),
)


def start(folder: Path, *arguments: object) -> subprocess.Popen:
    """Start `foveate train` in a process of its own; without a compilation cache it gets one in the folder."""
    environment = {"JAX_COMPILATION_CACHE_DIR": str(folder / "programs"), **os.environ}
    command = [sys.executable, "-m", "foveate.cli.main", "train", *map(str, arguments)]
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


def kill(experiment: Experiment, kills: int, rng: np.random.Generator, folder: Path) -> list[str]:
    """Train once alone and once with this many kills; return the files that differ."""
    config = folder / "experiment.toml"
    config.write_text(dumps_toml(experiment))
    status, said = finish(start(folder, "--config", config, "--seed", 3, "--out", folder / "alone"))
    assert status == 0, said
    run, left, at = folder / "killed", kills, []
    while left:
        resumes = (run / CONFIG).exists()
        given = ("--resume", run) if resumes else ("--config", config, "--seed", 3, "--out", run)
        process = start(folder, *given)
        # A short process spends most of its time starting: three of four kills wait for its first validation.
        if rng.random() < 0.25:
            time.sleep(rng.uniform(0, 4.0))
        else:
            await_checks(process, run, checks(run) + int(rng.integers(1, 6)))
            time.sleep(rng.uniform(0, 0.3))
        if process.poll() is not None:
            break
        process.send_signal(signal.SIGKILL)
        process.communicate()
        at.append(checks(run))
        left -= 1
    print(f"{type(experiment.training).__name__}: killed {len(at)} times, after these numbers of checks: {at}")
    assert (run / CONFIG).exists(), "killed too early every time"
    status, said = finish(start(folder, "--resume", run))
    assert status == 0, said
    return differences(folder / "alone", run) + [f"only {len(at)} kills"] * (len(at) < kills)


def main() -> int:
    """Kill trainings of both learners; return the exit status."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kills", type=int, default=20)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    bad = 0
    for short in (MODEL, ACTOR_CRITIC):
        experiment = replace(short, training=replace(short.training, epochs=1500))
        with tempfile.TemporaryDirectory() as folder:
            found = kill(experiment, given.kills, np.random.default_rng(given.seed), Path(folder))
        print(f"{type(experiment.training).__name__}: {', '.join(found) or 'every file as of a training left alone'}")
        bad += bool(found)
    return min(bad, 1)


if __name__ == "__main__":
    sys.exit(main())
