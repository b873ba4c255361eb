"""Scores, errors, intervals and bounds of any policy on any scenes."""
