"""What `foveate bench` measures."""
