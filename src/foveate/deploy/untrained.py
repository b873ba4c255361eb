"""Heuristics and planners for a robot: the interface of a trained policy, without a training."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from foveate.deploy.policy import RobotPolicy
from foveate.errors import InputError
from foveate.evaluation.plan import PlanOptions
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import NamedPolicy, experiment_from, subject_of
from foveate.io.validate import require, seed_number
from foveate.names import ProtocolName
from foveate.planning.named import heuristic_in
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import PROTOCOLS, Policy


def heuristic(
    name: str, scenario: Scenario | Experiment | str | Path, *, box: ArrayLike | None = None, seed: int = 0
) -> RobotPolicy:
    """Make a heuristic for a robot: it decides on beliefs of your own, as a trained policy does.

    Args:
        name: "random", "still", "nearest", "uncertain", "lawnmower", "price", "window" or "post".
        scenario: Scenario, experiment, name of a preset, TOML file or run folder.
        box: Low and high corner [m], (2, d), of the box that the lawnmower sweeps and in which the post is; by default
            the box of the first beliefs.
        seed: Seed of the actions of "random".

    Raises:
        InputError: An argument is invalid, or a file is damaged.
    """
    seed_number(seed, "seed")
    experiment = experiment_from(scenario)
    corners = None if box is None else _corners(box, experiment.scenario.dimension)
    network = heuristic_in(experiment.scenario, name, corners)
    return RobotPolicy(name=name, experiment=experiment, network=network, seed=seed)


def _corners(box: ArrayLike, dimension: int) -> Float[Array, "2 d"]:
    corners = np.array(box, float)
    right = f"expected the low and the high corner, 2 x {dimension} finite numbers [m]"
    fits = corners.shape == (2, dimension) and np.isfinite(corners).all() and (corners[0] <= corners[1]).all()
    require(fits, "box", corners.tolist(), right)
    return jnp.asarray(corners, float)


def planner(
    source: Scenario | Experiment | NamedPolicy | str | Path,
    *,
    refine: int | None = None,
    starts: int | None = None,
    iterations: int | None = None,
    window: int | None = None,
    protocol: ProtocolName = "true",
    seed: int = 0,
) -> RobotPolicy:
    """Make a receding-horizon planner for a robot: it decides on beliefs of your own, as a trained policy does.

    It plans again at every call, from its last plan; the settings are those of `foveate.plan`.

    Args:
        source: Scenario, experiment, policy, name of a preset, TOML file or run folder to plan in.
        refine: Ascent steps from the actions of the policy that `source` is or names.
        starts: Initial action sequences; None: one, with the published settings.
        iterations: Ascent steps from each; None: the planner's default.
        window: Longest horizon of a plan [steps]; None: 30, or the longest episode of the scenario where that is less.
        protocol: Protocol that is planned for.
        seed: Seed of the tours that the plans start from.

    Raises:
        InputError: An argument is invalid, or a file is damaged.
    """
    seed_number(seed, "seed")
    options = PlanOptions(refine=refine, starts=starts, iterations=iterations, window=window)
    if protocol not in PROTOCOLS:
        raise InputError(f"protocol {protocol!r}: expected {' or '.join(PROTOCOLS)}")
    experiment, refined = _subject(source, refine)
    scenario = experiment.scenario
    longest = scenario.scenes.horizon(scenario.scenes.targets_max)
    network = options.planner(scenario.problem(), protocol, refined, longest)
    return RobotPolicy(name=options.method, experiment=experiment, network=network, seed=seed)


def _subject(
    source: Scenario | Experiment | NamedPolicy | str | Path, refine: int | None
) -> tuple[Experiment, Policy | None]:
    """Experiment to plan in, and the policy to refine, if any."""
    if isinstance(source, Scenario | Experiment):
        require(refine is None, "refine", refine, "expected a policy, a run or a preset as source, which it refines")
        return experiment_from(source), None
    if refine is None:
        return source.experiment if isinstance(source, NamedPolicy) else experiment_from(source), None
    subject = subject_of(source)
    return subject.experiment, subject.network()
