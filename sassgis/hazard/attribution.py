"""Which release area and scenario a zone comes from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.settings.hazard_rules import Source, SourceCounts


def zone_of_cells(coverage: Coverage, grid: Grid, cells: IntArray) -> IntArray:
    """Return the position of the zone that holds the centre of each cell; -1 outside all zones.

    ``cells`` are flat indices on the grid of the zones, ascending. A centre on a common boundary
    belongs to the higher class, then to the earlier zone.
    """
    zone = np.full(np.size(cells), -1, np.int64)
    if zone.size == 0 or coverage.polygons.size == 0:
        return zone
    x, y = grid.cell_centres(cells)
    shapely.prepare(coverage.polygons)
    west, south, east, north = shapely.bounds(coverage.polygons).T
    # Cells ascend from the north to the south.
    first, last = np.searchsorted(-y, -north), np.searchsorted(-y, -south, side="right")
    # The last one written stays.
    for k in np.lexsort((-np.arange(west.size), coverage.classes)).tolist():
        rows = slice(first[k], last[k])
        near = first[k] + np.flatnonzero((x[rows] >= west[k]) & (x[rows] <= east[k]))
        zone[near[shapely.intersects_xy(coverage.polygons[k], x[near], y[near])]] = k
    return zone


def attribution(
    zone_of_cell: IntArray,
    cells: IntArray,
    sources: Sequence[Source],
    counts: Sequence[SourceCounts],
    column_of_cell: IntArray,
    n_zones: int,
) -> FloatArray:
    """Compute the share of each source in the rate that makes each zone.

    Parameters
    ----------
    zone_of_cell : int64, shape (n,)
        From `zone_of_cells`; cells of -1 do not count.
    cells : int64, shape (n,)
        Flat indices, ascending.
    column_of_cell : int64, shape (n,)
        Column of the energy that decides the class of each cell.

    Returns
    -------
    float64, shape (n_zones, n_sources)
        Of the rates at the deciding energy, summed over the cells of the zone. NaN for a zone
        without a reached cell: all its cells were raised.
    """
    if np.any(np.diff(cells) <= 0):
        raise ValueError("cells are not in ascending order")
    rate = np.zeros((n_zones, len(sources)))
    if cells.size:
        for s, (source, count) in enumerate(zip(sources, counts, strict=True)):
            at = np.minimum(np.searchsorted(cells, count.places), cells.size - 1)
            known = (cells[at] == count.places) & (zone_of_cell[at] >= 0)
            at = at[known]
            rocks = count.count[known, column_of_cell[at]]
            rate[:, s] = source.rate_per_rock * np.bincount(
                zone_of_cell[at], weights=rocks, minlength=n_zones
            )
    total = rate.sum(axis=1, keepdims=True)
    shares = np.full_like(rate, np.nan)
    np.divide(rate, total, out=shares, where=total > 0.0)
    return shares


def governing(shares: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the source with the largest share in each zone, and that share; shape (n_zones,).

    The first of equal ones; -1 and NaN where no source reaches the zone.
    """
    n_zones = shares.shape[0]
    if shares.shape[1] == 0:
        return np.full(n_zones, -1, np.int64), np.full(n_zones, np.nan)
    reached = ~np.isnan(shares).all(axis=1)
    source = np.where(reached, np.argmax(np.nan_to_num(shares, nan=-1.0), axis=1), -1)
    share = np.where(reached, shares[np.arange(n_zones), source], np.nan)
    return source.astype(np.int64), share


def shares_by(shares: FloatArray, names: Sequence[str]) -> tuple[tuple[str, ...], FloatArray]:
    """Add up the shares of sources of the same name (area or scenario): names, shares by zone."""
    each = tuple(dict.fromkeys(names))
    columns = [np.array([n == name for n in names]) for name in each]
    parts = [shares[:, column].sum(axis=1) for column in columns]
    return each, np.column_stack(parts) if parts else np.empty((shares.shape[0], 0))
