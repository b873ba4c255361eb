"""A team as an environment of PettingZoo's parallel API (extra `pettingzoo`): every robot acts in every step."""

import functools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jaxtyping import Array, Float

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ImportError("foveate.gym.TeamEnv needs pettingzoo: pip install 'foveate[pettingzoo]'") from error

from foveate.errors import InputError
from foveate.experiment.resolve import experiment_from
from foveate.geometry.linalg import log_det_spd
from foveate.gym.task import BOUND
from foveate.models.problem import Problem
from foveate.policies.inputs import masked_features
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, Episode, Observation, per_target
from foveate.simulation.step import instants
from foveate.simulation.team import step
from foveate.simulation.team.step import TeamState
from foveate.types import Key, Scalar

PROTOCOL = PROTOCOLS["true"]
FRESH_STEPS = 10.0
"""Age at which the news of a mate counts for a third."""


class _Programs(NamedTuple):
    """Compiled programs of a scenario: they return what each robot is told, and the score of all measurements."""

    begin: Any
    advance: Any


class TeamEnv(ParallelEnv):
    """Robots `robot_0`, .. that share one reward: the growth of the mean log det per target of all measurements [nat].

    An observation has the features of `foveate.gym.TrackingEnv` in the robot's own frame, from its own beliefs, and
    `mates`: of every other robot its position and how fresh that news is. An action has one number in [-1, 1] for each
    actuated axis. Episodes are those of training, with noise, and end as truncated. Infos have the `score` of the
    robot's own beliefs [nat per target]. Raises InputError for a scenario without a team, and for
    detections without ids.
    """

    metadata: dict[str, Any] = {"render_modes": [], "name": "foveate_team_v0", "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, scenario: Scenario | str | Path) -> None:
        chosen = experiment_from(scenario).scenario
        problem = chosen.problem()
        if problem.team is None:
            raise InputError("scenario.team: expected a team of at least 2 robots")
        if problem.detections is not None:
            raise InputError("scenario.detections: expected none: the robots of this environment know targets by ids")
        self.possible_agents = [f"robot_{i}" for i in range(problem.team.agents)]
        self.agents: list[str] = []
        self.render_mode = None
        self._programs = _compiled(chosen)
        self._rng = np.random.default_rng()
        self._episode: Episode | None = None
        self._state: TeamState | None = None
        shapes = jax.eval_shape(self._programs.begin, jax.random.key(0))[2]
        self._spaces = spaces.Dict(
            {name: spaces.Box(-BOUND, BOUND, x.shape[1:], np.float32) for name, x in shapes.items()}
        )
        self._action = spaces.Box(-1.0, 1.0, (len(problem.agent.axes),), np.float32)
        self.observation_spaces = dict.fromkeys(self.possible_agents, self._spaces)
        self.action_spaces = dict.fromkeys(self.possible_agents, self._action)

    def observation_space(self, agent: str) -> spaces.Space:
        """The space of a robot's observations: the same for all."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """The space of a robot's actions: the same for all."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; without a seed the sequence of episodes continues. There are no options."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        key = jax.random.key(int(self._rng.integers(2**63)))
        self.agents = list(self.possible_agents)
        self._episode, self._state, seen, scores, self._score = self._programs.begin(key)
        return self._each(seen), self._infos(scores)

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Move all robots, measure, exchange; every robot of a running episode must have an action."""
        if not self.agents:
            return {}, {}, {}, {}, {}
        if missing := [name for name in self.agents if name not in actions]:
            raise InputError(f"actions: none for {missing[0]}: expected one for every robot")
        chosen = np.stack([np.asarray(actions[name], np.float32) for name in self.agents])
        self._state, seen, scores, score, done = self._programs.advance(self._episode, self._state, chosen)
        reward, over, agents = float(score - self._score), bool(done), self.agents
        self._score = score
        observations, infos = self._each(seen), self._infos(scores)
        self.agents = [] if over else agents
        rewards = dict.fromkeys(agents, reward)
        return observations, rewards, dict.fromkeys(agents, False), dict.fromkeys(agents, over), infos

    def render(self) -> None:
        """Pictures are of evaluations: see `foveate render`."""

    def _each(self, seen: dict[str, Array]) -> dict[str, Any]:
        arrays = {name: np.array(x, np.float32) for name, x in seen.items()}
        return {agent: {name: x[i] for name, x in arrays.items()} for i, agent in enumerate(self.agents)}

    def _infos(self, scores: Float[Array, " M"]) -> dict[str, Any]:
        return {agent: {"score": float(score)} for agent, score in zip(self.agents, scores, strict=True)}


@functools.lru_cache(maxsize=8)
def _compiled(scenario: Scenario) -> _Programs:
    problem, length_m = scenario.problem(), max(float(kind.view.depth_m) for kind in scenario.kinds)

    def features(observation: Observation) -> dict[str, Array]:
        left = observation.left / (observation.step + observation.left)
        seen = masked_features(observation, left, problem.agent.space, "body", length_m, "asinh")
        return {**seen._asdict(), "mates": _mates(problem, observation, length_m)}

    def observed(episode: Episode, state: TeamState) -> tuple[dict[str, Array], Float[Array, " M"], Scalar]:
        number = jnp.minimum(state.robots.step[0], len(episode.inputs) - 1)
        predicted = step.predict(problem, state, episode.inputs[number])
        seen = step.observations(problem, state, predicted, episode.inputs[number], episode.horizon)
        own = jax.vmap(per_target, (0, None))(log_det_spd(state.robots.information[:, -1]), episode.present)
        return jax.vmap(features)(seen), own, per_target(log_det_spd(state.central.information[-1]), episode.present)

    def begin(key: Key) -> tuple[Any, ...]:
        episode = training_episode(problem, scenario.scenes, key, noise=True)
        state = step.start(problem.of_map(episode.map_number), episode, PROTOCOL)
        return (episode, state, *observed(episode, state))

    def advance(episode: Episode, state: TeamState, actions: Float[Array, "M m"]) -> tuple[Any, ...]:
        number, team = state.robots.step[0], episode.team
        assert team is not None, "of a team's episodes"
        instant = jax.tree.map(lambda x: x[number], instants(episode))
        draws = team.of_steps(lambda x: x[number])
        here = problem.of_map(episode.map_number)
        predicted = step.predict(here, state, instant.known_input)
        claims = jnp.zeros((len(actions), episode.mean.shape[0]), episode.mean.dtype)
        decided = jnp.asarray(actions, episode.mean.dtype), claims
        after, _, _ = step.act(here, PROTOCOL, state, predicted, instant, draws, decided)
        return (after, *observed(episode, after), after.robots.step[0] >= episode.horizon)

    return _Programs(jax.jit(begin), jax.jit(advance))


def _mates(problem: Problem, observation: Observation, length_m: float) -> Float[Array, "mates features"]:
    """Position of every other robot in the body frame, in units of `length_m` [m], and how fresh it is, 0 to 1."""
    team, space = observation.team, problem.agent.space
    assert team is not None, "of a team's robot"
    count = len(team.age)
    others = (team.number + jnp.arange(1, count)) % count
    positions = jax.vmap(space.position)(team.pose[others])
    fresh = jnp.exp(-team.age[others].astype(positions.dtype) / FRESH_STEPS)
    return jnp.concatenate([space.to_body(observation.pose, positions) / length_m, fresh[:, None]], axis=-1)
