"""Many release areas or tiles, one after another, and their mosaic.

In: a configuration of a region. Out: a result of each area and one map of all.
May import: sassgis.runs and below.
"""
