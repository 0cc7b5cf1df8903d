"""Many blocks: chunks of release points, sums per cell, workers, saved state.

In: a MapRun. Out: sums and rows that do not depend on chunks, threads or order.
May import: sassgis.engine, sassgis.terrain and below.
"""
