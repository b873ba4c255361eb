"""The stages of a step that move the agent: its own motion, and the border, targets and obstacles in its way."""

from dataclasses import replace

import jax.numpy as jnp

from foveate.models.bodies import Bodies
from foveate.models.problem import Problem
from foveate.simulation.draft import Draft, noise_covariance, positions_body
from foveate.simulation.records import Protocol
from foveate.types import Pose


def keep_off_obstacles(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Shorten the action, so that the agent keeps its distance from obstacles."""
    return draft._replace(action=problem.kept_off(draft.predicted.pose, draft.action))


def move(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """T_{k+1} = T_k exp(tau hat(u))."""
    pose = problem.agent.move(draft.predicted.pose, draft.action, problem.tau)
    return _at(draft, pose)


def stop_at_border(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """End the way where it crosses the border of the region."""
    return _at(draft, problem.within_region(draft.predicted.pose, draft.state.pose))


def keep_off_targets(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """End the way before the first target in it, at its true position after the step, or as predicted without truth.

    In a team also before another robot, at its position before the step.
    """
    truth, arrivals, scans = draft.instant.truth, draft.instant.arrivals, draft.instant.scans
    state = draft.predicted.mean if truth is None else truth.state
    present = draft.predicted.present if scans is None else scans.alive
    if arrivals is not None:
        present = present & arrivals.present
    positions_world, mates_world = problem.motion.position(state), draft.instant.mates_world
    if mates_world is not None:
        positions_world = jnp.concatenate([positions_world, mates_world])
        present = jnp.concatenate([present, jnp.ones(len(mates_world), bool)])
    return _at(draft, problem.clear_of(draft.predicted.pose, draft.state.pose, Bodies(positions_world, present)))


def stop_at_obstacles(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """End the way at the first contact with an obstacle, and count it; the agent turns as commanded."""
    pose, touches = problem.among_obstacles(draft.predicted.pose, draft.action, draft.state.pose)
    contacts = draft.state.contacts
    assert contacts is not None, "`start` counts them where there are obstacles"
    draft = _at(draft, pose)
    return draft._replace(state=replace(draft.state, contacts=contacts + touches.astype(contacts.dtype)))


def expect_noise(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """V at the predicted positions as seen from T_{k+1}, as the filter believes it."""
    pose = draft.state.pose
    position_body = positions_body(problem, pose, draft.predicted.mean)
    return draft._replace(covariance=noise_covariance(problem, pose, position_body))


def _at(draft: Draft, pose: Pose) -> Draft:
    return draft._replace(state=replace(draft.state, pose=pose))
