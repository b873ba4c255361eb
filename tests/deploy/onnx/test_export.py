"""Exported policies against the JAX ones, which have oracles of their own; run by the real onnxruntime."""

import functools
import hashlib
import json
import re
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from helpers.commands import failure
from scipy.spatial.transform import Rotation

import foveate
from foveate.cli.main import main
from foveate.deploy.onnx.export import OPSETS, export, inputs_of, metadata_of, to_onnx
from foveate.errors import InputError
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PAN, PAN_TILT, QUADROTOR
from foveate.experiment.run_folder import BEST
from foveate.models.robot import Robot
from foveate.planning.named import heuristic_policy
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import PointerPolicy
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import BallView, PolygonView, SectorView
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import StaticTarget, VelocityTarget
from foveate.simulation.records import Observation

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
onnx = pytest.importorskip("onnx", reason="needs the extra onnx")

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "deploy.md"
EXAMPLE = ROOT / "examples" / "run_onnx.py"
COUNT, MOST = 300, 64
DEEPER = AttentionSettings(agent_widths=(64,), target_widths=(64, 64, 64), out_widths=(64, 64), information="asinh")
COMMANDS = ((0.0, -1.0), (0.0, 1.0), (2.0, 0.0), (4.0, -0.5), (4.0, 0.5))
POINTER = PointerSettings(kind="pointer")
SCENES = SceneSettings(initial_error="consistent")
STILL = replace(SCENES, drift_m_s=(0.0, 0.0))
CORNERS = ((0.2, -0.3), (3.0, -1.0), (3.5, 0.5), (2.0, 2.0), (0.2, 0.3))
ODD_CAMERA = Scenario(
    tau_s=0.5,
    agent=DifferentialDrive(v_min_m_s=-1.0),
    view=PolygonView(shape="polygon", vertices_m=CORNERS),
    sensor=SensorSettings(
        V=((0.04, 0.01), (0.01, 0.09)), frame="body", range_growth_per_m=0.1, missed_detections="used"
    ),
    target=VelocityTarget(kind="constant_velocity", memory_s=10.0),
    scenes=SCENES,
)
CHANGING = Scenario(
    schedule=ScheduleSettings(tau_s=(0.5, 1.0), V=(((0.04, 0.0), (0.0, 0.04)), ((0.09, 0.0), (0.0, 0.01)))),
    scenes=SCENES,
)
BORDERS = Scenario(
    agent=DifferentialDrive(commands=COMMANDS),
    view=SectorView(shape="sector", depth_m=5.0, angle_deg=200.0),
    region=RegionSettings(low_m=(-25.0, -20.0), high_m=(25.0, 30.0)),
)
ALL_ROUND = Scenario(
    target=StaticTarget(kind="static"),
    view=BallView(shape="ball", radius_m=3.0, center_m=(1.0, 0.5)),
    scenes=STILL,
)
RANGE_BEARING = SensorSettings(measures="range-bearing", std_range_m=0.2, std_bearing_rad=0.05, range_growth_per_m=0.1)
CASES = {
    "attention, body": Experiment(),
    "attention, world": Experiment(policy=AttentionSettings(frame="world")),
    "attention, body, in space": Experiment(scenario=QUADROTOR, policy=replace(DEEPER, length_m=6.0)),
    "attention, world, in space": Experiment(scenario=QUADROTOR, policy=replace(DEEPER, frame="world")),
    "pointer": Experiment(policy=POINTER),
    "commands, region, one mode": Experiment(scenario=BORDERS, policy=replace(POINTER, modes=1)),
    "pointer, in space": Experiment(scenario=QUADROTOR, policy=POINTER),
    "window": Experiment(policy=replace(POINTER, dynamic_window=True)),
    "clipped": Experiment(policy=replace(POINTER, clips_features=True)),
    "window, in space": Experiment(scenario=QUADROTOR, policy=replace(POINTER, dynamic_window=True)),
    "camera that turns": Experiment(scenario=PAN, policy=POINTER),
    "camera that turns, in space": Experiment(scenario=PAN_TILT, policy=POINTER),
    "polygon, noise": Experiment(scenario=ODD_CAMERA, policy=replace(POINTER, tells_time=False)),
    "schedule, three modes": Experiment(scenario=CHANGING, policy=replace(POINTER, modes=3)),
    "range and bearing": Experiment(scenario=Scenario(sensor=RANGE_BEARING, scenes=SCENES), policy=POINTER),
    "disc, targets at rest": Experiment(scenario=ALL_ROUND, policy=POINTER),
}
GAINS = {
    "attention, body": 0.6,
    "attention, world": 0.6,
    "attention, body, in space": 1.1,
    "attention, world, in space": 0.8,
}
"""Scales of weights with which decisions differ and are not all extreme, where that is not 1."""
QUICK = ("attention, body", "attention, body, in space", "pointer")
COMBINED = ("attention, world", "pointer, in space", "camera that turns", "window, in space")
"""Cases of which each part is in another case."""
TIERED = [
    pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK) + [pytest.mark.exhaustive] * (name in COMBINED))
    for name in CASES
]


def strong(experiment):
    """A policy in float32 whose decisions differ from belief to belief."""
    problem, rng = experiment.scenario.problem(), np.random.default_rng(6)
    shapes = eqx.filter_eval_shape(lambda: experiment.policy.policy(problem, jax.random.key(0)))
    gain = GAINS.get(next(name for name, case in CASES.items() if case == experiment), 1.0)
    return jax.tree.map(lambda x: jnp.asarray(rng.normal(0, gain * x.shape[-1] ** -0.5, x.shape), jnp.float32), shapes)


def beliefs(experiment, count=COUNT, most=MOST, seed=0):
    """Random poses and beliefs, of none to `most` targets, padded with what must not matter; any rotation in space.

    Deviations are those of the paper's filter: 0.1 m in view for long, 1.5 m not yet seen. Were beliefs much surer,
    rounding in float32 would come to more than 1e-5, in JAX too.
    """
    problem, rng = experiment.scenario.problem(), np.random.default_rng(seed)
    n_y = problem.motion.state_size
    pose = rng.uniform(-10, 10, (count, 3))
    if problem.agent.space.dimension == 3:
        position, pose = pose, np.tile(np.eye(4), (count, 1, 1))
        pose[:, :3, :3], pose[:, :3, 3] = Rotation.random(count, rng=seed).as_matrix(), position
        small = Rotation.from_rotvec(rng.normal(0, 1, (10, 3)) * np.logspace(-8, 0, 10)[:, None])
        pose[:10, :3, :3] = small.as_matrix()
    deviation = rng.uniform(0.1, 1.5, (count, most, n_y))
    turn = np.linalg.qr(rng.normal(size=(count, most, n_y, n_y)))[0]
    information = np.einsum("bnij,bnj,bnkj->bnik", turn, deviation**-2, turn)
    numbers = rng.integers(1, most + 1, count)
    numbers[:3] = 0
    return {
        "pose": pose.astype(np.float32),
        "mean": rng.uniform(-10, 10, (count, most, n_y)).astype(np.float32),
        "information": information.astype(np.float32),
        "present": np.arange(most) < numbers[:, None],
        "known_input": rng.normal(size=(count, most, problem.motion.input_size)).astype(np.float32),
        "steps_left": rng.integers(-2, 60, count),
        "step": rng.integers(0, 60, count),
    }


@eqx.filter_jit
def decided(problem, policy, arrays):
    """Commands of the JAX policy, one decision after the other, and which rounding decides between two modes."""

    def one(now):
        robot = Robot.of(problem).at(now["step"])
        names = ("step", "steps_left", "pose", "mean", "information", "present", "known_input")
        seen = Observation(*(now[name] for name in names), robot)
        tied = False
        if isinstance(policy, PointerPolicy):
            first, second = jax.lax.top_k(policy.modes(policy.tokens(seen)).log_weight, 2)[0]
            tied = first - second < 1e-5
        return problem.agent.control(policy(seen, (), jax.random.key(0))[0]), tied

    return jax.lax.map(one, arrays, batch_size=100)


@functools.cache
def exported(name):
    """The model of a case, translated once for all tests."""
    return to_onnx(CASES[name], strong(CASES[name]))


def session(model):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(model.SerializeToString(), options)


def run(live, arrays):
    return live.run(None, {each.name: arrays[each.name] for each in live.get_inputs()})[0]


@pytest.mark.parametrize("name", TIERED)
def test_decides_as_the_jax_policy(name):
    """300 beliefs in one batch with padding, and one by one with as many targets as there are."""
    experiment = CASES[name]
    problem, policy = experiment.scenario.problem(), strong(experiment)
    arrays, live = beliefs(experiment), session(exported(name))
    single = jax.tree.map(lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, problem)
    with jax.enable_x64(False):
        expected, tied = map(np.asarray, decided(single, policy, arrays))
    assert tied.mean() < 0.02, "processors round differently; where that decides, there is nothing to compare"
    assert expected.dtype == np.float32
    reach = np.asarray(problem.agent.upper - problem.agent.lower)
    assert (np.ptp(expected, axis=0) > 0.1 * reach).all(), "decisions must differ, or nothing was compared"
    np.testing.assert_allclose(run(live, arrays)[~tied], expected[~tied], rtol=0, atol=2e-5)
    alone = []
    for i, here in enumerate(arrays["present"]):
        whole = ("pose", "steps_left", "step")
        cut = {key: x[i : i + 1] if key in whole else x[i : i + 1, here] for key, x in arrays.items()}
        alone.append(run(live, cut)[0])
    np.testing.assert_allclose(np.array(alone)[~tied], expected[~tied], rtol=0, atol=1e-5)
    assert (np.array(alone) >= np.asarray(single.agent.lower)).all()
    assert (np.array(alone) <= np.asarray(single.agent.upper)).all()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scenario"), [("window", "paper"), ("price", "quadrotor"), ("uncertain", "pan")])
def test_heuristics_have_files_too(name, scenario, tmp_path):
    """Those without a memory; the window's loops over its periods follow each other in the file."""
    heuristic = foveate.heuristic(name, scenario)
    heuristic.export(tmp_path / "policy.onnx")
    arrays = beliefs(heuristic.experiment, 60, 6)
    single = jax.tree.map(lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, heuristic.problem)
    with jax.enable_x64(False):
        network = heuristic_policy(name, single, float(heuristic.scenario.view.depth_m))
        expected = np.asarray(decided(single, network, arrays)[0])
    found = run(onnxruntime.InferenceSession(tmp_path / "policy.onnx"), arrays)
    assert (np.ptp(expected, axis=0) > 0.1).all()
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)
    belief = foveate.Belief(arrays["mean"][9], information=arrays["information"][9], present=arrays["present"][9])
    loaded = foveate.load(tmp_path / "policy.onnx")
    np.testing.assert_allclose(loaded(belief, arrays["pose"][9]), heuristic(belief, arrays["pose"][9]), atol=2e-5)
    with pytest.raises(InputError, match="reads the map: expected a scenario without obstacles"):
        foveate.heuristic(name, "rooms").export(tmp_path / "rooms.onnx")
    with pytest.raises(InputError, match="a memory"):
        foveate.heuristic("lawnmower", scenario).export(tmp_path / "lawnmower.onnx")


def test_values_in_padding_do_not_matter():
    """Not a number included: a robot's command must not become one."""
    experiment = CASES["pointer"]
    live, arrays = session(exported("pointer")), beliefs(experiment, 20, 6)
    expected = run(live, arrays)
    for key in ("mean", "information", "known_input"):
        arrays[key][~arrays["present"]] = np.nan
    assert np.array_equal(run(live, arrays), expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("opset", "name"),
    [
        (OPSETS[0], "attention, world, in space"),
        (OPSETS[0], "camera that turns, in space"),
        (OPSETS[-1], "camera that turns, in space"),
    ],
)
def test_every_opset_computes_the_same(name, opset):
    experiment = CASES[name]
    policy, arrays = strong(experiment), beliefs(experiment, 20, 6)
    model = to_onnx(experiment, policy, opset)
    assert model.opset_import[0].version == opset
    np.testing.assert_allclose(run(session(model), arrays), run(session(exported(name)), arrays), rtol=0, atol=1e-6)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run folder and its exported policy."""
    experiment = CASES["pointer"]
    folder = tmp_path_factory.mktemp("runs")
    (folder / "run" / "checkpoint").mkdir(parents=True)
    write_config(folder / "run", experiment)
    save_tree(folder / "run" / BEST, strong(experiment), experiment, "policy", {})
    assert main(["export", str(folder / "run"), str(folder / "policy.onnx")]) == 0
    return folder / "run", folder / "policy.onnx"


def test_metadata_name_inputs_and_outputs(trained):
    facts = onnxruntime.InferenceSession(trained[1]).get_modelmeta().custom_metadata_map
    assert (facts["format"], facts["format_version"], facts["policy"]) == ("foveate-policy", "1", "pointer")
    assert json.loads(facts["tau_s"]) == 1.0
    output = json.loads(facts["output"])
    assert (output["axes"], output["units"], output["frame"]) == (["vx", "wz"], ["m/s", "rad/s"], "body")
    np.testing.assert_allclose([output["lower"], output["upper"]], [[0, -np.pi / 3], [4, np.pi / 3]], atol=1e-7)
    assert "commands" not in output
    stepped = json.loads(metadata_of(CASES["commands, region, one mode"], ())["output"])
    np.testing.assert_allclose(stepped["commands"], COMMANDS, atol=1e-7)
    graph = onnx.load(trained[1]).graph
    names = [each["name"] for each in json.loads(facts["inputs"])]
    assert names == [each.name for each in graph.input]
    assert names == ["pose", "mean", "information", "present", "known_input", "steps_left"]
    shapes = {
        each.name: [axis.dim_param or axis.dim_value for axis in each.type.tensor_type.shape.dim]
        for each in graph.input
    }
    assert shapes == {each["name"]: each["shape"] for each in json.loads(facts["inputs"])}
    assert shapes["information"] == ["b", "n", 2, 2]


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("attention, body", []),
        ("disc, targets at rest", ["steps_left"]),
        ("polygon, noise", ["known_input"]),
        ("schedule, three modes", ["known_input", "steps_left", "step"]),
    ],
)
def test_only_what_a_policy_reads_is_asked_for(name, others):
    inputs = inputs_of(strong(CASES[name]), CASES[name].scenario.problem())
    assert [each.name for each in inputs] == ["pose", "mean", "information", "present", *others]


def test_the_example_turns_a_belief_into_a_decision(trained):
    """Its prediction against filterpy's, its command against the JAX policy's."""
    example = runpy.run_path(str(EXAMPLE))["OnnxPolicy"](str(trained[1]))
    rng, n = np.random.default_rng(0), 4
    mean, pushes, pose = rng.normal(size=(n, 2)), rng.normal(size=(n, 2)), np.array([1.0, 2.0, 0.5])
    covariance = np.stack([np.diag(row) for row in rng.uniform(0.1, 1, (n, 2))])
    predicted, spread, _ = example.predict(mean, covariance, pushes)
    for i in range(n):
        other = KalmanFilter(dim_x=2, dim_z=2, dim_u=2)
        other.x, other.P = mean[i][:, None], covariance[i]
        other.F = other.B = np.eye(2)
        other.Q = 0.05**2 * np.eye(2)
        other.predict(pushes[i][:, None])
        np.testing.assert_allclose(predicted[i], other.x[:, 0], rtol=1e-6)
        np.testing.assert_allclose(spread[i], other.P, rtol=1e-6)
    experiment = CASES["pointer"]
    arrays = {
        "pose": pose,
        "mean": np.asarray(predicted, float),
        "information": np.linalg.inv(np.asarray(spread, float)),
        "present": np.ones(n, bool),
        "known_input": pushes,
        "steps_left": np.array(7),
        "step": np.array(0),
    }
    one = {key: jnp.asarray(x)[None] for key, x in arrays.items()}
    expected = decided(experiment.scenario.problem(), strong(experiment), one)[0][0]
    control = example(pose, mean, covariance, pushes, steps_left=7)
    np.testing.assert_allclose([control["vx"], control["wz"]], expected, rtol=0, atol=1e-5)
    assert set(example(pose, mean[:0], covariance[:0])) == {"vx", "wz"}


def test_the_example_needs_numpy_and_onnxruntime_only(trained):
    blocked = ("jax", "jaxlib", "equinox", "foveate", "onnx", "scipy", "matplotlib")
    code = f"import sys, runpy\nfor name in {blocked}: sys.modules[name] = None\n"
    code += f"sys.argv = ['run_onnx.py', {str(trained[1])!r}]\nrunpy.run_path({str(EXAMPLE)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["vx", "wz"]
    assert "us a decision, one every 1.0 s" in lines[2]


def test_the_example_rejects_a_file_of_another_version(trained, tmp_path):
    model = onnx.load(trained[1])
    next(each for each in model.metadata_props if each.key == "format_version").value = "2"
    blank = re.sub(rb"(sha256\x12\x40)[0-9a-f]{64}", rb"\g<1>" + b"0" * 64, model.SerializeToString())
    right = blank.replace(b"0" * 64, hashlib.sha256(blank).hexdigest().encode())
    (tmp_path / "later.onnx").write_bytes(right)
    with pytest.raises(ValueError, match=r"later.onnx: not a foveate-policy of version 1"):
        runpy.run_path(str(EXAMPLE))["OnnxPolicy"](str(tmp_path / "later.onnx"))


def test_wrong_input_is_one_line_and_leaves_no_file(trained, tmp_path, capsys, monkeypatch):
    folder, out = str(trained[0]), str(tmp_path / "x.onnx")
    assert "ends in .onnx" in failure(capsys, "export", folder, str(tmp_path / "x.txt"))
    assert "opset = 12: expected from 13 to 24" in failure(capsys, "export", folder, out, "--opset", "12")
    assert "no folder" in failure(capsys, "export", folder, str(tmp_path / "no" / "x.onnx"))
    assert "no such run folder" in failure(capsys, "export", "nowhere", out)
    for name, why in (("random", "random numbers"), ("lawnmower", "a memory")):
        with pytest.raises(ValueError, match=f"has no ONNX graph: it needs {why}"):
            to_onnx(Experiment(), heuristic_policy(name, Scenario().problem(), 2.0))
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert "pip install 'foveate[onnx]'" in failure(capsys, "export", folder, out)
    assert not list(tmp_path.iterdir())


def test_a_file_is_replaced_whole_or_not_at_all(trained, tmp_path, monkeypatch):
    old = tmp_path / "policy.onnx"
    old.write_bytes(b"old")
    experiment = CASES["pointer"]

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        export(experiment, strong(experiment), old)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]


def test_the_page_runs(trained, tmp_path, monkeypatch):
    """docs/deploy.md, block after block: the export, and what a reader types then."""
    shutil.copytree(trained[0], tmp_path / "runs" / "first")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```(\w+)\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    (name, *arguments) = next(block for kind, block in blocks if kind == "sh").split()
    assert name == "foveate"
    assert main(arguments) == 0
    names = {}
    for block in (block for kind, block in blocks if kind == "python"):
        exec(compile(block, str(PAGE), "exec"), names)
    assert names["tracker"].ids == ("car", "bike")
    assert not names["tracker"].rejected
