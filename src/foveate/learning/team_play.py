"""Trajectories of a team: one for each robot, of its own decisions, all with the team's reward.

The critic is told the tokens of all robots, as of one set: it sees what no robot of a lossy radio does. It is discarded
after training, so that each robot decides alone (Lowe 2017; Yu 2022, "MAPPO").
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from foveate.experiment.learners import Objective
from foveate.geometry.linalg import log_det_spd
from foveate.learning.trajectories import Trajectory, rewards, sampled
from foveate.models.problem import Problem
from foveate.policies.pointer import PointerPolicy, command
from foveate.policies.tokens import Tokens
from foveate.simulation.records import Episode, Protocol, State, per_target
from foveate.simulation.scans import expected
from foveate.simulation.team import step
from foveate.simulation.team.rollout import TeamOutcome, simulate
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

    def decide(observation, memory, key):
        mode, sample = sampled(policy, observation, action_std, key)
        return command(observation, sample.action), policy.claimed(observation, mode), memory, sample

    def record(done: TeamOutcome):
        central = done.state.central
        gospa = expected(problem, central).get("expected_gospa") if isinstance(central, State) else None
        log_det = jnp.mean(log_det_spd(central.information), axis=0)
        return done.notes, log_det, jnp.any(done.drafts.measured, axis=0), gospa

    last, (sample, log_det, visible, gospa) = simulate(problem, decide, episode, protocol, key, record, state=state)
    problem = problem.of_map(episode.map_number)
    predicted = step.predict(problem, last, following)
    after = jax.vmap(policy.tokens)(step.observations(problem, last, predicted, following, episode.horizon))
    tokens = jax.tree.map(lambda x, y: jnp.concatenate([x, y[None]]), sample.tokens, after)
    first = per_target(jnp.mean(log_det_spd(state.central.information), axis=0), episode.present)
    if gospa is None:
        reward = rewards(log_det, visible, first, episode, objective, discounted, whole)
    else:
        reward = -gospa / (episode.horizon.astype(gospa.dtype) if whole else 1.0)
    number = first_step + jnp.arange(len(reward))
    counts = number < ends
    reward = jnp.where(counts, reward, 0.0)
    seen = as_one_set(tokens)

    def of_robot(tokens: Tokens, action, density) -> Trajectory:
        return Trajectory(tokens, action, density, reward, counts, number == ends - 1, seen)

    return jax.vmap(of_robot, (1, 1, 1))(tokens, sample.action, sample.log_density), last


def as_one_set(tokens: Tokens) -> Tokens:
    """Tokens (K, M, n, ..) of all robots as those (K, M n, ..) of one, with the first's unit: no critic reads it."""

    def joined(x):
        return x.reshape(x.shape[0], -1, *x.shape[3:])

    parts = {name: joined(getattr(tokens, name)) for name in ("features", "aim", "urgency", "present")}
    return Tokens(**parts, unit=tokens.unit[:, 0])
