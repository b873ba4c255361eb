"""Receding-horizon planning: at every step, plan on the current belief and take the first action.

Each target's later inputs are predicted as the mean of its inputs so far. The robots of a team plan in turn: in
each step one of them may change its plan, and the others improve the one that they have. Each sends how often its plan
looks at each target, and these looks are measurements in the plans of the others.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.models.problem import Problem
from foveate.models.sensor import Softness
from foveate.planning.shooting import PlanSettings, ascend, plan
from foveate.planning.tours import best_range, straight_ahead
from foveate.simulation.information import believed_future, looks
from foveate.simulation.records import Episode, Instant, Observation, Policy, Protocol, State
from foveate.simulation.rollout import decider, simulate
from foveate.simulation.step import act
from foveate.simulation.team.records import TeamView
from foveate.types import Action, Count, Information, Key

MAX_WARM_START_ACTION = 0.99
"""Largest size of a policy's action that an ascent starts from: at the limits, +-1, tanh has no gradient."""


class FixedActions(Policy):
    """Takes a fixed sequence of actions, whatever it observes."""

    action: Float[Array, "K m"]

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The action of this step."""
        return self.action[observation.step], memory


class OpenLoop(Policy):
    """Plans all `steps` of the episode at its start; the random numbers of its tours are the same in every episode."""

    problem: Problem
    settings: PlanSettings = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def start(self, observation: Observation) -> Float[Array, "K m"]:
        """The actions of the plan; all later inputs are predicted to equal the first."""
        known_input, steps = observation.known_input, self.steps
        future = believed_future(self.problem, observation, known_input, steps, jnp.array(steps))
        return plan(self.problem, future, self.settings, jax.random.key(0)).action

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The action of this step."""
        return memory[observation.step], memory


class Memory(eqx.Module):
    """Memory of a planner: the last plan without its first step, the sum of the inputs of `steps` steps, the policy's.

    The planner counts the steps itself: on a robot its memory may begin later than the observations. `looks` are those
    of the last plan at each target in a step, for the others of a team.
    """

    raw: Float[Array, "K m"]
    total_input: Float[Array, "n m_y"]
    steps: Count
    policy: Any
    looks: Float[Array, " n"]


class Receding(Policy):
    """Plans again at every step, from its last plan and, with a policy, also from that policy's predicted actions.

    A plan covers the next `window` steps, at most to the end of the episode.
    """

    problem: Problem
    settings: PlanSettings = eqx.field(static=True)
    window: int = eqx.field(static=True)
    policy: Policy | None = None

    def start(self, observation: Observation) -> Memory:
        """A plan straight ahead, and no inputs yet."""
        memory = None if self.policy is None else self.policy.start(observation)
        raw, total = straight_ahead(self.problem, self.window), jnp.zeros_like(observation.known_input)
        return Memory(raw, total, jnp.zeros((), int), memory, jnp.zeros_like(observation.mean[:, 0]))

    def claims(self, observation: Observation, memory: Memory) -> Float[Array, " n"]:
        """The looks of the plan at each target in a step."""
        return memory.looks

    def __call__(self, observation: Observation, memory: Memory, key: Key) -> tuple[Action, Memory]:
        """The first action of the best plan for the predicted future."""
        plan_key, policy_key = jax.random.split(key)
        total = memory.total_input + observation.known_input
        mean_input = total / jnp.asarray(memory.steps + 1, total.dtype)
        team = observation.team
        problem = self.problem if team is None else self.problem.of_robot(team.number)
        future = believed_future(problem, observation, mean_input, self.window, jnp.maximum(observation.left, 1))
        if team is not None:
            expected = looks_of_mates(team, self.window)
            future = replace(future, mates=expected[:, None, None] * information_of_a_look(problem, observation))
        starts, inner = memory.raw[None], memory.policy
        if self.policy is not None:
            action, inner = self._policy_actions(self.policy, observation, inner, mean_input, policy_key)
            raw = jnp.arctanh(jnp.clip(action, -MAX_WARM_START_ACTION, MAX_WARM_START_ACTION))
            starts = jnp.concatenate([raw[None], starts])
        raw, told = plan(problem, future, self.settings, plan_key, starts).raw, memory.looks
        if team is not None:
            if self.settings.starts > 1:
                kept = ascend(problem, future, memory.raw, self.settings).raw
                raw = jnp.where(has_turn(team, memory.steps), raw, kept)
            keep = None if self.settings.keep is None else Softness(*self.settings.keep)
            told = looks(problem, future, jnp.tanh(raw), keep)
        shifted = jnp.concatenate([raw[1:], straight_ahead(problem, 1)])
        return jnp.tanh(raw[0]), Memory(shifted, total, memory.steps + 1, inner, told)

    def _policy_actions(
        self, policy: Policy, observation: Observation, memory: Any, mean_input: Float[Array, "n m_y"], key: Key
    ) -> tuple[Float[Array, "window m"], Any]:
        """The policy's actions in its predicted future, in a soft view; its memory after the first one."""
        protocol = Protocol(levels=(Softness(*self.settings.last),))
        belief = (observation.mean, observation.information[None], observation.present)
        problem = self.problem.of_map(observation.map_number)
        contacts = None if problem.obstacles is None else jnp.zeros((), int)
        predicted = State(observation.step, observation.pose, *belief, contacts=contacts)
        action, memory = policy(observation, memory, jax.random.fold_in(key, observation.step))
        after = act(problem, protocol, predicted, Instant(observation.known_input, None, None), action).state
        inputs = jnp.broadcast_to(mean_input, (self.window - 1, *mean_input.shape))
        ends = {"horizon": observation.step + observation.left, "map_number": observation.map_number}
        future = Episode(after.pose, after.mean, after.present, inputs, **ends)
        rest = (future, protocol, key, lambda done: done.action)
        later = simulate(problem, decider(policy), *rest, memory=memory, state=after)
        return jnp.concatenate([action[None], later]), memory


def has_turn(team: TeamView, step: Count) -> Bool[Array, ""]:
    """True for the robot whose turn it is to plan, and for those that have not had one yet.

    If all planned in every step, two that look at the same target could leave it together, and come back together.
    """
    return (step % len(team.age) == team.number) | (step < team.number)


def information_of_a_look(problem: Problem, observation: Observation) -> Information:
    """Information of a measurement where this robot sees best, for the looks of others, whose places are unknown."""
    ahead = jnp.zeros(problem.agent.space.dimension).at[0].set(best_range(problem.sensor.view))
    return problem.sensor.gain(problem.agent.space.rotation(observation.pose), ahead)


def looks_of_mates(team: TeamView, window: int) -> Float[Array, " n"]:
    """Looks at each target in a step by the plans of the others, less the share of these that is over."""
    left = jnp.clip(1.0 - team.age.astype(team.claims.dtype) / window, 0.0, 1.0)
    return jnp.sum(jnp.where(jnp.arange(len(left)) == team.number, 0.0, left)[:, None] * team.claims, axis=0)
