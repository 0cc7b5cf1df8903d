"""Observed against predicted: single impacts, flights, reaches between stations."""
