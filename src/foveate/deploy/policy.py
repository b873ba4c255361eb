"""Policies for a robot: map beliefs and a pose to a command in m/s and rad/s."""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from foveate.deploy.belief import LARGEST, Belief, check_belief, observation, predicted, whole_steps
from foveate.deploy.decider import Decider
from foveate.deploy.onnx.export import export
from foveate.deploy.pose import QuaternionOrder, checked_pose
from foveate.errors import InputError
from foveate.evaluation.verdict import Verdict, write_verdict
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.resolve import NamedPolicy, in_scenario, told
from foveate.experiment.run_folder import BEST
from foveate.io.validate import require
from foveate.models.obstacles import Obstacles
from foveate.models.problem import Problem
from foveate.names import Objective, ProtocolName
from foveate.policies.by_kind import ByKind
from foveate.policies.keep_off import KeepOff
from foveate.scenario.rows import MAX_LENGTH
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene

if TYPE_CHECKING:
    from foveate.plotting.simulated import SimulatedEpisode

ODD = 1.25
"""A step this many times as long, or as short, as those of training is worth a warning."""
LEAST_PADDING = 8
"""A decision is compiled for at least 8 targets, and again whenever their number exceeds a power of two."""


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RobotPolicy(NamedPolicy):
    """A policy that decides for a robot, on beliefs of your own; from `foveate.heuristic` or `foveate.planner`.

        command = policy(belief, pose)

    `network` is the policy in JAX, for simulations and derivatives, `experiment` holds its scenario. A policy with a
    memory keeps it from call to call: the calls are the steps of one episode, and a row of the beliefs stays the same
    target. `reset()` begins the next episode.
    """

    seed: int = 0
    """Seed of random decisions."""
    obstacles: Obstacles | None = None
    """Those of the robot's own map, in place of the scenario's."""

    @property
    def scenario(self) -> Scenario:
        """Scenario that it decides in: of its training, or as given."""
        return self.experiment.scenario

    @cached_property
    def problem(self) -> Problem:
        """The scenario as arrays."""
        problem = self.scenario.problem()
        return problem if self.obstacles is None else replace(problem, obstacles=self.obstacles)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of a command's numbers: of vx, vy, vz [m/s] and wx, wy, wz [rad/s], in the body frame."""
        return tuple(self.problem.agent.space.axes[axis] for axis in self.problem.agent.axes)

    @property
    def steps_left(self) -> int:
        """Steps to the end in the middle of the scenario's episodes, the default for a robot without an end."""
        return self.scenario.scenes.middle_steps_left

    @cached_property
    def _decider(self) -> Decider:
        obstacles, network = self.problem.of_one_kind().obstacles, self.network
        if obstacles is not None and obstacles.keep_off is not None:
            network = KeepOff(network, self.problem, float(obstacles.keep_off))
        return Decider(network, self.problem.agent, self.seed)

    def for_robot(self, number: int) -> "RobotPolicy":
        """The policy of one robot of its scenario's team, by its number from 0, with that robot's limits and sensor.

        Raises InputError for a number that the team does not have.
        """
        network = self.network.of_robot(number) if isinstance(self.network, ByKind) else self.network
        experiment = replace(self.experiment, scenario=self.scenario.of_robot(number))
        return replace(self, experiment=experiment, network=network)

    def reset(self) -> None:
        """Forget all decisions: the next one is the first of an episode."""
        self._decider.reset()

    def simulate(
        self, scene: Scene | None = None, *, protocol: ProtocolName = "true", seed: int = 0
    ) -> "SimulatedEpisode":
        """Simulate one episode, as `foveate.evaluate` does; it has `plot` and `animate`.

        Args:
            scene: Scene; None: the first of the scenario's own.
            protocol: Information from the paper's soft view (surrogate), or from real measurements (true).
            seed: Seed of the noise.

        Raises:
            InputError: An argument is invalid, or the scene does not fit the scenario.
        """
        from foveate.plotting.simulated import simulate  # a robot needs no matplotlib

        return simulate(self, scene, protocol, seed)

    def predict(self, belief: Belief, known_input: ArrayLike | None = None, step: int = 0) -> Belief:
        """Belief one control period ahead, by the scenario's motion: the input of a decision.

        `known_input` are the inputs xi (n, m_y) of this step, 0 by default; `step` selects matrices of a schedule.
        """
        return predicted(belief, self.problem, known_input, step)

    def __call__(
        self,
        belief: Belief,
        pose: ArrayLike,
        steps_left: int | None = None,
        *,
        quaternion: QuaternionOrder = "wxyz",
        map_number: int | None = None,
    ) -> Float[np.ndarray, " m"]:
        """Decide on a command: the numbers that `axes` names [m/s, rad/s]; for a differential drive, [v, w].

        `belief` is predicted to the end of the coming step, by `predict`, or by a tracker's own; it may hold any number
        of targets, none included. `pose` is the current one: [x, y, yaw], or in space the 4 x 4 matrix from body to
        world, or [x, y, z, qw, qx, qy, qz] (m, rad), also in the plane; ROS gives [x, y, z, qx, qy, qz, qw], which is
        another pose: say `quaternion="xyzw"`. `steps_left` until the end include the coming one; by default they
        are those in the middle of an episode. `map_number` is that of the robot's map among those of the scenario;
        None: the first. Targets beyond 1e9 m, or of extreme variances, are left out: no number of
        theirs may spoil the command for the others. Warns where the belief was predicted over a step of another length
        than the policy was trained for. Raises InputError for a pose, belief or map that does not fit the scenario.
        """
        check_belief(belief)
        left = whole_steps("steps_left", self.steps_left if steps_left is None else steps_left, 1)
        size = max(LEAST_PADDING, 1 << (len(belief.mean) - 1).bit_length())
        here = checked_pose(pose, self.scenario.dimension, quaternion)
        self._warn_of_period(belief)
        observed = observation(_without_extremes(belief), self._in_map(map_number), here, left, size)
        command = self._decider.command(observed)
        if not np.isfinite(command).all():
            raise InputError("belief, pose: expected numbers that float32 can hold, also squared")
        return command

    def export(self, path: str | Path) -> None:
        """Write an ONNX file, for a robot without JAX (extra `onnx`), as `foveate export`.

        Raises InputError for a policy that remembers, or draws random numbers.
        """
        export(self.experiment, self.network, Path(path))

    def _in_map(self, number: int | None) -> Problem:
        if number is None:
            return self.problem
        maps = 0 if self.problem.obstacles is None else self.problem.obstacles.grid.maps
        right = f"expected 0 to {maps - 1}, a map of the scenario" if maps else "expected None without obstacles"
        require(isinstance(number, int) and 0 <= number < maps, "map_number", number, right)
        return self.problem.of_map(jnp.asarray(number))

    def _warn_of_period(self, belief: Belief) -> None:
        lengths = self.scenario.schedule.tau_s or (self.scenario.tau_s,)
        if belief.step_s is None or min(lengths) / ODD <= belief.step_s <= max(lengths) * ODD:
            return
        warnings.warn(
            f"{self.name}: decides for a step of {self.scenario.tau_s:g} s; the belief was predicted over "
            f"{belief.step_s:g} s: run the loop at its period, or train for yours (tau_s)",
            stacklevel=3,
        )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}: {self._body})"

    @property
    def _body(self) -> str:
        """The robot in words."""
        scenario = self.scenario
        return (
            f"{scenario.agent.kind}, {scenario.view.shape} view of {scenario.view.depth_m:g} m, "
            f"a command [{', '.join(self.axes)}] every {scenario.tau_s:g} s"
        )


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TrainedPolicy(RobotPolicy):
    """A policy and its training; from `foveate.load` or `foveate.train`.

        command = policy(belief, pose)

    It decides as every `RobotPolicy`. `experiment` is the definition of its training, and `facts` the result (seed,
    epoch and held-out score of the weights kept). `verdict` compares it with every heuristic and a planner; None if the
    training had none.
    """

    facts: dict[str, Any]
    verdict: Verdict | None = None

    def for_scenario(self, scenario: Scenario, objective: Objective | None = None) -> "TrainedPolicy":
        """The same network in another scenario, without a training: another robot, other targets.

        A pointer network is told its robot and takes every one of its space; the preset "any" was trained with random
        robots. `objective` is what it is told to do; None keeps that of its training, or for "any" the score at the end
        of short episodes, and the mean over the steps of long ones. Raises InputError for a scenario that does not fit.
        """
        experiment = in_scenario(self.experiment, scenario, objective)
        return replace(self, experiment=experiment, network=told(self.network, experiment), verdict=None)

    def save(self, folder: str | Path) -> None:
        """Write a run folder for `foveate.load` and the commands: configuration, weights and verdict.

        Raises InputError for a folder that is not empty.
        """
        out = Path(folder)
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out}: exists already: choose another folder")
        (out / BEST).parent.mkdir(parents=True, exist_ok=True)
        write_config(out, self.experiment)
        save_tree(out / BEST, self.network, self.experiment, "policy", self.facts)
        if self.verdict is not None:
            write_verdict(out, self.verdict)

    def __repr__(self) -> str:
        weights = sum(leaf.size for leaf in jax.tree.leaves(self.network) if eqx.is_array(leaf))
        scenes, kind = self.scenario.scenes, self.experiment.policy.kind
        least, most = scenes.targets_min, scenes.targets_max
        targets = f"{least if least == most else f'{least} to {most}'} targets ({self.scenario.target.kind})"
        return (
            f"TrainedPolicy({self.name!r}: {kind} network of {weights:,} weights; decides for {targets}, {self._body})"
        )


def _without_extremes(belief: Belief) -> Belief:
    """Belief in which targets far beyond any scene, or of extreme variances, count as padding."""
    scale = np.abs(belief.information).max(axis=(1, 2))
    usable = (np.abs(belief.mean) <= MAX_LENGTH).all(axis=1) & (scale <= LARGEST) & (scale >= 1.0 / LARGEST)
    if usable.all():
        return belief
    present, given = belief.present & usable, belief.known_input
    return Belief(belief.mean, information=belief.information, present=present, known_input=given, step_s=belief.step_s)
