"""Observed against predicted: runs from the release, reaches, impacts and flights.

In: a ``Case`` and a model. Out: a ``ResidualTable``, one value per rock and one row per step.
Imports observations, forward, and the engine.
"""
