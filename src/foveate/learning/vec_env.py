"""The batched environment as a `VecEnv` of Stable-Baselines3: one compiled program, no Python object a copy."""

# Without the extra `ppo` there is no Stable-Baselines3 to check against.
# pyright: reportMissingImports=false

from typing import Any

import equinox as eqx
import jax
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from foveate.environment import Environment, Moment, observation, reset, step_and_reset
from foveate.learning.torch_attention import flat_inputs
from foveate.policies.attention import AttentionSettings
from foveate.types import Key


class TargetsVecEnv(VecEnv):
    """`count` environments side by side; an observation is a row of `flat_inputs`, an action in [-1, 1] an axis.

    The horizon belongs to the task, and nothing that happens after it is worth anything: the end of an episode is
    `terminated`, never `TimeLimit.truncated`, so that no learner adds the value of a state beyond it. The rows of an
    episode's end are in `infos[i]["terminal_observation"]`, its last score in `infos[i]["score"]`, and the sum of its
    rewards (as given, times `reward_scale`) and its length in `infos[i]["episode"]`, where Stable-Baselines3 looks.
    """

    def __init__(
        self, environment: Environment, settings: AttentionSettings, count: int, key: Key, reward_scale: float = 1.0
    ) -> None:
        problem = environment.problem

        def look(moment: Moment):
            left = 1.0 - moment.predicted.step / moment.episode.horizon
            return flat_inputs(problem, settings, observation(moment), left)

        def begin(keys):
            moments = jax.vmap(reset, (None, 0))(environment, keys)
            return moments, jax.vmap(look)(moments)

        def advance(moments, actions):
            length = moments.predicted.step + 1
            after, transition = step_and_reset(environment, moments, actions)
            seen = jax.vmap(lambda o: flat_inputs(problem, settings, o, 0.0 * transition.reward[0]))
            end = seen(transition.observation)
            reward = reward_scale * transition.reward
            return after, (jax.vmap(look)(after), reward, transition.done, end, transition.score, length)

        self._begin, self._advance = eqx.filter_jit(begin), eqx.filter_jit(advance, donate="all")
        self._key, self._moments = key, None
        self._actions = np.zeros((count, len(problem.agent.axes)), np.float32)
        self._returns = np.zeros(count)
        size = jax.eval_shape(begin, jax.random.split(key, 1))[1].shape[1]
        rows = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        super().__init__(count, rows, spaces.Box(-1.0, 1.0, self._actions.shape[1:], np.float32))

    def reset(self) -> np.ndarray:
        """Fresh episodes everywhere; the same ones after the same `seed`."""
        if self._seeds[0] is not None:
            self._key = jax.random.key(self._seeds[0])
        self._reset_seeds()
        self._key, key = jax.random.split(self._key)
        self._moments, rows = self._begin(jax.random.split(key, self.num_envs))
        self._returns[:] = 0.0
        return np.asarray(rows).astype(np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the step: rows, rewards, ends, and what there is to say about those that ended."""
        self._moments, numbers = self._advance(self._moments, self._actions)
        rows, reward, done, end, score, length = map(np.asarray, numbers)
        self._returns += reward
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            infos[i] = {
                "terminal_observation": end[i].astype(np.float32),
                "TimeLimit.truncated": False,
                "score": float(score[i]),
                "episode": {"r": float(self._returns[i]), "l": int(length[i])},
            }
        self._returns[done] = 0.0
        return rows.astype(np.float32), reward.astype(np.float32), np.array(done), infos

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute once for each environment; all are alike."""
        value = None if attr_name == "render_mode" else getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: there is one program for all environments."""
        raise NotImplementedError(f"{attr_name}: these environments are one compiled program and cannot be changed")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refused: there is no object for each environment."""
        raise NotImplementedError(f"{method_name}: these environments are one compiled program without methods")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No environment is wrapped."""
        return [False for _ in self._get_indices(indices)]
