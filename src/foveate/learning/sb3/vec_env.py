"""Batched environment as a `VecEnv` of Stable-Baselines3: one compiled program, no Python object per copy."""

# Without the extra `ppo` there is no Stable-Baselines3 to check against.
# pyright: reportMissingImports=false

from typing import Any

import jax
import numpy as np
from gymnasium import spaces
from jaxtyping import Array
from stable_baselines3.common.vec_env import VecEnv

from foveate.learning.sb3.network import flat_inputs
from foveate.policies.attention import AttentionSettings
from foveate.simulation.batch import Batch, CompiledEnvironments
from foveate.simulation.environment import Environment
from foveate.simulation.records import Observation
from foveate.types import Key, Scalar


class TargetsVecEnv(VecEnv):
    """`count` environments in one batch; observations are rows of `flat_inputs`, actions in [-1, 1] for each axis.

    The horizon belongs to the task: the end of an episode is `terminated`, never `TimeLimit.truncated`, so that no
    learner bootstraps from a value beyond it. Then `infos[i]` holds the last observation as "terminal_observation", the
    last score as "score", and the sum of rewards (times `reward_scale`) and the length as "episode".
    """

    def __init__(
        self, environment: Environment, settings: AttentionSettings, count: int, key: Key, reward_scale: float = 1.0
    ) -> None:
        def features(observation: Observation, left: Scalar) -> Array:
            return flat_inputs(environment.problem, settings, observation, left)

        self._batch = Batch(CompiledEnvironments(environment, features, count))
        self._key, self._reward_scale = key, reward_scale
        self._actions = np.zeros((count, self._batch.axes), np.float32)
        self._returns = np.zeros(count)
        size = self._batch.programs.observed.shape[1]
        rows = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        super().__init__(count, rows, spaces.Box(-1.0, 1.0, self._actions.shape[1:], np.float32))

    def reset(self) -> np.ndarray:
        """Begin a new episode in every environment; the same ones after the same `seed`."""
        if self._seeds[0] is not None:
            self._key = jax.random.key(self._seeds[0])
        self._reset_seeds()
        self._key, key = jax.random.split(self._key)
        self._returns[:] = 0.0
        return self._batch.renew(jax.random.split(key, self.num_envs))[0]

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions for `step_wait`."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the step; return observations, rewards, ends, and infos of ended episodes."""
        steps = self._batch.step(self._actions)
        reward = self._reward_scale * steps.reward
        self._returns += reward
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(steps.done):
            infos[i] = {
                "terminal_observation": steps.final[i],
                "TimeLimit.truncated": False,
                "score": float(steps.score[i]),
                "episode": {"r": float(self._returns[i]), "l": int(steps.length[i])},
            }
        self._returns[steps.done] = 0.0
        return steps.observed, reward, steps.done, infos

    def close(self) -> None:
        """Do nothing: no resource is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute, once per environment: all are alike."""
        value = None if attr_name == "render_mode" else getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Unsupported: there is one program for all environments."""
        raise NotImplementedError(f"{attr_name}: these environments are one compiled program and cannot be changed")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Unsupported: there is no object per environment."""
        raise NotImplementedError(f"{method_name}: these environments are one compiled program without methods")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Always False: no environment is wrapped."""
        return [False for _ in self._get_indices(indices)]
