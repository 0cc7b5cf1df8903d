"""Observations on a slope: tables, their faults, and the case made of them.

In: tables as read, and the terrain and blocks of a configuration. Out: a ``Case``, everything in
the planes of fall lines, and its ``Campaign``. Imports model, terrain, and the engine for types.
"""
