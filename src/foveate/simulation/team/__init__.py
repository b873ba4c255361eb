"""Teams of robots with a radio: what they hear of each other, and what they make of it."""
