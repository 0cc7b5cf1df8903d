"""How far the gap shrinks: calibration on some rocks, distances on rocks left out."""
