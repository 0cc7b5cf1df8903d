"""From sums to curves, levels, zones and risk.

In: sums of a simulation, frequencies, rules. Out: hazard curves, levels, zones, values at objects.
May import: sassgis.simulation and below; no files, frames or plots.
"""
