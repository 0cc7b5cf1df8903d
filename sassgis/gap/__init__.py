"""Observed rocks against simulated ones: where and why they differ, and ground fitted to them.

Rooms, each building on those before: observations, forward, residuals, causes, fit, verdict,
advice; ``diagnosis`` holds the answer, ``words`` the names for readers, ``constants``
all thresholds and tolerances. No files, no frames, no plots.
"""
