"""Calibration of ground classes: the parameters that observed rocks can identify, and how well."""
