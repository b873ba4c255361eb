"""Policies of single robots in a team: each robot is shown its own targets only, by a rule that all of them follow.

Every robot works out the whole assignment by itself, from its own beliefs and the newest that it has heard of the
others. Where all hear the same they agree; where they do not, two may follow one target until they hear of each other.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.errors import InputError
from foveate.geometry.linalg import log_det_spd
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.names import Assignment
from foveate.policies.assignment import greedy, optimal
from foveate.policies.rules import NATS_PER_STEP
from foveate.policies.steering import steps_to_view
from foveate.simulation.records import Observation, Policy
from foveate.simulation.team.records import TeamView
from foveate.types import Action, Count, Key

KEEP_NATS = 2.0
"""How much better another assignment must be before a robot changes its target: less, and noise would decide."""

BID_STEPS = 2
"""Bids that are not newer [steps] are replaced by estimates, from where their robot was heard last."""

LOAD = 1e4
"""Cost of a second target of one robot: only where all robots have one."""

MOST_COST = 1e3
"""Largest cost of one target."""


class Share(NamedTuple):
    """The targets of a robot, and its bids for all."""

    targets: Bool[Array, " n"]
    bids: Float[Array, " n"]


class AssignedMemory(NamedTuple):
    """Memory of the policy, and the robot's share of the targets."""

    own: Any
    share: Share


class Assigned(Policy):
    """A policy that is shown the targets of its robot only; all targets, where the robot has none of its own.

    By "greedy" pairs of robot and target are taken by their distance, the nearest first. "hungarian" is the assignment
    of the least total cost, the time until a target is in view and what is known of it already, with a price for
    changes; the costs of others are estimated from where they were heard last, by their own limits and views. In an
    "auction" the robots tell each other their costs, and each works out who wins by the bids that it has heard. Where
    there are more targets than robots, each gets as many as the next, or one less.
    """

    policy: Policy
    problem: Problem
    rule: Assignment = eqx.field(static=True)

    def start(self, observation: Observation) -> AssignedMemory:
        """Assign before the first decision."""
        shown, share = first_share(self.problem, self.rule, observation)
        return AssignedMemory(self.policy.start(shown), share)

    def claims(self, observation: Observation, memory: AssignedMemory) -> Float[Array, " n"]:
        """What the robots tell each other so that all assign alike."""
        return told_of(self.rule, memory.share)

    def __call__(self, observation: Observation, memory: AssignedMemory, key: Key) -> tuple[Action, AssignedMemory]:
        """Decide as if the robot's targets were all."""
        shown, share = own_share(self.problem, self.rule, observation, memory.share)
        action, own = self.policy(shown, memory.own, key)
        return action, AssignedMemory(own, share)


def require_common_tracks(problem: Problem, name: str, rule: str) -> None:
    """Raise InputError for `name` = `rule` where detections have no ids, and robots not the same tracks."""
    right = "expected none: without ids robots have the same tracks only where every message arrives at once"
    has_common = problem.detections is None or problem.team is None or problem.team.radio.kind == "perfect"
    require(has_common, name, rule, right)


def first_share(problem: Problem, rule: Assignment, observation: Observation) -> tuple[Observation, Share]:
    """`own_share` before the first decision, or where one begins again: its own claims say which targets it has.

    Bids do not say so; an auction begins anew.
    """
    team, none = observation.team, jnp.zeros_like(observation.present)
    has = none if team is None or rule == "auction" else team.claims[team.number] > 0
    return own_share(problem, rule, observation, Share(has, jnp.zeros_like(observation.mean[:, 0])))


def told_of(rule: Assignment, share: Share) -> Float[Array, " n"]:
    """What a robot tells the others of every target: its bid in an auction, else 1 for those of its own."""
    return share.bids if rule == "auction" else share.targets.astype(share.bids.dtype)


def own_share(problem: Problem, rule: Assignment, observation: Observation, before: Share) -> tuple[Observation, Share]:
    """The observation of this robot's targets, all where it has none, and its share; `before` is that of the last step.

    Raises InputError for a single robot.
    """
    team = observation.team
    if team is None:
        raise InputError("method: expected no assignment (NAME+RULE) for a single robot")
    cost, own = _costs(problem, rule, observation, team), jnp.arange(len(team.age)) == team.number
    bids = -cost[team.number] + KEEP_NATS * before.targets.astype(cost.dtype)
    if rule == "auction":
        # Before its first message a robot has no bids; of old ones its place says more.
        is_heard = ~own & (team.age < jnp.minimum(observation.step, BID_STEPS))
        cost = jnp.where(is_heard[:, None], -team.claims, cost)
        cost = jnp.where(own[:, None], -bids, cost)
    elif rule == "hungarian":
        mine = before.targets.astype(cost.dtype)
        cost = cost - KEEP_NATS * jnp.where(own[:, None], mine, team.claims)
    chosen = shares(cost, observation.present, rule == "greedy")
    targets = chosen[team.number]
    if rule == "auction":  # its claims are bids; the policy expects 1 for a target that a robot goes for
        team = replace(team, claims=chosen.astype(cost.dtype))
    shown = jnp.where(targets.any(), targets, observation.present)
    return replace(observation, present=shown, team=team, blocking=observation.present), Share(targets, bids)


def _costs(problem: Problem, rule: Assignment, observation: Observation, team: TeamView) -> Float[Array, "M n"]:
    """Distance [m], or price [nat], of every target for every robot, where it was heard last."""
    space, positions = problem.agent.space, problem.motion.position(observation.mean)
    points_body = jax.vmap(space.to_body, (0, None))(team.pose, positions)
    if rule == "greedy":
        return jnp.linalg.norm(points_body, axis=-1)

    def steps_of(number: Count, points_body: Float[Array, "n d"]) -> Float[Array, "n 2"]:
        own = problem.of_robot(number).at(observation.step)
        extent = own.sensor.view.extent
        return jax.vmap(lambda point: steps_to_view(own.agent, own.tau, extent, point))(points_body)

    steps = jax.vmap(steps_of)(jnp.arange(len(team.age)), points_body)
    return log_det_spd(observation.information) + NATS_PER_STEP * jnp.sum(steps, axis=-1)


def shares(cost: Float[Array, "M n"], present: Bool[Array, " n"], is_greedy: bool) -> Bool[Array, "M n"]:
    """The targets of each robot: every present target has one, and no robot has two more than another."""
    robots, targets = cost.shape
    rounds = max(1, math.ceil(targets / robots))
    usable = jnp.clip(jnp.nan_to_num(cost, nan=MOST_COST), -MOST_COST, MOST_COST)
    # Robots once for each round; padding is taken last, and the same by all.
    loaded = usable + LOAD * jnp.arange(rounds, dtype=cost.dtype)[:, None, None]
    loaded = jnp.where(present, loaded, LOAD * (rounds + 1)).reshape(rounds * robots, targets)
    chosen = (greedy if is_greedy else optimal)(loaded).reshape(rounds, robots)
    return jnp.any(chosen[..., None] == jnp.arange(targets), axis=0) & present
