"""The stages of a step in which obstacles hide targets."""

import jax.numpy as jnp

from foveate.models.problem import Problem
from foveate.simulation.draft import Draft
from foveate.simulation.records import Protocol


def hide(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Take out of view the targets that an obstacle hides, by their true positions."""
    sensed, reality, obstacles = draft.sensed, draft.instant.truth, problem.obstacles
    assert sensed is not None, "a stage of episodes with truth"
    assert reality is not None, "a stage of episodes with truth"
    assert obstacles is not None, "a stage of problems with obstacles"
    eye, positions_world = problem.agent.space.position(draft.state.pose), problem.motion.position(reality.state)
    in_view = obstacles.sees(eye, positions_world, sensed.in_view)
    return draft._replace(sensed=sensed._replace(in_view=in_view), measured=in_view)


def weigh_sight(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Multiply the soft weight of the view by that of the line of sight, to the position that the view's was of."""
    obstacles, truth = problem.obstacles, draft.instant.truth
    assert obstacles is not None, "a stage of problems with obstacles"
    state = draft.predicted.mean if truth is None or not protocol.at_truth else truth.state
    eye, positions_world = problem.agent.space.position(draft.state.pose), problem.motion.position(state)
    weights = [obstacles.weight(eye, positions_world, level) for level in protocol.levels]
    return draft._replace(weight=draft.weight * jnp.stack(weights))
