"""Calibration: of ground classes, and of every hypothesis of the diagnosis."""
