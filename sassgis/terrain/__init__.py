"""From a height model to profiles.

In: heights, release polygons. Out: release points, fall lines, flattened profiles.
May import: sassgis.settings and below; numpy and numba, no files.
"""
