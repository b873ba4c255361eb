"""A policy with rays in an ONNX file: against the one in JAX, with what is around it as numbers and from a map."""

import json
import runpy
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import foveate
from foveate.cli.main import main
from foveate.errors import InputError
from foveate.experiment.presets import PAN
from foveate.experiment.resolve import subject_of
from foveate.models.robot import Robot, Surroundings
from foveate.scenario.random_obstacles import CircleObstacles
from foveate.simulation.records import Observation

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
pytest.importorskip("onnx", reason="needs the extra onnx")

EXAMPLE = Path(__file__).parents[2] / "examples" / "run_onnx.py"
BATCH, TARGETS, RAYS = 60, 8, 16


@pytest.fixture(scope="module")
def policy():
    return foveate.load("rooms")


@pytest.fixture(scope="module")
def file(policy, tmp_path_factory):
    path = tmp_path_factory.mktemp("exported") / "rooms.onnx"
    policy.export(path)
    return path


def draws():
    """Poses, beliefs, and any ranges and ways, of none to all targets."""
    rng = np.random.default_rng(4)
    root = rng.normal(0, 0.5, (BATCH, TARGETS, 4, 4))
    pose = rng.uniform(-6, 6, (BATCH, 3))
    mean = rng.uniform(-8, 8, (BATCH, TARGETS, 4))
    place, straight = mean[..., :2] + rng.normal(0, 2, (BATCH, TARGETS, 2)), rng.random((BATCH, TARGETS)) < 0.5
    place = np.where(straight[..., None], mean[..., :2], place)
    away = np.linalg.norm(place - pose[:, None, :2], axis=-1)
    arrays = {
        "pose": pose,
        "mean": mean,
        "information": np.linalg.inv(root @ root.swapaxes(-1, -2) + 0.1 * np.eye(4)),
        "present": np.arange(TARGETS) < rng.integers(0, TARGETS + 1, (BATCH, 1)),
        "known_input": rng.normal(size=(BATCH, TARGETS, 2)),
        "steps_left": rng.integers(1, 48, BATCH),
        "ranges": rng.uniform(0.2, 10, (BATCH, RAYS)),
        "way_place": place,
        "way_length": away + np.where(straight, 0.0, rng.uniform(0, 9, (BATCH, TARGETS))),
        "is_straight": straight,
        "is_seen": rng.random((BATCH, TARGETS)) < 0.5,
    }
    return {name: x.astype(np.float32) if x.dtype.kind == "f" else x for name, x in arrays.items()}


def test_a_file_takes_ranges_and_ways_and_decides_as_jax(policy, file):
    arrays = draws()
    session = onnxruntime.InferenceSession(file.read_bytes())
    assert [each.name for each in session.get_inputs()] == list(arrays)
    with jax.enable_x64(False):
        both = policy.problem, policy.network
        single, network = jax.tree.map(lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, both)

        @jax.jit
        @jax.vmap
        def decide(pose, mean, information, present, known_input, left, *around):
            robot = Robot.of(single)
            step = jnp.zeros((), int)
            seen = Observation(step, left, pose, mean, information, present, known_input, robot, Surroundings(*around))
            return single.agent.control(network(seen, (), jax.random.key(0))[0])

        expected = np.asarray(decide(*arrays.values()))
    found = session.run(None, arrays)[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    assert (np.ptp(expected, axis=0) > 1.0).all()
    for name in ("mean", "information", "known_input", "way_place", "way_length"):
        arrays[name][~arrays["present"]] = np.nan
    np.testing.assert_array_equal(session.run(None, arrays)[0], found)
    arrays["ranges"] = np.full_like(arrays["ranges"], 0.3)
    assert np.abs(session.run(None, arrays)[0] - found).max() > 0.1


@pytest.mark.slow
def test_a_loaded_file_decides_as_the_policy_it_is_from(policy, file):
    loaded = foveate.load(file)
    assert (loaded.scenario, loaded.axes) == (policy.scenario, policy.axes)
    arrays = draws()
    beliefs = [
        foveate.Belief(mean, information=information, present=present)
        for mean, information, present in zip(
            *(arrays[name] for name in ("mean", "information", "present")), strict=True
        )
    ]
    for belief, pose in zip(beliefs[:6], arrays["pose"], strict=False):
        for number in (0, 5):
            expected = policy(belief, pose, map_number=number)
            np.testing.assert_allclose(loaded(belief, pose, map_number=number), expected, atol=1e-5)
    other = replace(policy.scenario, obstacles=CircleObstacles(maps=1, test_maps=0))
    moved = loaded.for_scenario(other)
    expected = policy.for_scenario(other)(beliefs[0], arrays["pose"][0])
    np.testing.assert_allclose(moved(beliefs[0], arrays["pose"][0]), expected, atol=1e-5)
    with pytest.raises(InputError, match="serves its own robot and targets"):
        loaded.for_scenario(replace(policy.scenario, tau_s=0.25))
    with pytest.raises(InputError, match="serves its own robot and targets"):
        subject_of(loaded, replace(policy.scenario, tau_s=0.25))
    assert subject_of(loaded).objective == policy.experiment.training.objective == "mean"
    with pytest.raises(InputError, match="is an exported file already"):
        loaded.export("x.onnx")
    with pytest.raises(InputError, match="save the run"):
        loaded.save("x")


def test_the_example_tells_a_scanners_ranges(policy, file):
    """Without ranges as in the open; a wall ahead, nearer than the target behind it, hides that one."""
    example = runpy.run_path(str(EXAMPLE))["OnnxPolicy"](str(file))
    pose, mean = np.array([1.0, 2.0, np.pi / 2]), np.array([[1.0, 6.0, 0, 0], [4.0, 2.0, 0, 0]])
    covariance = np.tile(0.5 * np.eye(4), (2, 1, 1))
    free = example(pose, mean, covariance)
    bare = policy.for_scenario(replace(policy.scenario, obstacles=None))
    expected = bare(bare.predict(foveate.Belief(mean, covariance=covariance)), pose)
    np.testing.assert_allclose(list(free.values()), expected, atol=1e-5)
    ranges = np.full(RAYS, 10.0)
    ranges[0] = 3.0  # straight ahead, along y
    told = example.around(pose, mean[:, :2], ranges)
    assert told["is_seen"].tolist() == [False, True]
    np.testing.assert_allclose(told["way_length"], [4.0, 3.0])
    assert set(example(pose, mean, covariance, ranges=ranges)) == {"vx", "wz"}


@pytest.mark.slow
def test_commands_take_a_file(tmp_path):
    """`foveate evaluate` of the file has the rows of its run, up to rounding."""
    main(["export", "pan", str(tmp_path / "pan.onnx")])
    scenes = foveate.own_suite(PAN.scenes, PAN.problem())[:2]
    foveate.write_scenes(tmp_path / "two.json", scenes)
    found = []
    for name in ("pan", str(tmp_path / "pan.onnx")):
        options = ["--scenes", str(tmp_path / "two.json"), "--protocol", "true", "--json", str(tmp_path / "rows.json")]
        assert main(["evaluate", name, *options]) == 0
        found.append(json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))["rows"])
    assert len(found[0]) == 2
    for one, other in zip(*found, strict=True):
        assert one["score"] == pytest.approx(other["score"], abs=1e-3)


def test_a_file_is_for_one_kind_of_robot_of_a_team(tmp_path, capsys):
    """With --robot the file decides as that robot's policy in JAX; without, a team of different kinds has no file."""
    (tmp_path / "team.toml").write_text(
        '[scenario.view]\nshape = "sector"\ndepth_m = 6.0\n[scenario.team]\nagents = 2\n'
        "[[scenario.team.robots]]\n[[scenario.team.robots]]\nview = { depth_m = 2.0 }\nagent = { v_max_m_s = 1.0 }\n"
    )
    run, out = f"any@{tmp_path / 'team.toml'}", str(tmp_path / "robot.onnx")
    assert main(["export", run, out]) == 2
    error = capsys.readouterr().err.strip()
    assert error.endswith("RobotPolicy.for_robot(number), or export --robot NUMBER")
    assert len(error.splitlines()) == 1
    assert main(["export", run, out, "--robot", "1"]) == 0
    policy = foveate.load(run)
    example, own = runpy.run_path(str(EXAMPLE))["OnnxPolicy"](out), policy.for_robot(1)
    assert own.scenario == policy.scenario.of_robot(1)
    pose, mean, covariance = (
        np.array([1.0, 2.0, 0.5]),
        np.array([[4.0, 6.0], [4.0, 2.0]]),
        np.tile(np.eye(2), (2, 1, 1)),
    )
    expected = own(own.predict(foveate.Belief(mean, covariance=covariance)), pose)
    np.testing.assert_allclose(list(example(pose, mean, covariance).values()), expected, atol=1e-5)
    assert expected[0] <= 1.0
    assert main(["export", run, out, "--robot", "2"]) == 2
    assert "robot = 2: expected 0 to 1, a robot of the team" in capsys.readouterr().err
