"""Environments in other processes: of Gymnasium, of Stable-Baselines3, pickled and copied."""

import copy
import multiprocessing
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import foveate.gym
from foveate.errors import InputError
from foveate.gym import task
from foveate.gym.task import Task, TaskSettings
from foveate.io import jax_settings

ACTION = np.array([0.5, -0.25], np.float32)

ASYNC = """
import gymnasium, numpy as np
if __name__ == "__main__":
    options = {"vectorization_mode": "async", "vector_kwargs": {"context": "%s"}}
    envs = gymnasium.make_vec("foveate:foveate/Tracking-v0", num_envs=2, **options)
    try:
        seen, info = envs.reset(seed=3)
        print(seen["targets"].shape, envs.step(np.zeros((2, 2), np.float32))[1].shape)
    except ValueError as error:
        print(type(error).__name__, error)
    envs.close(terminate=True)
"""

SUBPROCESSES = """
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv
if __name__ == "__main__":
    envs = make_vec_env("foveate:foveate/Tracking-v0", n_envs=1, vec_env_cls=SubprocVecEnv)
    print(envs.reset()["targets"].shape)
    envs.close()
"""


def output(code: str, folder: Path) -> str:
    """What a script prints, in a process of its own: with a file, as processes that are spawned need."""
    file = folder / "script.py"
    file.write_text(code, encoding="utf-8")
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_gymnasiums_processes_work_when_spawned(tmp_path: Path):
    assert output(ASYNC % "spawn", tmp_path) == "(2, 8, 5) (2,)\n"


@pytest.mark.slow
@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
def test_a_fork_is_refused_in_one_line(tmp_path: Path):
    said = output(ASYNC % "fork", tmp_path)
    assert said.startswith("InputError environments in a fork of a process in which JAX has run: expected")
    assert 'context="spawn"' in said
    assert said.count("\n") == 1


@pytest.mark.torch
def test_processes_of_stable_baselines3_work(tmp_path: Path):
    pytest.importorskip("stable_baselines3", reason="needs the extra ppo")
    assert output(SUBPROCESSES, tmp_path) == "(1, 8, 5)\n"


def test_an_environment_made_in_a_fork_alone_is_refused_at_once(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(task, "_spaces", {})
    monkeypatch.setattr(jax_settings, "LOADED_IN", -1)
    with pytest.raises(InputError, match=r'context="spawn"'):
        Task(TaskSettings(), 1, autoreset=False)


@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"])
def test_a_copy_continues_the_episode(copied):
    env = gymnasium.make(foveate.gym.ID, render_mode="rgb_array")
    env.reset(seed=1)
    env.step(ACTION)
    other = copied(env)
    for _ in range(2):
        (one, reward, *_), (two, other_reward, *_) = env.step(ACTION), other.step(ACTION)
        np.testing.assert_array_equal(one["targets"], two["targets"])
        assert reward == other_reward
    np.testing.assert_array_equal(env.render(), other.render())
    one, two = env.reset()[0], other.reset()[0]
    np.testing.assert_array_equal(one["targets"], two["targets"])


def test_a_vector_environment_is_copied_before_and_within_its_episodes():
    envs = gymnasium.make_vec(foveate.gym.ID, 4)
    for seed in (None, 5):
        if seed is not None:
            envs.reset(seed=seed)
        other = pickle.loads(pickle.dumps(envs))
        same_seed = {"seed": 5} if seed is None else {}
        one, two = envs.reset(**same_seed)[0], other.reset(**same_seed)[0]
        np.testing.assert_array_equal(one["targets"], two["targets"])
