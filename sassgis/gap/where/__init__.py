"""Where the gap lies: place, phase, quantity."""
