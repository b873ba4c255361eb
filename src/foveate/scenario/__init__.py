"""Checked settings of a world, as a TOML file says them, and scenes of it."""
