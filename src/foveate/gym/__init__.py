"""Gymnasium environments (extra `gym`); importing this module registers them."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

try:
    import gymnasium as gymnasium
except ImportError as error:
    raise ImportError("foveate.gym needs gymnasium: pip install 'foveate[gym]'") from error

from foveate.registration import ID, register

if TYPE_CHECKING:
    from foveate.gym.envs import TrackingEnv, TrackingVectorEnv
    from foveate.gym.parallel import TeamEnv

__all__ = ["ID", "TeamEnv", "TrackingEnv", "TrackingVectorEnv"]

register()


def __getattr__(name: str) -> Any:
    # Loaded when an environment is made: a server that forks workers may then import this module before.
    if name not in __all__:
        raise AttributeError(f"module 'foveate.gym' has no attribute {name!r}: it has {', '.join(__all__)}")
    return getattr(import_module("foveate.gym.parallel" if name == "TeamEnv" else "foveate.gym.envs"), name)
