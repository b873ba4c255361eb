"""Settings of pointer networks, and the networks that they make."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from foveate.io.settings import Settings, tag
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.names import Assignment, Objective
from foveate.policies.assigned import require_common_tracks
from foveate.policies.assigned_pointer import AssignedPointer
from foveate.policies.layers import SetEncoder, fresh_layers
from foveate.policies.pointer import FREE_LOG_WEIGHT, NO_LIMIT, PREFERENCE, PointerPolicy
from foveate.policies.tokens import token_size, untold
from foveate.types import Key

FIRST_SCALE = 0.01
"""Factor of the first random weights of the last layers: the untrained policy is the heuristic."""

OTHERS_LOG_WEIGHT = 8.0
"""First log weight lost by targets that are assigned to other robots of a team."""

MAX_RAYS = 256
"""Most rays of a policy."""


@dataclass(frozen=True, kw_only=True)
class PointerSettings(Settings):
    """Settings of a pointer network.

    `heads` is the number of attention queries that pool the targets into the context, `modes` the number of actions
    proposed for each target, the first of them aimed. With `tells_time` it is told the steps that are
    left; None leaves that to the learner, whose objective may depend on them.

    In a team it is told of its mates, and decides by itself which targets to leave to them. With an `assignment` it is
    shown its own targets only, by that rule (`policies.assigned`): then it is the network of a single robot, may begin
    with the weights of one, and is rewarded for its own targets. A single robot has none to share, and no rule.

    The network has the same shape for every robot of a space. `begin_with`, a preset or a run folder, gives the weights
    that a training begins with.
    """

    REMOVED: ClassVar[tuple[str, ...]] = ("mode_widths", "length_m")
    kind: Literal["pointer"] = tag("pointer")
    target_widths: tuple[int, ...] = (64, 64)
    """Layers on each target."""
    heads: int = 4
    context_widths: tuple[int, ...] = (64, 64)
    """Layers on the context."""
    mode_width: int = 64
    """Layer before the modes."""
    modes: int = 2
    tells_time: bool | None = None
    begin_with: str | None = None
    rays: int = 0
    """Number of rays along which it is told free ranges. With any it is also told the ways around obstacles, and aims
    along them; 0: it knows of no obstacles."""
    dynamic_window: bool = False
    """Proposes the command of the heuristic `window`, too, and is told what that expects of steering to each target: a
    training then begins about as good as `window`; with `begin_with`, as that network is. It knows of no obstacles; not
    with rays, nor trained for detections without ids."""

    assignment: Assignment | None = None
    """Rule that assigns targets to the robots of a team: greedy, hungarian or auction."""

    clips_features: bool = False
    """Clips what it is told to the range of its worlds: familiar numbers decide in others, too. In a team only
    with an `assignment`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("target_widths", "context_widths"):
            widths = getattr(self, name)
            require(min(widths, default=0) >= 1, name, widths, "expected at least one width, each >= 1")
        for name in ("heads", "modes", "mode_width"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "expected >= 1")
        require(0 <= self.rays <= MAX_RAYS, "rays", self.rays, f"expected 0 to {MAX_RAYS}")

    def fits_window(self, problem: Problem) -> bool:
        """True if the network may propose the dynamic window's command."""
        return self.rays == 0 and problem.detections is None

    def policy(
        self,
        problem: Problem,
        key: Key,
        objective: Objective = "terminal",
        others: Collection[Objective] = (),
    ) -> PointerPolicy:
        """A network with random weights, sized for the problem's space, and told the objective.

        `others` are further objectives of its training, as in worlds of random robots.
        """
        may_propose = self.fits_window(problem) or not self.dynamic_window
        right = "expected false with rays, and with detections without ids"
        require(may_propose, "policy.dynamic_window", self.dynamic_window, right)
        if self.assignment is not None:
            require_common_tracks(problem, "policy.assignment", self.assignment)
            problem = replace(problem, team=None)
        axes, embedding, context = problem.agent.space.twist_size, self.target_widths[-1], self.context_widths[-1]
        widths = (
            (token_size(problem, self.rays, self.dynamic_window), *self.target_widths),
            (embedding, self.heads),
            (self.heads * embedding, *self.context_widths),
            (embedding, self.mode_width),
            (context, self.mode_width),
            (self.mode_width, self.modes * (1 + axes)),
            (context, (1 + self.dynamic_window) * (1 + axes)),
        )
        target, query, context_layers, *heads = fresh_layers(widths, key)
        # What a training never tells may not disturb a policy where it is told: those weights stay as they begin.
        tells_time = self.tells_time is not False
        never = untold(problem, (objective, *others), tells_time, self.rays, self.dynamic_window)
        weight = jnp.where(never, 0.0, target[0].weight)
        target = (eqx.tree_at(lambda layer: layer.weight, target[0], weight), *target[1:])
        by_target, by_context, mode, idle = (layers[0] for layers in heads)
        mode, idle = (jax.tree.map(lambda x: FIRST_SCALE * x, layer) for layer in (mode, idle))
        layers = (SetEncoder(target, query), context_layers, by_target, by_context, mode, idle)
        tells_team = problem.team is not None
        preference = (*PREFERENCE, OTHERS_LOG_WEIGHT) if tells_team else PREFERENCE
        told = objective, tells_time, tells_team, self.rays, problem.detections is not None
        window = jnp.full(1, FREE_LOG_WEIGHT) if self.dynamic_window else None
        limits = jnp.array([[-NO_LIMIT], [NO_LIMIT]]) + jnp.zeros(widths[0][0]) if self.clips_features else None
        parts = (*layers, jnp.array(preference), self.modes, *told, window, limits)
        return PointerPolicy(*parts) if self.assignment is None else AssignedPointer(*parts, self.assignment)
