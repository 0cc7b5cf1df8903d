"""How far the gap shrinks: calibration on some rocks, distances on held-out rocks."""
