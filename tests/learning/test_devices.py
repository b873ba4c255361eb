"""Batches shared out over devices and processes, and a process that is lost, each in processes of their own."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from foveate.arrays import load_arrays
from foveate.checkpoint import CONFIG, LAST, VERSION, write_config
from foveate.cli.main import main
from foveate.learning.judging import METRICS
from foveate.learning.training import train
from foveate.policies.attention import AttentionSettings
from foveate.scenario import Scenario, SceneSettings
from foveate.settings import Experiment, TrainingSettings

TINY = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=4)),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)),
    training=TrainingSettings(epochs=20, episodes=11, held_out=4, check_every=20, together=2),
)
"""11 episodes, 2 at once: neither 8 devices nor 2 processes share them evenly."""
PATIENCE_S = 240


def arrays(run: Path) -> tuple[int, dict[str, np.ndarray]]:
    header, found = load_arrays(run / LAST, "training", VERSION)
    return header["facts"]["epoch"], {k: v for k, v in found.items() if k.startswith("learner.policy")}


@contextlib.contextmanager
def started(experiment: Experiment, folder: Path, *options: str, flags: str = ""):
    """`foveate train` in a process of its own, in float64 as these tests are."""
    folder.mkdir(exist_ok=True)
    write_config(folder, experiment)
    command = ["train", "--config", str(folder / CONFIG), "--out", str(folder / "run"), *options]
    places = {"JAX_ENABLE_X64": "1", "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flags}"}
    process = subprocess.Popen(
        [sys.executable, "-m", "foveate.cli.main", *command],
        env={**os.environ, **places},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_allclose(one[name], other[name], rtol=1e-6, atol=1e-8, err_msg=name)


def test_eight_devices_learn_what_one_does_bit_for_bit(tmp_path):
    eight = "--xla_force_host_platform_device_count=8"
    with started(TINY, tmp_path / "eight", flags=eight) as process:
        precisions = []
        train(
            TINY,
            tmp_path / "one",
            report=lambda check, total: precisions.append(jax.config.jax_default_matmul_precision),
        )
        assert precisions == ["highest"], "on an accelerator, too"
        _, complaint = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, complaint
    epoch, learned = arrays(tmp_path / "eight" / "run")
    assert epoch == 20
    for name, array in arrays(tmp_path / "one")[1].items():
        np.testing.assert_array_equal(learned[name], array, err_msg=name)


def test_cores_are_devices_where_nobody_has_said_otherwise():
    """In processes of their own: JAX looks once."""
    code = "from foveate.learning.devices import use_cores; use_cores(); import jax; print(jax.device_count())"
    cores = len(os.sched_getaffinity(0))
    for places, expected in (
        ({"XLA_FLAGS": "", "JAX_NUM_CPU_DEVICES": ""}, cores),
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=3", "JAX_NUM_CPU_DEVICES": ""}, 3),
        ({"XLA_FLAGS": "", "JAX_NUM_CPU_DEVICES": "5"}, 5),
    ):
        own = {name: value for name, value in {**os.environ, **places}.items() if value}
        done = subprocess.run([sys.executable, "-c", code], env=own, capture_output=True, text=True, check=True)
        assert int(done.stdout) == expected


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def test_two_processes_learn_what_one_does_until_one_is_lost(tmp_path):
    """The first writes; when the second is killed it says so, and its last checkpoint is whole."""
    endless = replace(TINY, training=replace(TINY.training, epochs=1_000_000))
    place = ["--coordinator", f"127.0.0.1:{free_port()}", "--processes", "2", "--process-id"]
    run = tmp_path / "both" / "run"
    with (
        started(endless, tmp_path / "both", *place, "0") as first,
        started(endless, tmp_path / "both", *place, "1") as second,
    ):
        until = time.monotonic() + PATIENCE_S
        while not ((run / METRICS).exists() and (run / METRICS).read_text()):
            assert time.monotonic() < until
            assert first.poll() is None, first.communicate()
            assert second.poll() is None, second.communicate()
            time.sleep(0.02)
        second.send_signal(signal.SIGKILL)
        _, complaint = first.communicate(timeout=PATIENCE_S)
    assert first.returncode == 1
    assert "another process of this training was lost" in complaint
    assert "Traceback" not in complaint
    assert "go on with  foveate train --resume" in complaint
    epoch, learned = arrays(run)
    assert epoch >= 20
    assert json.loads((run / METRICS).read_text().splitlines()[-1])["epoch"] == epoch
    one = replace(endless, training=replace(TINY.training, epochs=epoch))
    train(one, tmp_path / "one")
    same(arrays(tmp_path / "one")[1], learned)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--processes", "2"], "expected --coordinator HOST:PORT"),
        (["--coordinator", "a:1", "--processes", "2"], "expected --processes N and --process-id I"),
        (["--coordinator", "a:1", "--processes", "2", "--process-id", "2"], "--process-id 2: expected from 0 to 1"),
        (["--preset", "best", "--remat", "--epochs", "1"], "expected a training by the policy gradient"),
        (["--window", "0", "--epochs", "1"], "window = 0: expected >= 1"),
    ],
)
def test_what_cannot_be_is_refused(options, words, capsys, tmp_path):
    assert main(["train", "--out", str(tmp_path / "run"), *options]) == 2
    assert words in capsys.readouterr().err
