"""What defines a training: its settings, presets, checkpoints and run folder."""
