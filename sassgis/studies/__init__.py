"""Variants: other values, other seeds, another result.

In: two or more results. Out: bands and differences, and what of them is significant.
May import: sassgis.hazard and below; no files, frames or plots.
"""
