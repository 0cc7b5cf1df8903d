"""Distances of distributions, tests and intervals, with rocks as the unit."""
