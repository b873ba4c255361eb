"""foveate: teach a mobile agent with a limited field of view where to look.

    policy = foveate.load("best")                   a trained policy of a preset, or of a run folder
    policy = foveate.train(scenario, out="runs/a")  or one trained for a world of your own
    command = policy(belief, pose)                  [m/s, rad/s]; beliefs by foveate.Belief or foveate.Tracker
    foveate.evaluate(policy, "table1")              scores, what was seen, errors: a table

Everything else is in the modules that these come from. Nothing is imported before it is asked for.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "PRESETS": "settings",
    "Belief": "beliefs",
    "Evaluation": "results",
    "Experiment": "settings",
    "Scenario": "scenario",
    "Scene": "scenes",
    "Tracker": "tracker",
    "TrainedPolicy": "trained_policy",
    "evaluate": "api",
    "load": "api",
    "train": "api",
}
"""The module of each public name; type checkers read `__init__.pyi`, which says the same."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'foveate' has no attribute {name!r}: it has {', '.join(_HOMES)}")
    return getattr(import_module(f"foveate.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return ["__version__", *_HOMES]
