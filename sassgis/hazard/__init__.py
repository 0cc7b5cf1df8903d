"""Statistics of simulated rocks: sums per cell, quantiles, the layers of the map."""
