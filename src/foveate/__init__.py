"""foveate: teach a mobile agent with a limited field of view where to look.

    policy = foveate.load("best")                   a trained policy of a preset, or of a run folder
    policy = foveate.train(scenario, out="runs/a")  or one trained for a scenario of your own
    command = policy(belief, pose)                  [m/s, rad/s]; beliefs by foveate.Belief or foveate.Tracker
    foveate.evaluate(policy, "table1")              scores, what was seen, errors: a table
    foveate.plan("table1")                          evaluate a planner the same way
    foveate.replay(policy, "walkers.csv")           evaluate in a recording of real targets
    foveate.fit("walkers.csv").experiment           an experiment fitted to them

Everything that programs import is a name of `foveate` itself, of `foveate.gym` or of `foveate.stonesoup`. A name is
loaded when it is first used.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "AccelerationTarget": "scenario.target",
    "ActorCriticSettings": "experiment.learners",
    "animate": "plotting.animation",
    "AttentionSettings": "policies.attention",
    "BallView": "scenario.field_of_view",
    "Belief": "deploy.belief",
    "Benchmark": "study.methods",
    "ConeView": "scenario.field_of_view",
    "DifferentialDrive": "scenario.agent",
    "DriftTarget": "scenario.target",
    "Episode": "simulation.records",
    "EpisodeData": "plotting.episode_data",
    "evaluate": "api",
    "Evaluation": "evaluation.report",
    "Experiment": "experiment.experiment",
    "fit": "api",
    "Fitted": "recordings.fit",
    "Fixed": "study.methods",
    "FixedWing": "scenario.agent",
    "for_scenario": "experiment.presets",
    "FreeBody": "scenario.agent",
    "FrustumView": "scenario.field_of_view",
    "heuristic": "policies.heuristics",
    "InputError": "errors",
    "Learned": "study.methods",
    "learning_curve": "plotting.figures",
    "LinearTarget": "scenario.target",
    "load": "api",
    "load_recording": "recordings.formats",
    "Method": "study.methods",
    "Observation": "simulation.records",
    "own_suite": "simulation.suites",
    "plan": "api",
    "Planned": "study.methods",
    "PlanSettings": "planning.shooting",
    "PointerSettings": "policies.pointer",
    "Policy": "simulation.records",
    "PolygonView": "scenario.field_of_view",
    "PPOSettings": "experiment.learners",
    "prepare": "evaluation.evaluate",
    "PRESETS": "experiment.presets",
    "PrismView": "scenario.field_of_view",
    "Problem": "models.problem",
    "PROTOCOLS": "simulation.records",
    "Quadrotor": "scenario.agent",
    "read_scenes": "scenario.scenes",
    "Recording": "recordings.recording",
    "replay_figure": "plotting.figures",
    "replay": "api",
    "ReplayResult": "recordings.compare",
    "rollout": "simulation.rollout",
    "Row": "evaluation.evaluate",
    "Scenario": "scenario.scenario",
    "Scene": "scenario.scenes",
    "SceneSettings": "scenario.scenes",
    "ScheduleSettings": "scenario.sensor",
    "SectorView": "scenario.field_of_view",
    "Seen": "deploy.tracker",
    "SensorSettings": "scenario.sensor",
    "StaticTarget": "scenario.target",
    "Steering": "policies.heuristics",
    "Suite": "evaluation.evaluate",
    "suite_data": "plotting.episode_data",
    "Summary": "evaluation.summary",
    "table1": "simulation.suites",
    "Trace": "simulation.records",
    "Track": "recordings.recording",
    "Tracker": "deploy.tracker",
    "train": "api",
    "TrainedPolicy": "deploy.policy",
    "Training": "study.methods",
    "TrainingSettings": "experiment.learners",
    "trajectory_figure": "plotting.figures",
    "TriangleView": "scenario.field_of_view",
    "use_cores": "learning.devices",
    "VelocityTarget": "scenario.target",
    "write_scenes": "scenario.scenes",
}
"""The module of each public name; type checkers read `__init__.pyi`, which says the same."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'foveate' has no attribute {name!r}: it has {', '.join(_HOMES)}")
    return getattr(import_module(f"foveate.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return ["__version__", *_HOMES]
