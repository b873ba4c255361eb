"""Trajectories of a team: one for each robot, of its own decisions.

All have the team's reward, and the critic is told the tokens of all robots, as of one set: it sees what no robot of a
lossy radio does. It is discarded after training, so that each robot decides alone (Lowe 2017; Yu 2022, "MAPPO").

Robots with assigned targets are trained as single ones: each has the reward of the targets that it is shown, and its
critic is told of these. So a robot is not rewarded for what the others do, which drowns its own part in a large team.
Without ids the expected GOSPA is not that of single tracks: reward and critic are then those of the team.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.experiment.learners import Objective
from foveate.geometry.linalg import log_det_spd
from foveate.learning.trajectories import Trajectory, rewards, sampled
from foveate.models.problem import Problem
from foveate.policies.assigned_pointer import AssignedPointer
from foveate.policies.pointer import PointerPolicy, command
from foveate.policies.tokens import Tokens
from foveate.simulation.records import Episode, Observation, Protocol, State, per_target
from foveate.simulation.scans import expected
from foveate.simulation.team import step
from foveate.simulation.team.rollout import TeamDecide, TeamOutcome, simulate
from foveate.simulation.team.step import TeamState
from foveate.types import Count, Key, Scalar


def play_team(
    problem: Problem,
    policy: PointerPolicy,
    episode: Episode,
    protocol: Protocol,
    objective: Objective,
    action_std: Scalar,
    key: Key,
    state: TeamState,
    ends: Count,
    discounted: bool,
    whole: bool,
) -> tuple[Trajectory, TeamState]:
    """Play as `trajectories.play`; the trajectory has a leading axis of robots."""
    assert episode.truth is not None, "training episodes are noisy"
    following, first_step = episode.inputs[-1], state.robots.step[0]
    episode = replace(episode, inputs=episode.inputs[: len(episode.truth.measurement_noise)])

    def record(done: TeamOutcome):
        central = done.state.central
        gospa = expected(problem, central).get("expected_gospa") if isinstance(central, State) else None
        log_det = jnp.mean(log_det_spd(central.information), axis=0)
        return done.notes, log_det, jnp.any(done.drafts.measured, axis=0), gospa

    observed = partial(_observed, problem.of_map(episode.map_number), episode)
    memory, decide = jax.vmap(policy.start)(observed(state, episode.inputs[0])), _exploring(policy, action_std)
    last, memory, found = simulate(problem, decide, episode, protocol, key, record, memory=memory, state=state)
    (sample, shown), log_det, visible, gospa = found
    told = jax.vmap(lambda seen, memory: policy.tokens(policy.shown(seen, memory)[0]))
    after = told(observed(last, following), memory)
    tokens = jax.tree.map(lambda x, y: jnp.concatenate([x, y[None]]), sample.tokens, after)
    before = jnp.mean(log_det_spd(state.central.information), axis=0)
    has_own = isinstance(policy, AssignedPointer) and gospa is None
    number, steps = first_step + jnp.arange(len(log_det)), episode.horizon.astype(log_det.dtype)
    if gospa is not None:
        reward = -gospa / (steps if whole else 1.0)
    elif has_own:
        left = steps - number.astype(steps.dtype)
        reward = own_rewards(log_det, visible, before, shown, left, steps, objective, discounted, whole)
    else:
        first = per_target(before, episode.present)
        reward = rewards(log_det, visible, first, episode, objective, discounted, whole)
    counts = number < ends
    reward = jnp.where(counts, jnp.broadcast_to(reward, (shown.shape[1], len(counts))), 0.0)
    everything = None if has_own else as_one_set(tokens)

    def of_robot(tokens: Tokens, action, density, reward) -> Trajectory:
        return Trajectory(tokens, action, density, reward, counts, number == ends - 1, everything)

    return jax.vmap(of_robot, (1, 1, 1, 0))(tokens, sample.action, sample.log_density, reward), last


def _observed(problem: Problem, episode: Episode, state: TeamState, known_input: Array) -> Observation:
    """What every robot observes before it decides, in a state."""
    return step.observations(problem, state, step.predict(problem, state, known_input), known_input, episode.horizon)


def _exploring(policy: PointerPolicy, action_std: Scalar) -> TeamDecide:
    """Decisions that are `sampled`, with the sample and the targets shown as notes."""

    def decide(observation: Observation, memory: Any, key: Key):
        seen, memory = policy.shown(observation, memory)
        mode, sample = sampled(policy, seen, action_std, key)
        memory = policy.claimed(seen, memory, mode)
        return command(seen, sample.action), policy.claims(seen, memory), memory, (sample, seen.present)

    return decide


def own_rewards(
    log_det: Float[Array, "K n"],
    visible: Bool[Array, "K n"],
    before: Float[Array, " n"],
    shown: Bool[Array, "K M n"],
    left: Float[Array, " K"],
    steps: Scalar,
    objective: Objective,
    discounted: bool,
    whole: bool,
) -> Float[Array, "M K"]:
    """Rewards of all steps as `trajectories.rewards`, of each robot for the targets that it is shown.

    `left` are the steps until the end of the episode, this one included, of `steps` in all.

    What a target's log det grows by in a step counts for the robot that has it in that step, for "mean" as often as
    there are steps left. So who takes over a target that is known well, or is rid of one that is not, gains nothing.
    """
    growth = jnp.diff(log_det, axis=0, prepend=before[None])
    values = visible.astype(log_det.dtype) if objective == "seen" else growth
    own = per_target(jnp.broadcast_to(values[:, None], shown.shape), shown)
    if objective == "terminal" or (objective == "mean" and discounted):
        return own.T
    if objective == "mean":
        own = left[:, None] * own
    return own.T / steps if whole else own.T


def as_one_set(tokens: Tokens) -> Tokens:
    """Tokens (K, M, n, ..) of all robots as those (K, M n, ..) of one, with the first's unit: no critic reads it."""

    def joined(x):
        return x.reshape(x.shape[0], -1, *x.shape[3:])

    parts = {name: joined(getattr(tokens, name)) for name in ("features", "aim", "urgency", "present")}
    return Tokens(**parts, unit=tokens.unit[:, 0])
