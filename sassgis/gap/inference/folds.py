"""Parts of the rocks for cross-validation."""

from __future__ import annotations

import numpy as np

from sassgis.model.grid import IntArray

#: Parts into which the rocks are split.
FOLDS = 5


def folds_of(n_rocks: int, seed: int) -> IntArray:
    """Part of each rock for cross-validation, shape (n_rocks,)."""
    order = np.random.default_rng([seed, 21]).permutation(n_rocks)
    part = np.empty(n_rocks, np.int64)
    part[order] = np.arange(n_rocks) % min(FOLDS, n_rocks)
    return part
