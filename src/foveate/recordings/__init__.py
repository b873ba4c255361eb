"""Recorded trajectories: read, fit a scenario, replay."""
