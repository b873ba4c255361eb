"""The Python interface against the simulation, the ONNX file, filterpy and the command line."""

import ast
import contextlib
import json
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.spatial.transform import Rotation

import foveate
from foveate.cli.main import main
from foveate.evaluation.verdict import Verdict, verdict_of, write_verdict
from foveate.experiment.checkpoint import policy_shape, write_config
from foveate.experiment.presets import PRESETS, QUADROTOR, TrainingSettings, adjusted, for_long_horizons, for_scenario
from foveate.experiment.resolve import experiment_from
from foveate.experiment.run_folder import Outcome, Validation
from foveate.io.toml import load_toml
from foveate.learning import train as learner
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenes import SceneSettings, write_scenes
from foveate.scenario.target import DriftTarget

ROOT = Path(__file__).parents[1]
SCENES = SceneSettings(targets_min=1, targets_max=2, steps=4)
POINTER = PointerSettings(kind="pointer", target_widths=(8,), heads=2, context_widths=(8,), mode_width=8)
ATTENTION = AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,))
PLANE = foveate.Experiment(scenario=foveate.Scenario(scenes=SCENES), policy=POINTER)
SPACE = foveate.Experiment(
    scenario=replace(QUADROTOR, scenes=replace(QUADROTOR.scenes, targets_max=4, steps=4)), policy=ATTENTION
)

SCENE = foveate.Scene(
    id="two", agent=(0.0, 0.0, 0.5), targets=((3.0, 1.0), (-5.0, 2.0)), drift=((0.0, 0.0), (0.1, 0.0)), horizon=4
)
NOISE = {"seed": 3, "episodes": 2}
CHECK = Validation(
    epoch=1,
    objective=0.0,
    gradient_norm=1.0,
    held_out=0.5,
    at_limit=0.0,
    best=True,
    epochs_per_s=1.0,
    elapsed_s=1.0,
    env_steps=20,
)


def untrained(experiment: foveate.Experiment) -> foveate.TrainedPolicy:
    """Weights drawn by numpy, for which nothing is compiled."""
    rng = np.random.default_rng(0)
    network = jax.tree.map(lambda x: jnp.asarray(rng.normal(0, 0.5, x.shape), x.dtype), policy_shape(experiment))
    return foveate.TrainedPolicy(name="untrained", experiment=experiment, network=network, facts={})


def test_heavy_modules_are_imported_on_demand():
    code = "import sys, foveate\nprint(dir(foveate), 'jax' in sys.modules, 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-2:] == ["False", "False"]
    assert "'TrainedPolicy'" in done.stdout
    with pytest.raises(AttributeError, match=r"no attribute 'evalute': it has .*evaluate"):
        foveate.evalute  # type: ignore[attr-defined]  # noqa: B018


def test_type_checkers_and_programs_see_the_same_names():
    stub = ast.parse((ROOT / "src" / "foveate" / "__init__.pyi").read_text(encoding="utf-8"))
    homes = {
        alias.asname: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert sorted([*homes, "__version__"]) == sorted(dir(foveate))
    for name, home in homes.items():
        __import__(str(home))
        assert getattr(foveate, str(name)) is getattr(sys.modules[str(home)], str(name))


@pytest.mark.parametrize(
    "experiment", [pytest.param(PLANE, marks=pytest.mark.slow, id="plane"), pytest.param(SPACE, id="space")]
)
def test_decides_as_its_onnx_file_on_tracker_beliefs(experiment: foveate.Experiment, tmp_path: Path):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    policy, d = untrained(experiment), experiment.scenario.dimension
    policy.export(tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    tracker, pose = foveate.Tracker(policy.scenario), np.array([0.5, -1.0, 0.3]) if d == 2 else np.eye(4)
    for count in range(4):
        tracker.predict()
        inputs = tracker.inputs(pose, policy.steps_left)
        (control,) = session.run(["control"], {each.name: inputs[each.name] for each in session.get_inputs()})
        np.testing.assert_allclose(policy(tracker.belief(), pose), control[0], rtol=0, atol=1e-5)
        assert tracker.belief().targets == count
        tracker.add(f"walker {count}", [1.0 + count, -2.0, 3.0][:d])
    assert policy.steps_left == json.loads(session.get_modelmeta().custom_metadata_map["steps_left"]) == 2
    assert json.loads(session.get_modelmeta().custom_metadata_map["output"])["axes"] == list(policy.axes)


def test_a_policy_of_an_agent_with_commands_decides_for_one_of_them():
    commands = ((0.0, -1.0), (0.0, 1.0), (2.0, 0.0), (4.0, 0.5))
    stepped = replace(PLANE, scenario=replace(PLANE.scenario, agent=foveate.DifferentialDrive(commands=commands)))
    policy, found = untrained(stepped), set()
    for mean in np.random.default_rng(0).normal(0, 5, (20, 3, 2)):
        found.add(tuple(policy(foveate.Belief(mean, covariance=np.eye(2)), np.zeros(3)).tolist()))
    assert len(found) > 1
    assert found <= set(commands)


def test_a_pose_in_space_is_a_matrix_or_numbers():
    policy, turn = untrained(SPACE), Rotation.from_euler("z", 0.7)
    x, y, z, w = turn.as_quat()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), [1, 2, 3]
    belief = foveate.Belief(np.ones((1, 6)), covariance=np.eye(6))
    np.testing.assert_allclose(policy(belief, T), policy(belief, [1, 2, 3, w, x, y, z]), rtol=0, atol=1e-9)
    T[0, 0] = 2.0
    with pytest.raises(ValueError, match="expected a homogeneous matrix"):
        policy(belief, T)


def test_predicts_as_filterpy_and_padding_does_not_matter():
    policy = untrained(PLANE)
    mean, P = np.array([[1.0, 2.0], [3.0, -4.0]]), np.array([[0.5, 0.1], [0.1, 0.3]])
    pushes, far = np.array([[0.4, 0.0], [0.0, -0.2]]), [[np.nan, np.inf]]
    found = policy.predict(foveate.Belief(mean, covariance=P), pushes)
    for i in range(2):
        other = KalmanFilter(dim_x=2, dim_z=2, dim_u=2)
        other.x, other.P, other.F, other.B, other.Q = mean[i][:, None], P, np.eye(2), np.eye(2), 0.05**2 * np.eye(2)
        other.predict(pushes[i][:, None])
        np.testing.assert_allclose(found.mean[i], other.x[:, 0], rtol=1e-12)
        np.testing.assert_allclose(found.covariance[i], other.P, rtol=1e-12)
    padded = foveate.Belief(
        [*mean, *far],
        information=[*np.linalg.inv([P, P]), np.full((2, 2), np.nan)],
        present=[True, True, False],
        known_input=[*pushes, *far],
    )
    plain = foveate.Belief(mean, covariance=P, known_input=pushes)
    pose = [0.0, 1.0, 2.0]
    np.testing.assert_allclose(policy(padded, pose), policy(plain, pose), rtol=0, atol=1e-12)
    many = plain.padded(100)
    assert (many.targets, len(many.mean), many.padded(7)) == (2, 100, many)
    np.testing.assert_allclose(policy(many, pose), policy(plain, pose), rtol=0, atol=1e-12)
    nobody = foveate.Belief(np.zeros((0, 2)), covariance=np.eye(2))
    absent = foveate.Belief(far, covariance=np.eye(2), present=[False])
    np.testing.assert_allclose(policy(nobody, pose), policy(absent, pose), rtol=0, atol=1e-12)
    assert repr(nobody) == "Belief(0 targets with states of 2 numbers)"
    assert repr(many) == "Belief(2 targets with states of 2 numbers, padded to 100, standard deviations 0.55 to 0.71)"


ONE = np.eye(2)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"mean": [[1, 2]]}, "covariance, information: expected one of them"),
        ({"mean": [1, 2], "covariance": ONE}, r"mean has shape \(2,\): expected \(n, n_y\)"),
        ({"mean": [[1, np.nan]], "covariance": ONE}, r"mean\[0\] = \[1.0, nan\]: expected finite"),
        ({"mean": [[1, 2]], "covariance": np.eye(3)}, r"covariance has shape \(3, 3\): expected \(1, 2, 2\)"),
        ({"mean": [[1, 2]], "covariance": -ONE}, r"covariance\[0\] = .* positive definite"),
        ({"mean": [[1, 2]], "information": [[1, 1], [0, 1]]}, r"information\[0\] = .* symmetric"),
        ({"mean": [[1, 2]], "information": [[np.inf, 0], [0, 1]]}, r"information\[0\] = .* finite"),
        ({"mean": [[1, 2]], "covariance": ONE, "present": [1]}, r"present has shape \(1,\) of int64"),
        ({"mean": [[1, 2]], "covariance": ONE, "known_input": [[0], [0]]}, r"known_input has shape \(2, 1\)"),
    ],
)
def test_a_belief_that_is_none_is_rejected(arguments: dict, complaint: str):
    with pytest.raises(ValueError, match=complaint):
        foveate.Belief(**arguments)


def test_one_target_beyond_float32_does_not_stop_decisions_about_the_others():
    policy, pose = untrained(PLANE), [0.0, 1.0, 2.0]
    alone = foveate.Belief([[1.0, 2.0]], covariance=ONE)
    for far, variance in ((1e200, 1.0), (1e30, 1.0), (-1e25, 1e300)):
        both = foveate.Belief([[1.0, 2.0], [far, 0.0]], covariance=[ONE, variance * ONE])
        np.testing.assert_allclose(policy(both, pose), policy(alone, pose), rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=r"covariance\[0\]: expected one with an inverse"):
        foveate.Belief([[1.0, 2.0]], covariance=1e-320 * ONE)


@pytest.mark.parametrize("steps_left", [0, -1, 2**31])
def test_steps_left_are_a_whole_number(steps_left):
    with pytest.raises(ValueError, match=r"steps_left = .*: expected a whole number from 1 to 2147483647"):
        untrained(PLANE)(foveate.Belief([[1.0, 2.0]], covariance=ONE), [0.0, 0.0, 0.0], steps_left)


def test_a_belief_or_pose_of_another_scenario_is_rejected():
    policy = untrained(PLANE)
    with pytest.raises(ValueError, match=r"mean has shape \(1, 3\): expected \(1, 2\)"):
        policy(foveate.Belief(np.ones((1, 3)), covariance=np.eye(3)), [0, 0, 0])
    with pytest.raises(ValueError, match=r"known_input has shape \(1, 1\): expected \(1, 2\)"):
        policy(foveate.Belief([[1, 2]], covariance=ONE, known_input=[[1]]), [0, 0, 0])
    with pytest.raises(ValueError, match=r"pose = .* expected"):
        policy(foveate.Belief([[1, 2]], covariance=ONE), [0, 0])


@pytest.fixture
def trainer(monkeypatch: pytest.MonkeyPatch) -> list[tuple]:
    """A learner that only says what it was asked for and leaves a policy; tests/cli has the real one in its place."""
    asked = []

    def train(experiment, out, seed, resume, report) -> Outcome:
        asked.append((experiment, out, seed, resume))
        if not resume:
            untrained(experiment).save(out)
        report(CHECK, 1)
        return Outcome(epochs=1, best_epoch=1, best_score=0.5, rollbacks=0, stopped="it was enough" * (seed == 9))

    def judge_run(run, quiet) -> Verdict:
        """A heuristic wins if the seed is even."""
        policy = np.array([1.0, 2.0])
        lead = -1.0 if asked[-1][2] % 2 == 0 else 1.0
        verdict = verdict_of(asked[-1][0], {"policy": policy, "still": policy - lead}, {})
        write_verdict(run, verdict)
        return verdict

    monkeypatch.setattr(learner, "train", train)
    monkeypatch.setattr("foveate.api.judge_run", judge_run)
    return asked


def test_a_callback_gets_each_validation(trainer: list[tuple], tmp_path: Path):
    """The example of the page, with a logger in the place of MLflow."""
    logged = []
    logger = SimpleNamespace(log_metrics=lambda numbers, step: logged.append((numbers, step)))
    page = (Path(__file__).parents[1] / "docs" / "api" / "training.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    with contextlib.chdir(tmp_path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(block, "training.md", "exec"), {"foveate": foveate, "mlflow": logger})
    assert logged == [(CHECK.numbers(), CHECK.epoch)]
    assert all(type(value) is float for value in CHECK.numbers().values())
    assert "event" not in CHECK.numbers()


def test_like_is_for_scenarios_only(trainer: list[tuple]):
    with pytest.raises(foveate.InputError, match="like = 'quadrotor': expected None"):
        foveate.train("paper", like="quadrotor")


WRONG = """
import foveate
policy, tracker = foveate.load("paper"), foveate.Tracker(foveate.Scenario())
for call in (
    lambda: policy([[1, 2]], [0, 0, 0]),
    lambda: policy.predict([[1, 2]]),
    lambda: policy.simulate("a"),
    lambda: tracker.update([0, 0, 0], [[1, 2]]),
    lambda: foveate.train("paper", seed="one"),
    lambda: foveate.evaluate(policy, episodes=1.5),
    lambda: foveate.Scenario(view="sector"),
):
    try:
        call()
    except foveate.InputError as error:
        print(error)
"""


@pytest.mark.slow
def test_wrong_types_give_one_line():
    """In a process without the checks of types that tests have, as a user's."""
    done = subprocess.run([sys.executable, "-c", WRONG], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    names = ("belief = ", "belief = ", "scene = ", "detections: ", "seed one", "episodes 1.5", "Scenario: view = ")
    assert len(lines) == len(names)
    for line, name in zip(lines, names, strict=True):
        assert line.startswith(name)
        assert "expected" in line


@pytest.mark.slow
def test_trains_into_a_run_or_into_memory(trainer: list[tuple], tmp_path: Path):
    out = tmp_path / "run"
    policy = foveate.train(PLANE.scenario, like="paper", epochs=7, seed=3, out=out)
    expected = for_scenario(PLANE.scenario, "paper")
    expected = replace(expected, training=replace(expected.training, epochs=7))
    assert trainer[-1] == (expected, out, 3, False)
    assert foveate.load(out).experiment == policy.experiment == expected
    assert policy.verdict is not None
    assert (policy.verdict.winner, policy.verdict.unbeaten) == ("policy", ())
    policy.save(tmp_path / "saved")
    assert foveate.load(tmp_path / "saved").verdict == foveate.load(out).verdict == policy.verdict
    with pytest.warns(UserWarning, match=r"a policy: The policy has no clear lead .* over: still\. To continue, train"):
        assert foveate.train(PLANE.scenario, like="paper", seed=2).verdict.winner == "still"
    assert foveate.train(expected, out=out, seed=3, resume=True, progress=False).name == str(out)
    assert trainer[-1] == (expected, out, 3, True)
    (tmp_path / "own.toml").write_text("[scenario]\ntau_s = 0.25\n")
    fitted = foveate.train(tmp_path / "own.toml", algorithm="actor-critic", verdict=False)
    assert fitted.verdict is None
    assert (fitted.scenario.tau_s, fitted.experiment.policy.kind) == (0.25, "pointer")
    assert not trainer[-1][1].exists(), "without a place for it nothing is left"
    with pytest.warns(UserWarning, match="a policy: the training stopped early: it was enough"):
        foveate.train("paper", seed=9)
    assert trainer[-1][0] == PRESETS["paper"]
    with pytest.raises(ValueError, match="resume: expected out"):
        foveate.train("paper", resume=True)
    with pytest.raises(ValueError, match=r"nobody: expected a preset \(paper, "):
        foveate.train("nobody")
    with pytest.raises(ValueError, match="seed -1: expected"):
        foveate.train("paper", seed=-1)


def test_saved_policies_are_loaded_unchanged(tmp_path: Path):
    policy = replace(untrained(PLANE), facts={"seed": 3})
    policy.save(tmp_path / "kept")
    kept = foveate.load(tmp_path / "kept")
    assert (kept.name, kept.experiment, kept.facts) == (str(tmp_path / "kept"), PLANE, {"seed": 3})
    for one, other in zip(jax.tree.leaves(kept.network), jax.tree.leaves(policy.network), strict=True):
        np.testing.assert_array_equal(one, other)
    text = repr(policy)
    assert "pointer network of 752 weights; decides for 1 to 2 targets (drift), differential_drive" in text
    assert "triangle view of 2 m, a command [vx, wz] every 1 s" in text
    with pytest.raises(ValueError, match="exists already"):
        policy.save(tmp_path / "kept")
    with pytest.raises(ValueError, match="no such run folder or file, and no preset"):
        foveate.load("nobody")


def test_evaluates_as_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Whoever is given: a run, a policy, and one of the user's own with its scenario."""
    monkeypatch.setattr("foveate.evaluation.evaluate.decision_time", lambda *_: 0.125)
    out, policy, scenes = tmp_path / "run", untrained(PLANE), tmp_path / "scenes.json"
    policy.save(out)
    write_scenes(scenes, [SCENE])
    command = ["evaluate", str(out), "--scenes", str(scenes), "--protocol", "true", "--episodes", "2", "--seed", "3"]
    assert main([*command, "--json", str(tmp_path / "a")]) == 0
    foveate.evaluate(out, scenes, protocol="true", **NOISE).to_json(tmp_path / "b")
    mine = foveate.evaluate(policy, [SCENE], protocol="true", progress=False, **NOISE)
    mine.to_json(tmp_path / "c")
    foveate.evaluate(policy.network, [SCENE], scenario=PLANE.scenario, protocol="true", **NOISE).to_json(tmp_path / "d")
    a, b, c, d = (json.loads((tmp_path / name).read_text()) for name in "abcd")
    assert a == b
    assert a["rows"] == c["rows"]
    assert [row["objective"] for row in a["rows"]] == [row["score"] for row in a["rows"]]
    assert [row | {"objective": row["score"]} for row in d["rows"]] == a["rows"]
    assert {row["objective"] for row in d["rows"]} == {d["objective"]} == {None}, "no training of foveate has one"
    assert (a["experiment"], c["scenes"], d["run"]) == (c["experiment"], "scenes", "PointerPolicy")
    assert len(mine.rows) == 2
    assert mine.scenes == (SCENE,)
    assert f"{mine.summary[0].mean:.2f}" in repr(mine)
    assert f"<td>{mine.summary[0].mean:.2f} " in mine._repr_html_()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two walkers in the plane, for 10 s."""
    path = tmp_path / "walkers.csv"
    rows = "".join(f"{0.5 * k},a,{-3 + 0.5 * k},2\n{0.5 * k},b,1,{4 - 0.4 * k}\n" for k in range(20))
    path.write_text(f"time_s,track_id,x_m,y_m\n{rows}")
    return path


@pytest.mark.slow
def test_plans_as_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("foveate.evaluation.planners.decision_time", lambda *_, **__: 0.125)
    policy, out, scenes = untrained(PLANE), tmp_path / "run", tmp_path / "scenes.json"
    policy.save(out)
    write_scenes(scenes, [SCENE])
    command = ["plan", "--scenes", str(scenes), "--run", str(out), "--open-loop", "--iterations", "2", "--seed", "3"]
    assert main([*command, "--protocol", "true", "--json", str(tmp_path / "a")]) == 0
    options = {"open_loop": True, "iterations": 2, "protocol": "true", "seed": 3}
    foveate.plan(scenes, run=out, **options).to_json(tmp_path / "b")
    mine = foveate.plan([SCENE], experiment=PLANE.scenario, **options)
    a, b = (json.loads((tmp_path / name).read_text()) for name in "ab")
    assert a == b
    rows = [json.loads(json.dumps(row.record())) for row in mine.rows]
    assert [row | {"objective": row["score"]} for row in rows] == a["rows"]
    assert {row.objective for row in mine.rows} == {None}, "nothing is trained in a scenario alone"
    assert {row.method for row in mine.rows} == {"icr-open"}
    assert "icr-open" in repr(mine)
    for wrong, complaint in (
        ({"refine": 2}, "refine 2: expected the policy to refine"),
        ({"starts": 0}, "starts 0: expected >= 1"),
        ({"omniscient": True, "open_loop": True}, "omniscient: "),
        ({"window": 3, "open_loop": True}, "window 3: only a receding-horizon plan"),
    ):
        with pytest.raises(foveate.InputError, match=complaint):
            foveate.plan([SCENE], **wrong)


def test_fits_as_the_command(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["fit", str(recording), "--out", str(tmp_path / "a.toml"), "--end", "8", "--v-max", "2"]) == 0
    fitted = foveate.fit(recording, end=8.0, v_max=2.0)
    fitted.save(tmp_path / "b.toml")
    assert (tmp_path / "a.toml").read_bytes() == (tmp_path / "b.toml").read_bytes()
    assert load_toml(foveate.Experiment, tmp_path / "a.toml") == fitted.experiment
    assert fitted.experiment.scenario.agent.v_max_m_s == 2.0
    assert repr(fitted) in capsys.readouterr().out
    assert foveate.fit(foveate.load_recording(recording), end=8.0, v_max=2.0).experiment == fitted.experiment
    with pytest.raises(foveate.InputError, match=r"tau = 0\.0: expected > 0"):
        foveate.fit(recording, tau=0.0)


def test_replays_as_the_command(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("foveate.recordings.replay.decision_time", lambda *_: 0.125)
    policy, out = untrained(PLANE), tmp_path / "run"
    policy.save(out)
    command = ["replay", str(out), str(recording), "--method", "policy", "still", "--agent-start=1,-1,0.5"]
    assert main([*command, "--end", "8", "--json", str(tmp_path / "a")]) == 0
    options = {"method": ["policy", "still"], "end": 8.0, "agent_start": [1.0, -1.0, 0.5]}
    foveate.replay(out, recording, **options).to_json(tmp_path / "b")
    a, b = (json.loads((tmp_path / name).read_text()) for name in "ab")
    assert a == b
    mine = foveate.replay(policy, foveate.load_recording(recording), progress=False, **options)
    assert [json.loads(json.dumps(row.record())) for row in mine.rows] == a["rows"]
    assert [row.method for row in mine.rows] == list(mine.traces) == ["policy", "still"]
    assert f"{mine.rows[0].log_det_mean:.2f}" in repr(mine)
    assert f"<td>{mine.rows[0].log_det_mean:.2f}</td>" in mine._repr_html_()
    for wrong, complaint in (
        ({"agent_start": [1.0, 2.0]}, "agent_start 1,2: planar pose"),
        ({"agent_start": [0.0, 0.0, 0.0], "starts": 2}, "agent_start and starts"),
        ({"starts": 0}, "starts 0: expected >= 1"),
        ({"gate": 2.0}, "gate = 2.0"),
        ({"method": "psychic"}, "method 'psychic'"),
    ):
        with pytest.raises(foveate.InputError, match=complaint):
            foveate.replay(policy, recording, **wrong)


def test_an_experiment_is_one_a_scenario_a_preset_a_file_or_a_run(tmp_path: Path):
    write_config(tmp_path, SPACE)
    assert experiment_from("paper") == PRESETS["paper"]
    assert experiment_from(tmp_path) == experiment_from(str(tmp_path / "config.toml")) == SPACE
    assert experiment_from(SPACE) is SPACE
    assert experiment_from(QUADROTOR).scenario is QUADROTOR
    with pytest.raises(foveate.InputError, match=r"nobody: expected a preset \(paper, "):
        experiment_from("nobody")


def test_memory_and_gradients_of_long_episodes_are_bounded_where_asked():
    paper = PRESETS["paper"]
    assert for_long_horizons(paper) is paper
    training = for_long_horizons(paper, remat=True, window=5).training
    longest = paper.scenario.scenes.horizon(paper.scenario.scenes.targets_max)
    assert training.window == 5
    assert training.segment**2 >= longest > (training.segment - 1) ** 2
    with pytest.raises(foveate.InputError, match="expected a training by the policy gradient"):
        for_long_horizons(PRESETS["best"], remat=True)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"method": "psychic"}, "method 'psychic': expected one of"),
        ({"episodes": 0}, "episodes 0: expected >= 1"),
        ({"seed": -1}, "seed -1"),
        ({"scenes": [SCENE, SCENE]}, "scenes: id 'two' is given twice"),
        ({"scenes": [replace(SCENE, targets=((1.0, 2.0, 3.0),))]}, r"scenes\[0\] .* expected 2 numbers"),
        ({"scenes": []}, "scenes: expected a list of at least one"),
        ({"scenes": "nowhere.json"}, "nowhere.json: there is no such file"),
    ],
)
def test_an_invalid_evaluation_is_rejected(options: dict, complaint: str):
    policy = untrained(PLANE)
    with pytest.raises(ValueError, match=complaint):
        foveate.evaluate(policy, **{"scenes": [SCENE], **options})
    with pytest.raises(ValueError, match="scenario: expected the scenario"):
        foveate.evaluate(policy.network, [SCENE])


def test_a_policy_of_another_space_is_rejected():
    with pytest.raises(ValueError, match="scenario: has 3 dimensions: expected 2 dimensions"):
        foveate.evaluate(untrained(PLANE), scenario=QUADROTOR)
    with pytest.raises(ValueError, match="steps_left = 0"):
        untrained(PLANE)(foveate.Belief([[1.0, 0.0]], covariance=np.eye(2)), [0.0, 0.0, 0.0], steps_left=0)


def test_a_scenario_is_trained_as_a_preset_with_lengths_that_fit_its_view():
    paper = PRESETS["paper"].scenario
    for name, preset in PRESETS.items():
        if name != "any":  # which it begins with
            assert for_scenario(preset.scenario, name) == preset
    wide = for_scenario(replace(paper, view=SectorView(depth_m=10.0), target=DriftTarget()))
    assert wide.policy == PRESETS["true-view"].policy, "tokens are in units of the view"
    soft = for_scenario(replace(paper, view=SectorView(depth_m=10.0)), "paper").training
    assert isinstance(soft, TrainingSettings)
    assert soft.softness == ((2.0, 2.0),)
    with pytest.raises(ValueError, match="preset 'nobody': presets are paper"):
        for_scenario(paper, "nobody")
    with pytest.raises(ValueError, match="algorithm 'sarsa': expected one of policy-gradient"):
        adjusted(PLANE, "sarsa")
