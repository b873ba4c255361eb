"""Targets unknown in number, missed detections and false alarms: the Poisson multi-Bernoulli filter."""
