"""Statistics of simulated blocks: sums per cell, quantiles, the layers of the map."""
