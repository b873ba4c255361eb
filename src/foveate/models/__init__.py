"""Agent, target, sensor and belief as equations, for one target, unbatched."""
