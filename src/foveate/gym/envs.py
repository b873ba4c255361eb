"""Gymnasium environments (extra `gym`) over the pure simulator of `simulation/environment.py`.

    import foveate.gym
    import gymnasium

    gymnasium.register_envs(foveate.gym)  # the import has registered them: this says what it is for
    env = gymnasium.make("foveate/Tracking-v0", scenario="paper")
    envs = gymnasium.make_vec("foveate/Tracking-v0", num_envs=1024)

`gymnasium.make("foveate:foveate/Tracking-v0")` needs no import, and works in other processes, too.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from foveate.errors import InputError
from foveate.gym.task import Task, TaskSettings
from foveate.io.validate import require
from foveate.scenario.scenario import Scenario


class TrackingEnv(gymnasium.Env):
    """One agent among targets; the options are those of `TaskSettings`.

    An action has one number in [-1, 1] for each actuated axis. `reset(options={"targets": n})` gives n targets. A reset
    without a seed continues the last seed's sequence of episodes. `info["score"]` is the mean log det per target [nat].
    A copy or a pickle continues the running episode.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 4}  # noqa: RUF012

    def __init__(
        self, scenario: Scenario | str | Path = "paper", render_mode: str | None = None, **options: Any
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode = {render_mode!r}: expected None, 'rgb_array' or 'human'")
        self._task = Task(TaskSettings(scenario, **options), 1, autoreset=False)
        self.observation_space, self.action_space = self._task.observation_space, self._task.action_space
        self.render_mode, self._over = render_mode, True
        self._screen = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; return its first observation, and the score of the initial beliefs as info."""
        super().reset(seed=seed)
        batch, targets = self._task.batch, self._task.targets(options or {})
        seen, score = batch.renew(self._task.keys([seed], self.np_random), targets=targets)
        self._over = False
        if self.render_mode is not None and self._screen is None:
            from foveate.gym.render import Screen

            self._screen = Screen(self._task.problem, window=self.render_mode == "human")
        if self._screen:
            self._screen.begin(batch)
        return self._task.observation(seen, 0), {"score": float(score[0])}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move, measure, update; ResetNeeded without a running episode."""
        if self._over:
            raise ResetNeeded("no episode has begun: call reset() first")
        steps = self._task.batch.step(self._task.actions(np.asarray(action)[None]))
        terminated, truncated = (bool(flag[0]) for flag in self._task.ends(steps.done))
        self._over = terminated or truncated
        if self._screen:
            self._screen.add(self._task.batch)
        seen = self._task.observation(steps.observed, 0)
        info = {"score": float(steps.score[0]), **{name: int(x[0]) for name, x in self._task.contacts.items()}}
        return seen, float(steps.reward[0]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """Picture of the episode so far (height, width, 3); None with a window, which shows every step by itself."""
        return self._screen.picture() if self._screen and self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window, if any."""
        if self._screen:
            self._screen.close()


class TrackingVectorEnv(VectorEnv):
    """`num_envs` environments in one compiled program; the options are those of `TaskSettings`.

    Environment i of `reset(seed=s)` has the episodes of a `TrackingEnv` with seed s + i. `autoreset_mode` is SAME_STEP
    (the end of an episode is in `infos["final_obs"]` and `infos["final_info"]`) or DISABLED, where
    `reset(options={"reset_mask": mask})` begins new episodes where the mask is true.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Scenario | str | Path = "paper",
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if num_envs < 1:
            raise InputError(f"num_envs = {num_envs}: expected >= 1")
        if render_mode is not None:
            raise InputError(f"render_mode = {render_mode!r}: expected None: render a single environment")
        modes = (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)
        if autoreset_mode not in (*modes, *(mode.value for mode in modes)):
            raise InputError(f"autoreset_mode = {autoreset_mode!r}: expected SAME_STEP or DISABLED")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._autoreset = self.autoreset_mode == AutoresetMode.SAME_STEP
        self.num_envs, self._task = num_envs, Task(TaskSettings(scenario, **options), num_envs, self._autoreset)
        self.single_observation_space = self._task.observation_space
        self.single_action_space = self._task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.ones(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes everywhere, or where `options["reset_mask"]` is true; without a seed sequences continue."""
        seeds = [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
            seeds = [int(seed) + i for i in range(self.num_envs)]
        elif seed is not None:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(f"seed has {len(seeds)} numbers: expected {self.num_envs}, one an environment")
        options, batch = options or {}, self._task.batch
        targets, mask = self._task.targets(options), self._mask(options)
        if batch.states is None and not mask.all():
            raise ResetNeeded("options['reset_mask']: no episode has begun yet: reset all first")
        seen, score = batch.renew(self._task.keys(seeds, self.np_random), mask, targets)
        self._over = self._over & ~mask
        return self._task.observation(seen), {"score": score, "_score": np.ones(self.num_envs, bool)}

    def _mask(self, options: Mapping[str, Any]) -> np.ndarray:
        mask = options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, bool)
        valid = isinstance(mask, np.ndarray) and mask.shape == (self.num_envs,) and mask.dtype == bool and mask.any()
        right = f"expected a numpy array of {self.num_envs} booleans, at least one of them true"
        require(valid, "options['reset_mask']", mask, right)
        return mask

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step every environment; ResetNeeded where any has no running episode."""
        if self._over.any():
            raise ResetNeeded(f"{self._over.sum()} environments have no running episode: reset them first")
        steps = self._task.batch.step(self._task.actions(actions))
        infos: dict[str, Any] = {"score": steps.next_score, "_score": np.ones(self.num_envs, bool)}
        infos |= self._task.contacts
        if not self._autoreset:
            self._over = steps.done
        elif steps.done.any():
            infos |= self._finals(steps)
        terminated, truncated = self._task.ends(steps.done)
        return self._task.observation(steps.observed), steps.reward.astype(np.float64), terminated, truncated, infos

    def _finals(self, steps: Any) -> dict[str, Any]:
        """Last observations and infos of the finished episodes, in the form of Gymnasium's vector environments."""
        done, final_obs = steps.done, np.full(self.num_envs, None, object)
        for i in np.flatnonzero(done).tolist():
            final_obs[i] = self._task.observation(steps.final, i)
        info = {"score": np.where(done, steps.score, 0.0), "_score": done.copy()}
        return {"final_obs": final_obs, "_final_obs": done.copy(), "final_info": info, "_final_info": done.copy()}
