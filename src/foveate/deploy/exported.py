"""A policy in an exported file, as every policy of foveate: it decides for a robot, in simulations and in replays."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.deploy.onnx.session import Session, open_file
from foveate.deploy.policy import TrainedPolicy
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import ACTOR_CRITIC, POINTER
from foveate.names import Objective
from foveate.policies.surroundings import surroundings
from foveate.policies.tokens import STANDOFF
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key


class ExportedNetwork(Policy):
    """Decides by onnxruntime, within a compiled program; without derivatives."""

    session: Session = eqx.field(static=True)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The action whose command is the file's."""
        robot, rays = observation.robot, self.session.rays
        assert robot is not None, "of every simulation and every robot"
        problem = robot.problem
        arrays = {
            "pose": observation.pose,
            "mean": observation.mean,
            "information": observation.information,
            "present": observation.present,
            "known_input": observation.known_input,
            "steps_left": observation.left,
            "step": observation.step,
        }
        if rays:
            places = problem.motion.position(observation.mean)
            around = surroundings(observation, robot, places, rays, STANDOFF * robot.extent.ahead_m)
            arrays |= {
                "ranges": around.ranges,
                "way_place": around.place_world,
                "way_length": around.length,
                "is_straight": around.is_straight,
                "is_seen": around.is_seen,
            }
        given = {name: arrays[name] for name in self.session.wanted}
        result = jax.ShapeDtypeStruct(problem.agent.lower.shape, problem.agent.lower.dtype)
        control = jax.pure_callback(self._commands, result, given, vmap_method="broadcast_all")
        return problem.agent.action(control), memory

    def _commands(self, given: dict[str, Any]) -> np.ndarray:
        """Commands of decisions in a batch of any axes."""
        kinds = {"f": np.float32, "i": np.int64, "b": np.bool_}
        arrays = {name: np.asarray(x) for name, x in given.items()}
        batch = arrays["pose"].shape[: arrays["pose"].ndim - len(self.session.wanted["pose"])]
        flat = {
            name: x.reshape(math.prod(batch), *x.shape[len(batch) :]).astype(kinds[x.dtype.kind])
            for name, x in arrays.items()
        }
        control = self.session.commands(flat)
        return control.reshape(*batch, control.shape[-1]).astype(jnp.result_type(float))


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ExportedPolicy(TrainedPolicy):
    """The policy of an ONNX file; from `foveate.load`.

    Its robot is that of the file: another scenario may have other scenes, and other obstacles for a policy with rays.
    """

    def for_scenario(self, scenario: Scenario, objective: Objective | None = None) -> "ExportedPolicy":
        """The same policy among other obstacles, or in other scenes. Raises InputError for anything else."""
        self.require_serves(scenario)
        if objective is not None:
            raise InputError(f"{self.name}: {FIXED}")
        return replace(self, experiment=replace(self.experiment, scenario=scenario))

    def require_serves(self, scenario: Scenario) -> None:
        """Raise InputError unless the scenario differs in its scenes and obstacles only."""
        if replace(scenario, scenes=self.scenario.scenes, obstacles=self.scenario.obstacles) != self.scenario:
            raise InputError(f"{self.name}: {FIXED}")

    def export(self, path: str | Path) -> NoReturn:
        """Raise InputError: it is a file already."""
        raise InputError(f"{self.name}: is an exported file already: copy it")

    def save(self, folder: str | Path) -> NoReturn:
        """Raise InputError: a file has no weights of a run."""
        raise InputError(f"{self.name}: is an exported file: save the run that it is from")

    def __repr__(self) -> str:
        return f"ExportedPolicy({self.name!r}: {self._body})"


FIXED = "an exported file serves its own robot and targets: expected the run that it is from, for another scenario"


def load_exported(path: str | Path) -> ExportedPolicy:
    """Load the policy of a file of `foveate export`. Raises InputError as `open_file`.

    Of its experiment only the scenario and the objective are the file's: the network's settings are not in it.
    """
    session = open_file(str(path))
    experiment = Experiment(scenario=session.scenario)
    if session.objective is not None:
        training = replace(ACTOR_CRITIC, objective=session.objective)
        experiment = replace(experiment, policy=POINTER, training=training)
    return ExportedPolicy(
        name=str(path), experiment=experiment, network=ExportedNetwork(session), facts=dict(session.facts)
    )
