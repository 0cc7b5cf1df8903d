"""Parts of the rocks for cross-validation."""

from __future__ import annotations

import numpy as np

from sassgis.model.grid import IntArray

#: Parts into which the rocks are split.
FOLDS = 5


def folds_of(group: IntArray, seed: int) -> IntArray:
    """Part of each rock for cross-validation, shape (n_rocks,).

    Parameters
    ----------
    group : int64, shape (n_rocks,)
        Rocks of a group (block, day, source) come into the same part. A single group is split.
    """
    rng = np.random.default_rng([seed, 21])
    groups, unit = np.unique(group, return_inverse=True)
    if groups.size == 1:
        unit = np.arange(group.size)
    size = np.bincount(unit)
    order = rng.permutation(size.size)
    # The largest first, each into the part that has the fewest rocks so far.
    order = order[np.argsort(-size[order], kind="stable")]
    part_of, filled = np.empty(size.size, np.int64), np.zeros(min(FOLDS, size.size), np.int64)
    for k in order.tolist():
        part_of[k] = int(np.argmin(filled))
        filled[part_of[k]] += size[k]
    return part_of[unit]
