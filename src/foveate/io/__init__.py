"""Files, tables on screen, progress: what knows nothing of targets."""
