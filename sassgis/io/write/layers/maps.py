"""The maps of the blocks: the table of statistics, filled with the sums per cell."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.map_sums import MapSums, Sample, band_values
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.results import Band, RasterLayer
from sassgis.model.statistics_table import STATISTICS


def _on_map(values: FloatArray, cells: IntArray, shape: tuple[int, int]) -> NDArray[np.float32]:
    out = np.full(shape[0] * shape[1], np.nan, np.float32)
    out[cells] = values.astype(np.float32)
    return out.reshape(shape)


def map_layers(
    sums: MapSums,
    shape: tuple[int, int],
    sample: Sample,
    edges: Mapping[str, FloatArray],
    cell_size: float,
    energy_classes_kj: tuple[float, ...] = (30.0, 300.0),
) -> tuple[RasterLayer, ...]:
    """Layers of all that is known per cell.

    Parameters
    ----------
    sums : MapSums
    shape : (n_rows, n_cols)
    sample : Sample
    edges : mapping
        Edges of the histograms by quantity.
    cell_size : float
        Side of a cell: the reference width of the reach probability (m).
    energy_classes_kj : tuple of float
        Limits of the energy classes in the legend.

    Returns
    -------
    tuple of RasterLayer
        Cells that no block reaches are NaN.
    """
    words = {
        "rocks": sample.started,
        "width": f"Reference width {cell_size:.4g} m (one cell).",
        "once": "Each block counts once per cell, with the largest value that it has there.",
        "error": "Standard error with the release points as a random sample."
        if sample.random_points
        else "Standard error with the release points fixed: blocks are the sample.",
    }
    breaks = {"energy": (0.0, *energy_classes_kj)}
    return tuple(
        RasterLayer(
            row.stem,
            row.title,
            row.note.format(**words),
            tuple(
                Band(name, row.description(name), row.unit, _on_map(values, sums.cells, shape))
                for name, values in band_values(row, sums, sample, edges).items()
            ),
            breaks.get(row.quantity, row.breaks),
            row.ramp,
        )
        for row in STATISTICS
    )
