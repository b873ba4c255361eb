"""Measures of the robots of a team: the worst of their own beliefs, and whether these are as good as they claim."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from foveate.evaluation.metrics import by_objective
from foveate.names import Objective
from foveate.scenario.scenes import Scene
from foveate.simulation.team.records import TeamTrace


def team_measures(
    trace: TeamTrace | None, scenes: Sequence[Scene], objective: Objective | None = None
) -> list[dict[str, Any]]:
    """Measure the robots of each episode, for its row; nothing of a single robot."""
    if trace is None:
        return [{} for _ in scenes]
    return [_measures(trace, i, scene, objective) for i, scene in enumerate(scenes)]


def _measures(trace: TeamTrace, i: int, scene: Scene, objective: Objective | None) -> dict[str, Any]:
    assert trace.nees is not None, "of targets with ids"
    n, last, agents = len(scene.targets), scene.horizon, trace.log_det.shape[2]
    if n == 0:
        return {"agents": agents}
    log_det: Float[np.ndarray, "K M n"] = np.asarray(trace.log_det[i, :last, :, :n], float)
    visible = np.asarray(trace.visible[i, :last, :, :n], float)
    scores = log_det[-1].mean(axis=-1)
    by_robot = [by_objective(objective, scores[m], log_det[:, m], visible[:, m].mean()) for m in range(agents)]
    return {
        "agents": agents,
        "worst_score": float(scores.min()),
        "worst_objective": None if objective is None else float(min(x for x in by_robot if x is not None)),
        "members_nees": float(np.mean(trace.nees[i, last - 1, :, :n])),
    }
