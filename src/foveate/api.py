"""What Python programs and notebooks call: train, load, evaluate. The commands of the same names stand on it too."""

import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from foveate.deploy.policy import TrainedPolicy
from foveate.errors import InputError
from foveate.evaluation.report import Evaluation, evaluate_all
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS, adjusted, for_scenario
from foveate.experiment.resolve import experiment_of, policy_of, scenes_of, with_initial_error
from foveate.experiment.resolve import load as load_parts
from foveate.io.toml import load_toml
from foveate.io.validate import seed_number
from foveate.learning.train import train_watched
from foveate.models.problem import Problem
from foveate.policies.heuristics import HEURISTICS
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, checked
from foveate.simulation.records import Policy

Preset = Literal["paper", "best", "true-view", "search", "quadrotor"]


Algorithm = Literal["policy-gradient", "actor-critic", "ppo", "ppo-tuned"]


METHODS = ("policy", *HEURISTICS)


def load(run: str | Path) -> TrainedPolicy:
    """The best policy of a run folder, or the trained policy that the package brings of a preset.

    Raises ValueError, in one line, where there is neither, or a file of it is not what it should be.
    """
    experiment, network, facts = load_parts(run)
    return TrainedPolicy(name=str(run), experiment=experiment, network=network, facts=facts)


def train(
    world: Scenario | Experiment | str | Path = "paper",
    *,
    like: Preset = "true-view",
    algorithm: Algorithm | None = None,
    epochs: int | None = None,
    episodes: int | None = None,
    steps: int | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    progress: bool = True,
) -> TrainedPolicy:
    """Train a policy, and give the best of it by held-out scenes.

    `world`: a preset's name, or a TOML file as `foveate fit` writes it, or an `Experiment`: these say how to train. Or
    a `Scenario`, which is trained as the preset `like` is: "true-view" takes minutes, "paper" seconds. `algorithm`,
    `epochs`, `episodes` (of PPO `steps`) override what they say. Everything is kept in the run folder `out`, with which
    `resume=True` goes on after an interruption; without it only the policy that is returned is left (see its `save`).
    `progress` shows a bar on a terminal, a line at each tenth in a notebook, and nothing elsewhere; False is quiet.

    Raises ValueError for settings that do not fit, and where `out` holds a run already; warns where a training had to
    stop early.
    """
    seed_number(seed, "seed")
    if resume and out is None:
        raise InputError("resume: expected out, the run folder to go on with")
    experiment = adjusted(_experiment(world, like), algorithm, epochs, episodes, steps)
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            return _trained(experiment, Path(folder) / "run", "a policy", seed, resume, progress)
    return _trained(experiment, Path(out), str(out), seed, resume, progress)


def evaluate(
    policy: TrainedPolicy | Policy | str | Path,
    scenes: str | Path | Sequence[Scene] | None = None,
    *,
    method: str | Sequence[str] = "policy",
    protocol: Literal["surrogate", "true", "both"] = "both",
    episodes: int = 1,
    seed: int = 0,
    scene_seed: int = 2023,
    initial_error: Literal["paper", "consistent"] | None = None,
    scenario: Scenario | None = None,
    normalised: bool = False,
    progress: bool = True,
) -> Evaluation:
    """How well a policy does: its scores, what it saw, its errors, and whether its filter knows them.

    `policy`: a trained one, a run folder, a preset's name, or a `foveate.simulation.records.Policy` of your own with its
    `scenario`. `scenes`: a scenes file, or "table1", the paper's suite, or "own", drawn from the scenario (with
    `scene_seed`), or a list; by default table1 in the plane, own in space. `method`: "policy", and in its place or
    beside it policies made by hand, "random", "still", "nearest", "uncertain" and "lawnmower", or "all". Every method
    meets the same scenes with the same noise, from `seed`, `episodes` times each. `protocol`, `initial_error`,
    `normalised`: as `foveate evaluate --help` says. `scenario`: another world than its own.

    Raises ValueError for what does not fit.
    """
    methods = list(dict.fromkeys([method] if isinstance(method, str) else method))
    asked = list(METHODS) if "all" in methods else methods
    seed_number(seed, "seed")
    seed_number(scene_seed, "scene_seed")
    if episodes < 1:
        raise InputError(f"episodes {episodes}: expected >= 1")
    if protocol not in ("surrogate", "true", "both"):
        raise InputError(f"protocol {protocol!r}: expected surrogate, true or both")
    experiment = _world_of(policy, scenario)
    experiment = with_initial_error(experiment, initial_error)
    if scenes is None or isinstance(scenes, str | Path):
        chosen, found = scenes_of(scenes, scene_seed, experiment)
    else:
        problem = experiment.scenario.problem()
        chosen, found = "scenes", checked(scenes, problem.agent.space, experiment.scenario.scenes)
    name = _name_of(policy)
    return evaluate_all(
        f"{name} on {chosen}",
        {"run": name, "scenes": chosen},
        experiment,
        {one: _policy(policy, one, experiment) for one in asked},
        found,
        protocols=("surrogate", "true") if protocol == "both" else (protocol,),
        episodes=episodes,
        seed=seed,
        normalised=normalised,
        quiet=not progress,
    )


def _experiment(world: Scenario | Experiment | str | Path, like: Preset) -> Experiment:
    """What is to be trained."""
    if isinstance(world, Scenario):
        return for_scenario(world, like)
    if isinstance(world, Experiment):
        return world
    if str(world) in PRESETS:
        return PRESETS[str(world)]
    if Path(world).suffix != ".toml":
        raise InputError(f"{world}: expected a preset, that is {', '.join(PRESETS)}, or a file that ends in .toml")
    return load_toml(Experiment, world)


def _trained(experiment: Experiment, out: Path, name: str, seed: int, resume: bool, progress: bool) -> TrainedPolicy:
    outcome = train_watched(experiment, out, name, seed, resume, quiet=not progress)
    if outcome.stopped:
        warnings.warn(f"{name}: the training stopped early: {outcome.stopped}", stacklevel=3)
    return replace(load(out), name=name)


def _world_of(policy: TrainedPolicy | Policy | str | Path, scenario: Scenario | None) -> Experiment:
    """The experiment whose world is to be evaluated in."""
    if isinstance(policy, Policy):
        if scenario is None:
            raise InputError("scenario: expected the world of a policy that foveate did not train")
        return Experiment(scenario=scenario)
    if not isinstance(policy, TrainedPolicy | str | Path):
        raise InputError(
            f"policy = {policy!r}: expected one of foveate, a run, a preset, or a foveate.simulation.records.Policy"
        )
    own = policy.experiment if isinstance(policy, TrainedPolicy) else experiment_of(policy)
    if scenario is None:
        return own
    now, new = (_shape_of(world.problem()) for world in (own.scenario, scenario))
    if now != new:
        raise InputError(f"scenario: has {new}: expected {now}, as the policy was trained for")
    return replace(own, scenario=scenario)


def _shape_of(problem: Problem) -> str:
    """What a policy's numbers in and out depend on."""
    n_y, axes = problem.motion.state_size, len(problem.agent.axes)
    return f"{problem.agent.space.dimension} dimensions, states of {n_y} numbers and {axes} of a command"


def _name_of(policy: TrainedPolicy | Policy | str | Path) -> str:
    if isinstance(policy, Policy):
        return type(policy).__name__
    return policy.name if isinstance(policy, TrainedPolicy) else str(policy)


def _policy(policy: TrainedPolicy | Policy | str | Path, method: str, experiment: Experiment) -> Policy:
    """The policy of a method: the one that was given, or one made by hand."""
    if method == "policy" and isinstance(policy, TrainedPolicy):
        return policy.network
    if method == "policy" and isinstance(policy, Policy):
        return policy
    return policy_of(policy if isinstance(policy, str | Path) else "", method, experiment)
