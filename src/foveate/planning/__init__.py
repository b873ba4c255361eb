"""Receding-horizon and omniscient planners."""
