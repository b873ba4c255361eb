"""Experiments: settings, presets, checkpoints and run folders."""
