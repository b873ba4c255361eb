"""Trained policy for a robot: maps beliefs and a pose to a command in m/s and rad/s."""

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

LEAST_PADDING = 8
"""A decision is compiled for at least 8 targets, and again whenever their number exceeds a power of two."""


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TrainedPolicy(Trained):
    """A policy and its training; from `foveate.load` or `foveate.train`.

        command = policy(belief, pose)

    `network` is the policy in JAX, for simulations and derivatives, `experiment` the definition of its training, and
    `facts` the result (seed, epoch and held-out score of the weights kept).
    """

    facts: dict[str, Any]

    @property
    def scenario(self) -> Scenario:
        """Scenario of its training."""
        return self.experiment.scenario

    @cached_property
    def problem(self) -> Problem:
        """The scenario as arrays."""
        return self.scenario.problem()

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of a command's numbers: of vx, vy, vz [m/s] and wx, wy, wz [rad/s], in the body frame."""
        return tuple(self.problem.agent.space.axes[axis] for axis in self.problem.agent.axes)

    @property
    def steps_left(self) -> int:
        """Steps to the end in the middle of a training episode, the default for a robot without an end."""
        return self.scenario.scenes.middle_steps_left

    def predict(self, belief: Belief, known_input: ArrayLike | None = None, step: int = 0) -> Belief:
        """Belief one control period ahead, by the scenario's motion: the input of a decision.

        `known_input` are the inputs xi (n, m_y) of this step, 0 by default; `step` selects matrices of a schedule.
        """
        return predicted(belief, self.problem, known_input, step)

    def __call__(self, belief: Belief, pose: ArrayLike, steps_left: int | None = None) -> Float[np.ndarray, " m"]:
        """Decide on a command: the numbers that `axes` names [m/s, rad/s]; for a differential drive, [v, w].

        `belief` is predicted to the end of the coming step, by `predict`, or by a tracker's own; it may hold any number
        of targets, none included. `pose` is the current one: [x, y, yaw], or in space the 4 x 4 matrix from body to
        world, or [x, y, z, qw, qx, qy, qz] (m, rad). `steps_left` until the end include the coming one; by default they
        are those in the middle of a training episode. Raises InputError for a pose or belief that does not fit the
        scenario.
        """
        left = self.steps_left if steps_left is None else steps_left
        if left < 1 or left != int(left):
            raise InputError(f"steps_left = {steps_left}: expected a whole number >= 1")
        size = max(LEAST_PADDING, 1 << (len(belief.mean) - 1).bit_length())
        observed = observation(belief, self.problem, _pose(self.problem.agent.space, pose), left, size)
        command = np.array(_decide(self.network, self.problem.agent, observed))
        if not np.isfinite(command).all():
            raise InputError("belief, pose: expected numbers that float32 can hold, also squared")
        return command

    def export(self, path: str | Path) -> None:
        """Write an ONNX file, for a robot without JAX (extra `onnx`), as `foveate export`."""
        export(self.experiment, self.network, Path(path))

    def save(self, folder: str | Path) -> None:
        """Write a run folder for `foveate.load` and the commands: configuration and weights.

        Raises InputError for a folder that is not empty.
        """
        out = Path(folder)
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out}: exists already: choose another folder")
        (out / BEST).parent.mkdir(parents=True, exist_ok=True)
        write_config(out, self.experiment)
        save_tree(out / BEST, self.network, self.experiment, "policy", self.facts)

    def __repr__(self) -> str:
        weights = sum(leaf.size for leaf in jax.tree.leaves(self.network) if eqx.is_array(leaf))
        scenario, scenes = self.scenario, self.scenario.scenes
        targets = f"{scenes.targets_min} to {scenes.targets_max} targets ({scenario.target.kind})"
        return (
            f"TrainedPolicy({self.name!r}: {self.experiment.policy.kind} network of {weights:,} weights; trained for "
            f"{targets}, {scenario.agent.kind}, {scenario.view.shape} view of {scenario.view.depth_m:g} m, "
            f"a command [{', '.join(self.axes)}] every {scenario.tau_s:g} s)"
        )


@eqx.filter_jit
def _decide(policy: Policy, agent: Agent, observed: Observation) -> Float[Array, " m"]:
    return agent.control(policy(observed, policy.start(observed), jax.random.key(0))[0])


def _pose(space: Space, pose: ArrayLike) -> Float[np.ndarray, "..."]:
    """Checked pose in the representation of a space, from its matrix or from numbers as in files."""
    T = np.array(pose, float)
    if space.dimension == 2 or T.shape != (4, 4):
        return np.asarray(space.from_numbers(T))
    R = T[:3, :3]
    proper = np.isfinite(T).all() and np.abs(R @ R.T - np.eye(3)).max() < 1e-3 and np.linalg.det(R) > 0
    if not proper or np.any(T[3] != [0, 0, 0, 1]):
        raise InputError(f"pose = {T.tolist()}: expected a homogeneous matrix: a rotation, a position, [0, 0, 0, 1]")
    return T
