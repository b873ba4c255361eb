"""foveate: teach a mobile agent with a limited field of view where to look."""

__version__ = "0.1.0"
