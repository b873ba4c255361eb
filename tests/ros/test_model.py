"""Policies of a node: the ONNX file decides as the run folder, and holds the scenario."""

import json

import numpy as np
import pytest

import foveate
from foveate.deploy.belief import Belief
from foveate.deploy.onnx.export import export, metadata_of, state_names
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.resolve import load
from foveate.ros.model import RobotModel, load_model
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings
from foveate.scenario.target import LinearTarget

pytest.importorskip("onnxruntime", reason="ONNX files need the extra onnx")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "policy.onnx"
    experiment, policy, _ = load("pan")
    export(experiment, policy, path)
    return path


@pytest.mark.slow  # compiles the policy for 64 targets
def test_a_file_decides_as_the_policy_in_jax(file):
    by_file, by_jax = load_model(str(file)), load_model("pan")
    assert by_file.scenario == by_jax.scenario == PRESETS["pan"].scenario
    assert by_file.axes == by_jax.axes == ("wz",)
    rng = np.random.default_rng(0)
    for n in (0, 1, 5):
        mean, root = rng.normal(0, 4, (n, 4)), rng.normal(0, 0.5, (n, 4, 4))
        belief = Belief(mean, covariance=root @ root.swapaxes(1, 2) + 0.05 * np.eye(4))
        pose = rng.normal(0, 1, 3)
        np.testing.assert_allclose(by_file.decide(belief, pose), by_jax.decide(belief, pose), atol=1e-5)
        np.testing.assert_allclose(by_file.decide(belief, pose), foveate.load("pan")(belief, pose), atol=1e-5)


def test_a_file_says_what_the_robot_is():
    facts = metadata_of(PRESETS["quadrotor"], ())
    scenario = json.loads(facts["scenario"])
    assert scenario["view"]["depth_m"] == PRESETS["quadrotor"].scenario.view.depth_m
    assert json.loads(facts["state"]) == ["x", "y", "z", "vx", "vy", "vz"]
    assert state_names(PRESETS["paper"].scenario) == ["x", "y"]
    eye, nothing = ((1.0, 0.0), (0.0, 1.0)), ((0.0,), (0.0,))
    linear = LinearTarget(A=eye, B=nothing, W=eye, Z=eye, prior=eye)
    scenes = SceneSettings(drift_m_s=(0.0, 0.0), jitter_m_s=0.0)
    assert state_names(Scenario(target=linear, scenes=scenes)) is None


@pytest.mark.slow  # exports a policy
def test_other_files_are_rejected(tmp_path, file):
    onnx = pytest.importorskip("onnx")
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"broken\.onnx: is no ONNX file"):
        load_model(str(broken))
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 1  # among the weights
    broken.write_bytes(data)
    with pytest.raises(InputError, match=r"broken\.onnx: is damaged or was changed"):
        load_model(str(broken))
    old = onnx.load(str(file))
    kept = [each for each in old.metadata_props if each.key != "scenario"]
    del old.metadata_props[:]
    old.metadata_props.extend(kept)
    onnx.save(old, str(tmp_path / "old.onnx"))
    with pytest.raises(InputError, match=r"old\.onnx: has no scenario in it: expected a file of foveate export"):
        load_model(str(tmp_path / "old.onnx"))


@pytest.mark.slow
def test_what_a_node_cannot_run_is_said(file):
    pan = PRESETS["pan"].scenario
    decide = lambda belief, pose: np.zeros(1)  # noqa: E731
    scheduled = Scenario(schedule=ScheduleSettings(tau_s=(1.0, 2.0)))
    with pytest.raises(InputError, match="has a schedule: a node runs at one period"):
        RobotModel(name="x", scenario=scheduled, axes=("vx",), decide=decide)
    with pytest.raises(InputError, match="axes"):
        RobotModel(name="x", scenario=pan, axes=("roll",), decide=decide)
    with pytest.raises(InputError, match="no such run folder or file, and no preset"):
        load_model("nothing")
    assert Experiment(scenario=pan).scenario == load_model(str(file)).scenario


@pytest.mark.slow  # compiles the policy for 64 targets
def test_a_node_is_one_of_the_robots_of_a_team(tmp_path):
    """Of a team of different robots the number says which: limits, view and noise are its own."""
    path = tmp_path / "team.toml"
    path.write_text(
        "[scenario.team]\nagents = 2\n[[scenario.team.robots]]\n"
        "[[scenario.team.robots]]\nagent = { v_max_m_s = 0.5 }\nsensor = { std_m = 0.7 }\n"
    )
    first, second = (load_model(f"any@{path}", number) for number in (0, 1))
    assert second.scenario.sensor.std_m == 0.7
    ahead = Belief(np.array([[9.0, 0.0]]), covariance=np.eye(2)[None])
    np.testing.assert_allclose([each.decide(ahead, np.zeros(3))[0] for each in (first, second)], [4.0, 0.5], atol=1e-3)
    with pytest.raises(InputError, match="robot = 2: expected 0 to 1"):
        load_model(f"any@{path}", 2)
    with pytest.raises(InputError, match="number: is missing: expected that of this robot in its team"):
        load_model(f"any@{path}")
