"""A trained policy as a robot calls it: beliefs and a pose in, a command in m/s and rad/s out."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from foveate.deploy.belief import Belief, observation, predicted
from foveate.deploy.onnx.export import export
from foveate.errors import InputError
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.resolve import Trained
from foveate.experiment.run_folder import BEST
from foveate.geometry.space import Space
from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Observation, Policy

LEAST = 8
"""A decision is compiled for so many targets at least, and anew whenever these have doubled."""


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TrainedPolicy(Trained):
    """A policy, the world that it was trained for, and how that went; from `foveate.load` or `foveate.train`.

        command = policy(belief, pose)

    `network` is the policy as it simulates and differentiates in JAX, `experiment` all that defines its training, and
    `facts` what is known of that (seed, epoch and held-out score of what was kept).
    """

    facts: dict[str, Any]

    @property
    def scenario(self) -> Scenario:
        """The world that it was trained for."""
        return self.experiment.scenario

    @cached_property
    def problem(self) -> Problem:
        """That world as arrays."""
        return self.scenario.problem()

    @property
    def axes(self) -> tuple[str, ...]:
        """The numbers of a command in order: of vx, vy, vz [m/s] and wx, wy, wz [rad/s], in the body frame."""
        return tuple(self.problem.agent.space.axes[axis] for axis in self.problem.agent.axes)

    @property
    def steps_left(self) -> int:
        """The steps to the end in the middle of a training episode: what a robot without an end gives every time."""
        return self.scenario.scenes.middle_steps_left

    def predict(self, belief: Belief, known_input: ArrayLike | None = None, step: int = 0) -> Belief:
        """The belief one control period ahead, by the scenario's motion: what a decision is made on.

        `known_input` are the inputs xi (n, m_y) of this step, 0 by default; `step` counts where matrices change.
        """
        return predicted(belief, self.problem, known_input, step)

    def __call__(self, belief: Belief, pose: ArrayLike, steps_left: int | None = None) -> Float[np.ndarray, " m"]:
        """The command, for the numbers that `axes` names [m/s, rad/s]; in the plane, to drive and turn, [v, w].

        `belief` is predicted to the end of the coming step, where the command will have brought the robot: as
        `predict` gives it, or a tracker after its own `predict`. `pose` is where the robot is now: [x, y, yaw], or in
        space the 4 x 4 matrix from body to world, or [x, y, z, qw, qx, qy, qz] (m, rad). `steps_left` until the end,
        this one too; by default as in the middle of a training episode. Any number of targets, none included. Raises
        ValueError for a pose or belief of another kind of world.
        """
        left = self.steps_left if steps_left is None else steps_left
        if left < 1 or left != int(left):
            raise InputError(f"steps_left = {steps_left}: expected a whole number >= 1")
        size = LEAST
        while size < len(belief.mean):
            size *= 2
        here = _pose(self.problem.agent.space, pose)
        seen = observation(belief, self.problem, here, left, size)
        command = np.array(_decide(self.network, self.problem.agent, seen))
        if not np.isfinite(command).all():
            raise InputError("belief, pose: expected numbers that float32 can hold, also squared: there is no decision")
        return command

    def export(self, path: str | Path) -> None:
        """Write it as an ONNX file, for a robot without JAX (extra `onnx`), as `foveate export`."""
        export(self.experiment, self.network, Path(path))

    def save(self, folder: str | Path) -> None:
        """Write what `foveate.load` and every command take for a run: the configuration and the weights.

        Raises ValueError where something is in that folder already.
        """
        out = Path(folder)
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out}: exists already: choose another folder")
        (out / BEST).parent.mkdir(parents=True, exist_ok=True)
        write_config(out, self.experiment)
        save_tree(out / BEST, self.network, self.experiment, "policy", self.facts)

    def __repr__(self) -> str:
        weights = sum(leaf.size for leaf in jax.tree.leaves(self.network) if eqx.is_array(leaf))
        world, scenes = self.scenario, self.scenario.scenes
        targets = f"{scenes.targets_min} to {scenes.targets_max} targets ({world.target.kind})"
        return (
            f"TrainedPolicy({self.name!r}: {self.experiment.policy.kind} network of {weights:,} weights; trained for "
            f"{targets}, {world.agent.kind}, {world.view.shape} view of {world.view.depth_m:g} m, "
            f"a command [{', '.join(self.axes)}] every {world.tau_s:g} s)"
        )


@eqx.filter_jit
def _decide(policy: Policy, agent: Agent, seen: Observation) -> Float[Array, " m"]:
    return agent.control(policy(seen, policy.start(seen), jax.random.key(0))[0])


def _pose(space: Space, pose: ArrayLike) -> Float[np.ndarray, "..."]:
    """A pose as the space has it, from its matrix or from numbers as in files."""
    given = np.array(pose, float)
    if space.dimension == 2 or given.shape != (4, 4):
        return np.asarray(space.from_numbers(given))
    turn = given[:3, :3]
    proper = np.isfinite(given).all() and np.abs(turn @ turn.T - np.eye(3)).max() < 1e-3 and np.linalg.det(turn) > 0
    if not proper or np.any(given[3] != [0, 0, 0, 1]):
        raise InputError(
            f"pose = {given.tolist()}: expected a homogeneous matrix: a rotation, a position, [0, 0, 0, 1]"
        )
    return given
