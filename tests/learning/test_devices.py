"""Batches sharded over devices and processes, and a lost process, each in processes of their own."""

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

from foveate.cli.main import main
from foveate.experiment.checkpoint import VERSION, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import TrainingSettings
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS
from foveate.io.npz import load_arrays
from foveate.learning import devices
from foveate.learning.devices import Share, schedule
from foveate.learning.loop import train
from foveate.learning.policy_gradient import shares
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

TINY = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=4)),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)),
    training=TrainingSettings(epochs=20, episodes=11, held_out=4, check_every=20, micro_batch=2),
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
    command = ["train", "--config", str(folder / CONFIG), "--out", str(folder / "run"), "--no-verdict", *options]
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


@pytest.fixture
def alone(monkeypatch):
    """One device, whatever this process has."""
    monkeypatch.setattr(jax, "device_count", lambda: 1)


@pytest.mark.slow
@pytest.mark.exhaustive
@pytest.mark.usefixtures("alone")
def test_eight_devices_equal_one_bit_for_bit(tmp_path):
    """Two devices are compared in this process below."""
    eight = "--xla_force_host_platform_device_count=8"
    with started(TINY, tmp_path / "eight", flags=eight) as process:
        precisions = []
        train(
            TINY,
            tmp_path / "one",
            on_validation=lambda check, total: precisions.append(jax.config.jax_default_matmul_precision),
        )
        assert precisions == ["highest"], "on an accelerator, too"
        _, complaint = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, complaint
    epoch, learned = arrays(tmp_path / "eight" / "run")
    assert epoch == 20
    for name, array in arrays(tmp_path / "one")[1].items():
        np.testing.assert_array_equal(learned[name], array, err_msg=name)


CROWD = """
import hashlib
import jax
from foveate.learning.loop import advance_of
from foveate.learning.policy_gradient import begin
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario, SceneSettings
from foveate.experiment.presets import Experiment, TrainingSettings

crowd = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=40, targets_max=40, steps=3)),
    training=TrainingSettings(episodes=32),
)
problem = crowd.scenario.problem()
learner = begin(crowd.policy.policy(problem, jax.random.key(0)), crowd.training)
policy = advance_of(crowd)(jax.numpy.array(3), learner, jax.random.key(1))[0].policy
print(hashlib.md5(b"".join(x.tobytes() for x in jax.tree.leaves(jax.device_get(policy)))).hexdigest())
"""


@pytest.mark.slow
def test_two_devices_of_this_process_equal_one_bit_for_bit(tmp_path, monkeypatch):
    train(TINY, tmp_path / "two")
    assert schedule(shares(TINY.training, TINY.scenario.scenes)).devices == 2
    monkeypatch.setattr(jax, "device_count", lambda: 1)
    train(TINY, tmp_path / "one")
    assert (tmp_path / "two" / BEST).read_bytes() == (tmp_path / "one" / BEST).read_bytes()


@pytest.mark.slow
@pytest.mark.exhaustive
def test_many_targets_on_one_thread_and_on_sixteen_come_out_the_same(tmp_path):
    """XLA cuts long products up by the number of cores, which NPROC tells it; micro-batches are too small for that
    (all 32 episodes at once would not be)."""
    places = {"JAX_NUM_CPU_DEVICES": "1", "JAX_ENABLE_X64": "0"}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", CROWD],
            env={**os.environ, **places, "NPROC": n, "JAX_COMPILATION_CACHE_DIR": str(tmp_path / n)},
            stdout=subprocess.PIPE,
            text=True,
        )
        for n in ("1", "16")
    ]
    one, sixteen = (process.communicate(timeout=PATIENCE_S)[0] for process in processes)
    assert one == sixteen != ""


def counts(plan):
    """For each share, how many micro-batches each device has; every one is worked on once."""
    for parts, lanes in zip(plan.parts, plan.lanes, strict=True):
        assert sorted(part for own in parts for part in own) == list(range(len(lanes)))
    return [[len(own) for own in parts] for parts in plan.parts]


def test_a_batch_is_sharded_evenly(monkeypatch):
    """On cores by micro-batches of one size, whatever there are of the former; on other devices by these."""
    monkeypatch.setattr(jax, "device_count", lambda: 8)
    plan = schedule([Share(60, 32)])
    assert (plan.devices, plan.sizes, counts(plan)) == (2, (30,), [[1, 1]])
    plan = schedule([Share(1024, 32)])
    assert (plan.devices, plan.sizes, counts(plan)) == (8, (32,), [[4] * 8])
    monkeypatch.setattr(jax, "device_count", lambda: 3)
    assert counts(schedule([Share(1024, 32)])) == [[11, 11, 10]]
    monkeypatch.setattr(jax, "process_count", lambda: 3)
    plan = schedule([Share(100, 32)])
    assert (plan.devices, plan.sizes, counts(plan)) == (3, (17,), [[2, 2, 2]])
    monkeypatch.setattr(jax, "process_count", lambda: 1)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(jax, "device_count", lambda: 8)
    plan = schedule([Share(140_000, 16_384)])
    assert (plan.devices, plan.sizes, counts(plan)) == (8, (8_750,), [[2] * 8])


def test_shares_of_several_shapes_are_balanced_by_their_cost(monkeypatch):
    """Lanes, and so sums, are the same on any number of cores; a lane is added up on one device."""
    some = [Share(40, 64, 108.0), Share(20, 48, 192.0)]
    monkeypatch.setattr(jax, "device_count", lambda: 2)
    assert sorted(map(tuple, counts(schedule(some)))) == [(0, 1), (1, 0)]
    some = [Share(510, 7, 75.0), Share(340, 5, 147.0), Share(174, 4, 192.0)]
    plans = []
    for count in (1, 2, 5):
        monkeypatch.setattr(jax, "device_count", lambda count=count: count)
        plan = schedule(some)
        plans.append((plan.sizes, plan.lanes))
        work, homes = np.zeros(count), [set() for _ in range(plan.lane_count)]
        for share, size, parts, lanes in zip(some, plan.sizes, plan.parts, plan.lanes, strict=True):
            for device, own in enumerate(parts):
                work[device] += len(own) * size * share.cost
                for part in own:
                    homes[lanes[part]].add(device)
        assert work.max() < 1.05 * work.mean()
        assert plan.devices == count
        assert [len(home) for home in homes] == [1] * devices.MAX_LANES
    assert plans[0] == plans[1] == plans[2]


def test_a_quota_of_cores_counts(monkeypatch, tmp_path):
    monkeypatch.setattr(devices.os, "sched_getaffinity", lambda process: set(range(64)), raising=False)
    monkeypatch.setattr(devices, "QUOTA", tmp_path / "cpu.max")
    assert devices.cores() == 64
    for quota, expected in (("max 100000", 64), ("200000 100000", 2), ("50000 100000", 1)):
        (tmp_path / "cpu.max").write_text(quota + "\n")
        assert devices.cores() == expected


def test_an_unreachable_cluster_is_named(monkeypatch):
    """Whoever does not answer, or is no address; and with auto the cluster is asked, with no numbers."""
    asked = []
    monkeypatch.setattr(devices.jax.config, "update", lambda *setting: asked.append(setting))
    monkeypatch.setattr(devices.jax.distributed, "initialize", lambda **given: asked.append(given))
    devices.join("auto", None, None)
    devices.join("10.0.0.1:12", 3, 2)
    assert asked[0] == asked[2] == ("jax_num_cpu_devices", 1)
    assert "coordinator_address" not in asked[1]
    named = {"coordinator_address": "10.0.0.1:12", "num_processes": 3, "process_id": 2}
    assert named.items() <= asked[3].items()

    def silent(**given):
        raise RuntimeError("DEADLINE_EXCEEDED\nand much more")

    monkeypatch.setattr(devices.jax.distributed, "initialize", silent)
    with pytest.raises(ValueError, match=r"--coordinator b:1: DEADLINE_EXCEEDED$"):
        devices.join("b:1", 2, 0)


def test_only_the_first_process_writes_the_run_folder(monkeypatch, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "old").write_text("x")
    with devices.folder_of_this_process(tmp_path / "run", resume=True) as folder:
        assert folder == tmp_path / "run"
    monkeypatch.setattr(jax, "process_index", lambda: 1)
    for resume in (True, False):
        with devices.folder_of_this_process(tmp_path / "run", resume) as folder:
            assert folder.name == "run"
            assert folder.parent != tmp_path
            assert (folder / "old").exists() == resume
        assert not folder.exists()


def test_processes_use_the_values_of_the_first(monkeypatch):
    numbers = (0.1, -3.0, float("inf"))
    assert devices.from_first_process(*numbers) == numbers
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    monkeypatch.setattr(devices.multihost_utils, "broadcast_one_to_all", lambda value: value)
    assert devices.from_first_process(*numbers) == numbers, "bit for bit, in float32 too"


def test_a_device_failure_is_a_lost_process_only_among_several_processes(monkeypatch):
    def fails(*arguments):
        raise jax.errors.JaxRuntimeError("UNAVAILABLE: gone\nand much more")

    run = devices.on_all_devices(fails, 2)
    with pytest.raises(jax.errors.JaxRuntimeError, match="UNAVAILABLE"):
        run(np.zeros(2))
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    with pytest.raises(devices.ProcessLost, match=r"another process of this training was lost: UNAVAILABLE: gone$"):
        run(np.zeros(2))


@pytest.mark.slow
def test_cores_are_devices_by_default():
    """In processes of their own: JAX looks once."""
    code = "from foveate.learning.devices import use_cores; use_cores(); import jax; print(jax.device_count())"
    for places, expected in (
        ({"XLA_FLAGS": "", "JAX_NUM_CPU_DEVICES": ""}, devices.cores()),
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=3", "JAX_NUM_CPU_DEVICES": ""}, 3),
        ({"XLA_FLAGS": "", "JAX_NUM_CPU_DEVICES": "5"}, 5),
    ):
        own = {name: value for name, value in {**os.environ, **places, "JAX_PLATFORMS": "cpu"}.items() if value}
        done = subprocess.run([sys.executable, "-c", code], env=own, capture_output=True, text=True, check=True)
        assert int(done.stdout) == expected


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.mark.slow
@pytest.mark.exhaustive
@pytest.mark.usefixtures("alone")
def test_two_processes_equal_one_until_one_is_lost(tmp_path):
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
    assert "resume with  foveate train --resume" in complaint
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
def test_invalid_device_options_are_rejected(options, words, capsys, tmp_path):
    assert main(["train", "--out", str(tmp_path / "run"), *options]) == 2
    assert words in capsys.readouterr().err
