"""Figures and moving pictures of episodes."""
