"""Learners: policy gradient, actor-critic, PPO, and the loop around them."""
