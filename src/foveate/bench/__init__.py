"""Benchmarks: the measurements of `foveate bench`."""
