"""Policies: networks and heuristics."""
