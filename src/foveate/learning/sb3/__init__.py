"""PPO by Stable-Baselines3 (extra `ppo`)."""
