"""What decides: networks, and heuristics."""
