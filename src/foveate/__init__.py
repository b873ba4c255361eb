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

from foveate.registration import register_with_gymnasium

__version__ = "0.1.0"

_HOMES = {
    "AccelerationTarget": "scenario.target",
    "ActorCriticSettings": "experiment.learners",
    "animate": "plotting.animation",
    "AttentionSettings": "policies.attention",
    "BallView": "scenario.field_of_view",
    "Belief": "deploy.belief",
    "Benchmark": "study.methods",
    "BirthSettings": "scenario.detections",
    "CircleObstacles": "scenario.random_obstacles",
    "ConeView": "scenario.field_of_view",
    "DetectionSettings": "scenario.detections",
    "DetectionTracker": "deploy.detections",
    "DifferentialDrive": "scenario.agent",
    "DriftTarget": "scenario.target",
    "Environment": "simulation.environment",
    "environment": "experiment.environments",
    "EnvironmentState": "simulation.environment",
    "Episode": "simulation.records",
    "EpisodeData": "plotting.episode_data",
    "evaluate": "api",
    "Evaluation": "evaluation.report",
    "Experiment": "experiment.experiment",
    "fit": "api",
    "Fitted": "recordings.fit",
    "Fixed": "study.methods",
    "FixedWing": "scenario.agent",
    "ForestObstacles": "scenario.random_obstacles",
    "for_scenario": "experiment.presets",
    "FreeBody": "scenario.agent",
    "FrustumView": "scenario.field_of_view",
    "Gif": "plotting.simulated",
    "heuristic": "deploy.untrained",
    "heuristic_policy": "planning.named",
    "InputError": "errors",
    "KeepOff": "policies.keep_off",
    "Learned": "study.methods",
    "learning_curve": "plotting.figures",
    "LinearTarget": "scenario.target",
    "load": "api",
    "load_recording": "recordings.formats",
    "Method": "study.methods",
    "Observation": "simulation.records",
    "OccupancyObstacles": "scenario.obstacles",
    "OriginSettings": "scenario.origin",
    "own_suite": "simulation.suites",
    "plan": "api",
    "Planned": "study.methods",
    "planner": "deploy.untrained",
    "PlanSettings": "planning.shooting",
    "PointerSettings": "policies.pointer_settings",
    "Policy": "simulation.records",
    "PolygonView": "scenario.field_of_view",
    "PPOSettings": "experiment.learners",
    "prepare": "evaluation.evaluate",
    "PRESETS": "experiment.presets",
    "PrismView": "scenario.field_of_view",
    "Problem": "models.problem",
    "PROTOCOLS": "simulation.records",
    "Quadrotor": "scenario.agent",
    "RadioSettings": "scenario.team",
    "read_scenes": "scenario.scenes",
    "Recording": "recordings.recording",
    "RegionSettings": "scenario.region",
    "replay": "api",
    "replay_figure": "plotting.replay_figure",
    "ReplayResult": "recordings.results",
    "RobotPolicy": "deploy.policy",
    "RobotSettings": "scenario.kinds",
    "rollout": "simulation.rollout",
    "RoomObstacles": "scenario.random_obstacles",
    "Row": "evaluation.rows",
    "Scenario": "scenario.scenario",
    "Scanned": "deploy.detections",
    "Scene": "scenario.scenes",
    "SceneSettings": "scenario.scenes",
    "ScheduleSettings": "scenario.sensor",
    "SectorView": "scenario.field_of_view",
    "Seen": "deploy.tracks",
    "SensorSettings": "scenario.sensor",
    "ShapeObstacles": "scenario.obstacles",
    "SimulatedEpisode": "plotting.simulated",
    "StaticTarget": "scenario.target",
    "Steering": "policies.heuristics",
    "StreetObstacles": "scenario.random_obstacles",
    "Suite": "evaluation.evaluate",
    "suite_data": "plotting.episode_data",
    "Summary": "evaluation.summary",
    "table1": "simulation.suites",
    "TeamSettings": "scenario.team",
    "TeamTrace": "simulation.team.records",
    "TeamView": "simulation.team.records",
    "Trace": "simulation.records",
    "Track": "recordings.recording",
    "Tracker": "deploy.tracker",
    "train": "api",
    "TrainedPolicy": "deploy.policy",
    "Training": "study.methods",
    "TrainingSettings": "experiment.learners",
    "trajectory_figure": "plotting.figures",
    "Transition": "simulation.environment",
    "TriangleView": "scenario.field_of_view",
    "use_cores": "learning.devices",
    "Validation": "experiment.run_folder",
    "VelocityTarget": "scenario.target",
    "Verdict": "evaluation.verdict",
    "VerdictRow": "evaluation.verdict",
    "write_scenes": "scenario.scenes",
}
"""The module of each public name; type checkers read `__init__.pyi`, which says the same."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'foveate' has no attribute {name!r}: it has {', '.join(_HOMES)}")
    return getattr(import_module(f"foveate.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return ["__version__", *_HOMES]


register_with_gymnasium()
