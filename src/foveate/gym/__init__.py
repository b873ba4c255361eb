"""Gymnasium environments (extra `gym`); importing this module registers them."""

from foveate.gym.envs import ID, TrackingEnv, TrackingVectorEnv

__all__ = ["ID", "TrackingEnv", "TrackingVectorEnv"]
