"""The Gymnasium environments by the checks of Gymnasium and Stable-Baselines3, against Gymnasium's own vector
environment over single ones, and under real learners."""

import importlib
import re
import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from helpers.worlds_of_detections import HALL

import foveate.gym.envs
from foveate.errors import InputError
from foveate.gym.task import Task, TaskSettings
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.random_obstacles import CircleObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import LinearTarget

EYE = ((1.0, 0.0), (0.0, 1.0))
REVERSED = LinearTarget(kind="linear", A=EYE, B=EYE, W=EYE, Z=EYE[::-1], prior=EYE)
PAGE = Path(__file__).parents[2] / "docs" / "gymnasium.md"
COUNT = 4
"""Equal to that of the page run below, so that programs are compiled once."""


def make(**options):
    return gymnasium.make(foveate.gym.ID, **options).unwrapped


def actions(rng, *shape):
    return rng.uniform(-1, 1, (*shape, 2)).astype(np.float32)


@pytest.mark.slow
def test_gymnasium_accepts_the_environment():
    """Warnings are errors here; `check_env` makes one with each way to render, too."""
    check_env(make())
    check_env(make(observation="flat", horizon="terminated"), skip_render_check=True)


def test_made_by_the_name_of_the_module():
    env = gymnasium.make(f"foveate.gym:{foveate.gym.ID}")
    assert isinstance(env.unwrapped, foveate.gym.TrackingEnv)
    assert isinstance(gymnasium.make_vec(foveate.gym.ID, 2), foveate.gym.TrackingVectorEnv)


def same(one, other):
    """Equal to rounding in float32, whatever is nested."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            same(one[name], other[name])
    elif isinstance(one, tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        for a, b in zip(one, other, strict=True):
            same(a, b)
    elif one is None:
        assert other is None
    else:
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.DISABLED], ids=str)
def test_the_vector_environment_is_single_ones_side_by_side(mode):
    """Gymnasium's `SyncVectorEnv` over single environments, step by step, through several ends of episodes."""
    ours = gymnasium.make_vec(foveate.gym.ID, COUNT, autoreset_mode=mode)
    theirs = gymnasium.make_vec(
        foveate.gym.ID, COUNT, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}
    )
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"] == mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    rng, ends = np.random.default_rng(0), np.zeros(COUNT, int)
    (one, info), (other, other_info) = ours.reset(seed=5), theirs.reset(seed=5)
    same(one, other)
    same(info, other_info)
    for k in range(60):
        now = actions(rng, COUNT)
        one, other = ours.step(now), theirs.step(now)
        assert one[0] in ours.observation_space
        for a, b in zip(one, other, strict=True):
            same(a, b)
        assert one[3].dtype == bool
        ends += one[3]
        if mode == AutoresetMode.DISABLED and one[3].any():
            seed, mask = (None, [7 * k + i for i in range(COUNT)])[k % 2], one[3]
            one, _ = ours.reset(seed=seed, options={"reset_mask": mask})
            other, _ = theirs.reset(seed=seed, options={"reset_mask": mask})
            same(one, other)
    assert ends.min() >= 2
    assert len(set(ends)) > 1, "episodes must end at different steps"


def test_seeds_and_options():
    env = make()
    first, info = env.reset(seed=3)
    second, _ = env.reset()
    third, _ = env.reset()
    assert not np.allclose(first["targets"], second["targets"])
    assert not np.allclose(second["targets"], third["targets"])
    same(env.reset(seed=3), (first, info))
    same(env.reset(), (second, info))
    other, _ = make().reset()
    assert not np.allclose(first["targets"], other["targets"]), "without a seed episodes are random"
    assert info["score"] == pytest.approx(2 * np.log(0.5), abs=1e-6)  # Y_0 = 0.5 I in the plane
    for n in (3, 5):
        seen, _ = env.reset(options={"targets": n})
        assert seen["mask"].tolist() == [1.0] * n + [0.0] * (8 - n)
        assert not seen["targets"][n:].any()
        length, over = 0, False
        while not over:
            seen, _, terminated, over, _ = env.step(np.zeros(2))
            length += 1
            assert not terminated
            np.testing.assert_allclose(seen["left"], 1 - length / (3 * n), atol=1e-6)
        assert length == 3 * n
    envs = gymnasium.make_vec(foveate.gym.ID, COUNT)
    seen, _ = envs.reset(seed=[9, 2, 9, 2], options={"targets": np.array([5, 3, 5, 4])})
    assert seen["mask"].sum(axis=1).tolist() == [5, 3, 5, 4]
    same(seen["targets"][0], seen["targets"][2])


def test_observations_are_the_belief_in_the_body_frame():
    """By hand: the predicted mean in the body frame in units of the view's depth, asinh of the turned information."""
    env = make()
    seen, _ = env.reset(seed=1, options={"targets": 8})
    moment = env._task.batch.states
    x, y, yaw = np.asarray(moment.predicted.pose[0])
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    beliefs = (np.asarray(x) for x in (moment.predicted.mean[0], moment.predicted.information[0, 0]))
    for row, p, P in zip(seen["targets"], *beliefs, strict=True):
        turned = R.T @ P @ R
        expected = [*(R.T @ (p - [x, y]) / 2.0), *np.arcsinh([turned[0, 0], turned[1, 0], turned[1, 1]])]
        np.testing.assert_allclose(row, expected, rtol=1e-5, atol=1e-5)
    flat, _ = make(observation="flat", horizon="terminated").reset(seed=1, options={"targets": 8})
    np.testing.assert_array_equal(
        flat, np.concatenate([seen[name].ravel() for name in ("agent", "targets", "mask", "left")])
    )


def test_the_horizon_is_terminated_on_demand_and_rewards_sum_to_the_score():
    env = make(observation="flat", horizon="terminated")
    _, info = env.reset(seed=0)
    total, terminated, rng = info["score"], False, np.random.default_rng(0)
    while not terminated:
        _, reward, terminated, truncated, info = env.step(actions(rng))
        total += reward
        assert truncated is False
    assert total == pytest.approx(info["score"], abs=1e-5)


COMMANDS = ((0.0, -1.0), (0.0, 1.0), (2.0, 0.0))
STEPPED = Scenario(agent=DifferentialDrive(commands=COMMANDS))


def test_discrete_actions_are_the_commands_of_the_agent():
    """Index i moves as command i, by the unicycle's equation; a box's actions move as the nearest command."""
    env, box = make(scenario=STEPPED, actions="discrete"), make(scenario=STEPPED)
    assert env.action_space == gymnasium.spaces.Discrete(3)
    envs = gymnasium.make_vec(foveate.gym.ID, 3, scenario=STEPPED, actions="discrete")
    assert envs.action_space == gymnasium.spaces.MultiDiscrete([3, 3, 3])
    envs.reset(seed=[4, 4, 4])
    several, rewards, *_ = envs.step(np.arange(3))
    for i, (v, w) in enumerate(COMMANDS):
        env.reset(seed=4), box.reset(seed=4)
        before = np.asarray(env._task.batch.states.predicted.pose[0], float)
        seen, reward, *_ = env.step(i)
        after = np.asarray(env._task.batch.states.predicted.pose[0], float)
        np.testing.assert_allclose(after - before, [v * np.cos(before[2]), v * np.sin(before[2]), w], atol=1e-5)
        same(box.step(np.array([v / 2.0 - 1.1, 0.9 * w / (np.pi / 3)]))[:2], (seen, reward))
        same({name: x[i] for name, x in several.items()}, seen)
        assert rewards[i] == pytest.approx(reward, abs=1e-5)
    with pytest.raises(InputError, match=r"actions = \[3\]: expected whole numbers from 0 to 2"):
        env.step(3)
    with pytest.raises(InputError, match=r"expected \(3,\)"):
        envs.step(np.zeros((3, 2)))
    with pytest.raises(InputError, match="expected a scenario whose agent has commands"):
        make(actions="discrete")


def test_pictures():
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    env.step(np.ones(2))
    second = env.render()
    assert first.dtype == second.dtype == np.uint8
    assert first.shape == second.shape == (500, 900, 3)
    assert (first != second).any()
    assert (first == second).mean() > 0.8, "frame and axes stay where they are"


def test_a_window_shows_each_step(monkeypatch):
    import matplotlib.pyplot as plt

    monkeypatch.setattr(plt, "pause", lambda _: None)
    env = make(render_mode="human")
    env.reset(seed=0)
    (figure,) = (plt.figure(number) for number in plt.get_fignums())
    (image,) = figure.images
    first = np.array(image.get_array())
    env.step(np.ones(2))
    assert (np.array(image.get_array()) != first).any()
    assert env.render() is None
    env.close()
    env.close()
    assert plt.get_fignums() == []


def test_unknown_scenario_is_rejected():
    with pytest.raises(InputError, match=r"nobody: expected a preset \(paper, "):
        Task(TaskSettings("nobody"), 1, autoreset=False)


def test_wrong_use_is_named_in_one_line():
    for options, complaint in [
        ({"protocol": "soft"}, "protocol = 'soft': expected 'surrogate' or 'true'"),
        ({"horizon": "never"}, "horizon = 'never'"),
        ({"length_m": 0.0}, "length_m = 0.0: expected > 0"),
    ]:
        settings = TaskSettings()
        for name, value in options.items():  # in the constructor the types that tests check would be in the way
            object.__setattr__(settings, name, value)
        with pytest.raises(ValueError, match=re.escape(complaint)):
            settings.__post_init__()
    with pytest.raises(ValueError, match="expected targets whose state begins with the position"):
        gymnasium.make(foveate.gym.ID, scenario=Scenario(target=REVERSED, scenes=SceneSettings(drift_m_s=(0.0, 0.0))))
    with pytest.raises(ValueError, match="noise = False"):
        make(noise=False)
    with pytest.raises(ValueError, match="autoreset_mode"):
        gymnasium.make_vec(foveate.gym.ID, COUNT, autoreset_mode=AutoresetMode.NEXT_STEP)
    with pytest.raises(ValueError, match="render a single environment"):
        gymnasium.make_vec(foveate.gym.ID, COUNT, render_mode="rgb_array")
    env = make()
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(2))
    env.reset(seed=0, options={"targets": 3})
    with pytest.raises(ValueError, match="expected finite numbers"):
        env.step(np.array([np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"expected \(1, 2\)"):
        env.step(np.zeros(3))
    for _ in range(9):
        env.step(np.zeros(2))
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(2))
    for options, complaint in [
        ({"targets": 9}, r"options\['targets'\] = 9: expected whole numbers from 3 to 8"),
        ({"scene": "a"}, r"options\['scene'\]: expected 'targets'"),
    ]:
        with pytest.raises(ValueError, match=complaint):
            env.reset(options=options)
    envs = gymnasium.make_vec(foveate.gym.ID, COUNT, autoreset_mode="Disabled")
    with pytest.raises(ResetNeeded):
        envs.reset(options={"reset_mask": np.array([True, False, False, False])})
    envs.reset(seed=0, options={"targets": 3})
    for _ in range(9):
        envs.step(np.zeros((COUNT, 2)))
    envs.reset(options={"reset_mask": np.array([True, False, False, False])})
    with pytest.raises(ResetNeeded, match="3 environments"):
        envs.step(np.zeros((COUNT, 2)))
    for mask in ([True] * COUNT, np.zeros(COUNT, bool), np.ones(3, bool)):
        with pytest.raises(ValueError, match=r"options\['reset_mask'\]"):
            envs.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match="seed has 2 numbers"):
        envs.reset(seed=[1, 2])


def test_without_gymnasium_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "foveate.gym")
    monkeypatch.delitem(sys.modules, "foveate.gym.envs")
    with pytest.raises(ImportError, match=re.escape("pip install 'foveate[gym]'")):
        importlib.import_module("foveate.gym")


@pytest.mark.torch
def test_stable_baselines3_checks_and_learns():
    pytest.importorskip("stable_baselines3", reason="needs the extra ppo")
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env as check

    flat = make(observation="flat", horizon="terminated")
    check(flat)
    env = make()
    with warnings.catch_warnings():
        # Its networks for images apart, it knows only rows, and flattens others by itself.
        warnings.filterwarnings("ignore", ".*targets has an unconventional shape")
        check(env)
    options = {"n_steps": 32, "batch_size": 16, "n_epochs": 2, "seed": 0, "device": "cpu"}
    for policy, each in (("MlpPolicy", flat), ("MultiInputPolicy", env)):
        model = PPO(policy, each, **options)
        before = [weight.detach().clone() for weight in model.policy.parameters()]
        model.learn(64)
        assert model.num_timesteps == 64
        after = list(model.policy.parameters())
        assert all(bool(weight.isfinite().all()) for weight in after)
        assert any(not np.array_equal(a.detach(), b) for a, b in zip(after, before, strict=True))
        action, _ = model.predict(each.reset(seed=0)[0], deterministic=True)
        assert each.action_space.contains(action)


@pytest.mark.torch
@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_torchrl_collects_rollouts(mode):
    """Its wrapper around the vector environment: episodes end at the horizon, and the next ones begin whole."""
    torch = pytest.importorskip("torch", reason="needs PyTorch")
    pytest.importorskip("torchrl", reason="needs TorchRL: pip install torchrl")
    from torchrl.envs import GymWrapper

    raw = gymnasium.make_vec(foveate.gym.ID, COUNT, autoreset_mode=mode)
    env = GymWrapper(raw)
    env.set_seed(0)
    torch.manual_seed(0)
    rollout = env.rollout(50, break_when_any_done=False)
    assert rollout.batch_size == (COUNT, 50)
    assert rollout["targets"].shape == (COUNT, 50, 8, 5)
    over = rollout["next", "truncated"][..., 0].numpy()
    assert over.sum() >= COUNT
    left = rollout["next", "left"][..., 0].numpy()
    np.testing.assert_allclose(left[over], 0.0, atol=1e-6)
    begins = rollout["left"][..., 0].numpy()
    np.testing.assert_allclose(begins[:, 1:][over[:, :-1]], 1.0, atol=1e-6)
    assert np.isfinite(rollout["next", "reward"].numpy()).all()


@pytest.mark.torch
def test_the_page_runs(monkeypatch, tmp_path):
    """Block after block of docs/gymnasium.md, as a reader types them."""
    pytest.importorskip("stable_baselines3", reason="needs the extra ppo")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 4
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)


WALLED = Scenario(
    scenes=SceneSettings(
        targets_min=2, targets_max=3, half_side_m=(5.0, 5.0), half_side_per_target_m=0.0, agent_spread=1.0, steps=5
    ),
    obstacles=CircleObstacles(density_per_m2=0.15, maps=2, test_maps=0),
)


@pytest.mark.slow
def test_among_obstacles_environments_tell_ranges_and_contacts():
    """The same numbers from one environment and from several, and ranges that shrink ahead of a contact."""
    one, several = make(scenario=WALLED, rays=8), foveate.gym.envs.TrackingVectorEnv(2, WALLED, rays=8)
    seen, _ = one.reset(seed=5)
    together, _ = several.reset(seed=5)
    assert one.observation_space.contains(seen)
    np.testing.assert_allclose(together["ranges"][0], seen["ranges"])
    assert set(np.unique(seen["clear"])) <= {0.0, 1.0}
    touched = 0
    for _ in range(5):
        ahead = np.array([1.0, 0.0], np.float32)
        near = seen["ranges"][0]
        seen, _, _, _, info = one.step(ahead)
        together, _, _, _, infos = several.step(np.stack([ahead, ahead]))
        assert infos["contacts"][0] == info["contacts"]
        # A step ahead is 4 m, and so is the longest range, twice the depth; a range may be some cells too short.
        assert info["contacts"] > touched or near * 4.0 > 2.0
        touched = info["contacts"]
    flat = make(scenario=WALLED, rays=8, observation="flat")
    assert flat.reset(seed=5)[0].shape == flat.observation_space.shape
    with pytest.raises(InputError, match="rays = 8: expected 0, or a scenario with obstacles"):
        make(scenario="paper", rays=8)
    with pytest.raises(InputError, match="rays = -1: expected a whole number"):
        make(scenario=WALLED, rays=-1)


@pytest.mark.slow
def test_detections_without_ids_are_observed_and_drawn():
    """As many rows as tracks; of the picture, the title has GOSPA, and tracks stand beside true targets."""
    env = gymnasium.make(foveate.gym.ID, scenario=HALL, render_mode="rgb_array")
    seen, _ = env.reset(seed=0)
    assert HALL.detections is not None
    assert seen["mask"].shape == (HALL.detections.tracks,)
    assert seen["mask"].sum() == 0, "nobody knows the targets of this world"
    for _ in range(3):
        seen, reward, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
        assert np.isfinite(reward)
    assert env.render().shape == (500, 900, 3)
    env.close()
