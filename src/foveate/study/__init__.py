"""Comparisons of many methods over many scenes and seeds: `foveate reproduce`."""
