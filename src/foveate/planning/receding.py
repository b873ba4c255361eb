"""Planning in receding horizon: at every step a new plan, on the belief of that step; its first action is done.

The agent knows the inputs up to now and takes their mean so far, each target's own, for all later ones.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.models.problem import Problem
from foveate.models.sensor import Softness
from foveate.planning.information import Future
from foveate.planning.shooting import PlanSettings, plan
from foveate.planning.tours import straight_ahead
from foveate.simulation.records import Episode, Instant, Observation, Policy, Protocol, State
from foveate.simulation.rollout import following, simulate
from foveate.simulation.step import act
from foveate.types import Action, Count, Key

SURE = 0.99
"""How near to the limits of the controls the actions of a policy are taken: at them tanh has no gradient."""


class Given(Policy):
    """Does what it was told, whatever it sees."""

    action: Float[Array, "K m"]

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The action of this step."""
        return self.action[observation.step], memory


class OpenLoop(Policy):
    """Plans once, at the start, for all `steps` of the episode; its tours are the same in every episode."""

    problem: Problem
    settings: PlanSettings = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def start(self, observation: Observation) -> Float[Array, "K m"]:
        """The actions of the plan: all later inputs are taken to be like the first."""
        horizon = jnp.array(self.steps)
        future = believed_future(self.problem, observation, observation.known_input, self.steps, horizon)
        return plan(self.problem, future, self.settings, jax.random.key(0)).action

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The action of this step."""
        return memory[observation.step], memory


class Memory(eqx.Module):
    """What is kept between decisions: the last plan moved on by a step, the sum of the inputs, the policy's memory."""

    raw: Float[Array, "K m"]
    total_input: Float[Array, "n m_y"]
    policy: Any


class Receding(Policy):
    """Plans anew at every step, from its last plan; with a policy, also from what that would do.

    A plan goes to the end of the episode, which it is told has `horizon` steps, or over the next `window` steps.
    """

    problem: Problem
    settings: PlanSettings = eqx.field(static=True)
    window: int = eqx.field(static=True)
    horizon: Count
    policy: Policy | None = None

    def start(self, observation: Observation) -> Memory:
        """Straight ahead, nothing known yet."""
        return Memory(
            raw=straight_ahead(self.problem, self.window),
            total_input=jnp.zeros_like(observation.known_input),
            policy=None if self.policy is None else self.policy.start(observation),
        )

    def __call__(self, observation: Observation, memory: Memory, key: Key) -> tuple[Action, Memory]:
        """The first action of the best plan for the believed future."""
        plan_key, policy_key = jax.random.split(key)
        total = memory.total_input + observation.known_input
        later_input = total / jnp.asarray(observation.step + 1, total.dtype)
        left = jnp.maximum(self.horizon - observation.step, 1)
        future = believed_future(self.problem, observation, later_input, self.window, left)
        given, inner = memory.raw[None], memory.policy
        if self.policy is not None:
            level = Softness(*self.settings.last)
            action, inner = foreseen_actions(
                self.problem, self.policy, observation, inner, later_input, self.window, level, policy_key
            )
            raw = jnp.arctanh(jnp.clip(action, -SURE, SURE))
            given = jnp.concatenate([raw[None], given])
        best = plan(self.problem, future, self.settings, plan_key, given)
        moved_on = jnp.concatenate([best.raw[1:], straight_ahead(self.problem, 1)])
        return best.action[0], Memory(moved_on, total, inner)


def believed_future(
    problem: Problem, observation: Observation, later_input: Float[Array, "n m_y"], window: int, horizon: Count
) -> Future:
    """Where the targets will be if they move as expected with `later_input` at every later step."""

    def advance(state, _):
        return problem.motion.advance(state, later_input), state

    return Future(
        pose=observation.pose,
        state=jax.lax.scan(advance, observation.mean, None, window)[1],
        information=observation.information,
        present=observation.present,
        horizon=jnp.minimum(horizon, window),
    )


def foreseen_actions(
    problem: Problem,
    policy: Policy,
    observation: Observation,
    memory: Any,
    later_input: Float[Array, "n m_y"],
    window: int,
    level: Softness,
    key: Key,
) -> tuple[Float[Array, "window m"], Any]:
    """What a policy would do in its believed future under a soft view, and its memory after the first decision."""
    protocol = Protocol(levels=(level,))
    predicted = State(
        step=observation.step,
        pose=observation.pose,
        mean=observation.mean,
        information=observation.information[None],
        present=observation.present,
    )
    action, memory = policy(observation, memory, jax.random.fold_in(key, observation.step))
    instant = Instant(observation.known_input)
    after = act(problem, protocol, predicted, instant, action).state
    future = Episode(
        pose=after.pose,
        mean=after.mean,
        present=after.present,
        inputs=jnp.broadcast_to(later_input, (window - 1, *later_input.shape)),
        horizon=observation.step + observation.left,
    )
    later = simulate(
        problem, following(policy), future, protocol, key, lambda done: done.action, memory=memory, state=after
    )
    return jnp.concatenate([action[None], later]), memory
