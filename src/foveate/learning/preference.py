"""The first preference among targets: that of the heuristic which does best, so that training can only add."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

from foveate.learning.devices import from_first_process
from foveate.policies.pointer import PREFERENCE, PointerPolicy
from foveate.simulation.records import Policy

PREFERENCES = (PREFERENCE, (1.0, 0.0), (1.0, 1.0), (1.0, 2.0), (0.3, 1.0), (0.05, 1.0))
"""Losses of log weight for a nat of log det, and for a step until a target is in view; the first one wins ties.

They lead from the most uncertain target to the nearest.
"""


WINDOW_LOG_WEIGHT = 2.0
"""First log weight of the dynamic window, relative to the best target, where that heuristic does best."""


def best_preference(policy: PointerPolicy, score_of: Callable[[Policy], jax.Array]) -> PointerPolicy:
    """The untrained policy with the preference of the highest score: among targets, or for the dynamic window."""
    first = policy.preference  # in a team with a third number, which stays
    candidates = [replace(policy, preference=first.at[:2].set(jnp.array(each))) for each in PREFERENCES]
    if policy.window_log_weight is not None:
        weight = jnp.full_like(policy.window_log_weight, WINDOW_LOG_WEIGHT)
        candidates.append(replace(policy, window_log_weight=weight))
    scores = from_first_process(*(float(score_of(each)) for each in candidates))
    return candidates[scores.index(max(scores))]
