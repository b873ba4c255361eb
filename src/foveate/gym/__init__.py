"""Gymnasium environments (extra `gym`); importing this module registers them."""

try:
    import gymnasium as gymnasium
except ImportError as error:  # before the modules below, which import parts of it
    raise ImportError("foveate.gym needs gymnasium: pip install 'foveate[gym]'") from error

from foveate.gym.envs import ID, TrackingEnv, TrackingVectorEnv

__all__ = ["ID", "TrackingEnv", "TrackingVectorEnv"]
