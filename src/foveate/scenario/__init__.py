"""Checked settings of a scenario, as in a TOML file, and its scenes."""
