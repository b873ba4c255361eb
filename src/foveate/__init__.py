"""foveate: teach a mobile agent with a limited field of view where to look.

    policy = foveate.load("best")                   a trained policy of a preset, or of a run folder
    policy = foveate.train(scenario, out="runs/a")  or one trained for a world of your own
    command = policy(belief, pose)                  [m/s, rad/s]; beliefs by foveate.Belief or foveate.Tracker
    foveate.evaluate(policy, "table1")              scores, what was seen, errors: a table
    foveate.plan("table1")                          the same of a planner
    foveate.replay(policy, "walkers.csv")           the same in a recording of real targets
    foveate.fit("walkers.csv").experiment           what to train for them

Everything else is in the modules that these come from. Nothing is imported before it is asked for.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "AccelerationTarget": "scenario.target",
    "ActorCriticSettings": "experiment.learners",
    "AttentionSettings": "policies.attention",
    "BallView": "scenario.field_of_view",
    "Belief": "deploy.belief",
    "Bench": "study.methods",
    "Comparison": "recordings.compare",
    "ConeView": "scenario.field_of_view",
    "DifferentialDrive": "scenario.agent",
    "DriftTarget": "scenario.target",
    "Episode": "simulation.records",
    "evaluate": "api",
    "Evaluation": "evaluation.report",
    "Experiment": "experiment.experiment",
    "fit": "api",
    "Fitted": "recordings.fitted",
    "Fixed": "study.methods",
    "FixedWing": "scenario.agent",
    "FreeBody": "scenario.agent",
    "FrustumView": "scenario.field_of_view",
    "heuristic": "policies.heuristics",
    "InputError": "errors",
    "Learned": "study.methods",
    "LinearTarget": "scenario.target",
    "load": "api",
    "load_recording": "recordings.formats",
    "Method": "study.methods",
    "Observation": "simulation.records",
    "plan": "api",
    "Planned": "study.methods",
    "PlanSettings": "planning.shooting",
    "PointerSettings": "policies.pointer",
    "Policy": "simulation.records",
    "PolygonView": "scenario.field_of_view",
    "PPOSettings": "experiment.learners",
    "PRESETS": "experiment.presets",
    "PrismView": "scenario.field_of_view",
    "Problem": "models.problem",
    "Quadrotor": "scenario.agent",
    "read_scenes": "scenario.scenes",
    "Recording": "recordings.recording",
    "replay": "api",
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
    "Summary": "evaluation.summary",
    "Trace": "simulation.records",
    "Tracker": "deploy.tracker",
    "train": "api",
    "TrainedPolicy": "deploy.policy",
    "Training": "study.methods",
    "TrainingSettings": "experiment.learners",
    "TriangleView": "scenario.field_of_view",
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
