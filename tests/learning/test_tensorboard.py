"""TensorBoard events, read back by tensorboardX's protocol buffers; and no torch, which that library would import."""

import importlib.util
import math
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from foveate.experiment.checkpoint import write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import TrainingSettings
from foveate.experiment.run_folder import CONFIG
from foveate.learning.tensorboard import Events
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

NUMBERS = {"held_out": 6.25, "train/loss": -0.1, "norm": 1e39}


def read(path: Path) -> list:
    """The events of a file, with their checksums checked."""
    pytest.importorskip("tensorboardX")
    from tensorboardX.proto.event_pb2 import Event
    from tensorboardX.record_writer import masked_crc32c

    data, events = path.read_bytes(), []
    while data:
        (length,) = struct.unpack("<Q", data[:8])
        content = data[12 : 12 + length]
        assert struct.unpack("<I", data[8:12])[0] == masked_crc32c(data[:8])
        assert struct.unpack("<I", data[12 + length : 16 + length])[0] == masked_crc32c(content)
        events.append(Event.FromString(content))
        data = data[16 + length :]
    return events


def test_another_library_reads_the_same_numbers(tmp_path):
    with Events(tmp_path) as events:
        events.add(NUMBERS, step=7)
        events.add({"held_out": 1.0}, step=123_456)
    (path,) = tmp_path.iterdir()
    first, *rest = read(path)
    assert first.file_version == "brain.Event:2"
    scalars = [(event.step, event.summary.value[0].tag, event.summary.value[0].simple_value) for event in rest]
    assert scalars == [
        (7, "held_out", 6.25),
        (7, "train/loss", pytest.approx(-0.1)),
        (7, "norm", math.inf),
        (123_456, "held_out", 1.0),
    ]
    times = [event.wall_time for event in (first, *rest)]
    assert times == sorted(times)
    assert abs(times[-1] - path.stat().st_mtime) < 60


def test_a_resumed_training_purges_what_was_after_its_step(tmp_path):
    with Events(tmp_path):
        pass
    with Events(tmp_path, purge_step=51) as events:
        events.add({"held_out": 2.0}, step=100)
    first, second = sorted(tmp_path.iterdir())
    assert len(read(first)) == 1
    from tensorboardX.proto.event_pb2 import SessionLog

    _, version, restart, scalar = read(second)
    assert (version.step, version.file_version) == (51, "brain.Event:2")
    assert (restart.step, restart.session_log.status) == (51, SessionLog.START)
    assert scalar.step == 100


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux")
def test_a_full_disk_is_an_error(tmp_path):
    events = Events(tmp_path)
    events._file.close()
    events._file = open("/dev/full", "wb")  # noqa: SIM115
    with pytest.raises(OSError, match="No space left"):
        events.add(NUMBERS, step=1)
    with pytest.raises(OSError, match="No space left"):
        events._file.close()


TRAIN = """
import sys
from foveate.cli.main import main
assert main(sys.argv[1:]) == 0
print(sorted({name.partition(".")[0] for name in sys.modules} & {"torch", "tensorboardX", "tensorflow"}))
"""


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs the extra ppo")
def test_a_training_imports_no_torch(tmp_path):
    tiny = Experiment(
        scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=1, steps=2)),
        policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)),
        training=TrainingSettings(epochs=2, episodes=2, held_out=2, check_every=1),
    )
    write_config(tmp_path, tiny)
    command = ["train", "--config", str(tmp_path / CONFIG), "--out", str(tmp_path / "run"), "--no-verdict"]
    done = subprocess.run([sys.executable, "-c", TRAIN, *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"
    assert list((tmp_path / "run").glob("events.out.tfevents.*")), "events were written all the same"
