"""Figures and animations of episodes."""
