"""Rasters as layers: described in ``data/map_layers.csv``, or in the table of statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.files.vector_layer import descriptions
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.hazard_rules import HazardPreset
from sassgis.settings.languages import phrase
from sassgis.settings.results import Band, RasterClass, RasterLayer, thousands
from sassgis.settings.statistics_table import FEW_BLOCKS, STATISTICS
from sassgis.settings.styles import HILLSHADE
from sassgis.simulation.map_sums import MapSums, Sample, band_values


def on_grid(values: NDArray[Any], cells: IntArray, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return a map of the values of single cells, NaN elsewhere."""
    out = np.full(shape[0] * shape[1], np.nan, np.float32)
    out[cells] = values.astype(np.float32)
    return out.reshape(shape)


def described_band(
    key: str, column: str, values: NDArray[Any], name: str = "", **words: object
) -> Band:
    """Return a band as its row in ``data/map_layers.csv`` says; ``words`` fill its ``{...}``."""
    row = descriptions()[key][column]
    description, unit = (phrase(row[part], **words) for part in ("alias", "unit"))
    return Band(name or column, description, unit, values.astype(np.float32))


def described_raster(
    key: str,
    bands: Sequence[Band],
    breaks: Sequence[float] = (),
    ramp: str = "",
    classes: Sequence[RasterClass] = (),
    *,
    stem: str = "",
    **words: object,
) -> RasterLayer:
    """Return map with the title and note of its row in ``data/map_layers.csv``; see RasterLayer."""
    row = descriptions()[key][""]
    title, note = (phrase(row[part], **words) for part in ("alias", "description"))
    return RasterLayer(
        stem=stem or key,
        title=title,
        note=note,
        bands=tuple(bands),
        breaks=tuple(breaks),
        ramp=ramp,
        classes=tuple(classes),
    )


def level_classes(preset: HazardPreset) -> list[RasterClass]:
    """Return hazard levels as classes of a map, from 1."""
    return [
        RasterClass(k, c.label, c.colour, c.hatched) for k, c in enumerate(preset.levels, start=1)
    ]


def terrain_layer(grid: Grid) -> RasterLayer:
    """Return the heights, to be shown as relief."""
    heights = grid.vertical_datum or "datum not stated"
    bands = [described_band("terrain", "height", grid.values)]
    return described_raster("terrain", bands, (), HILLSHADE, heights=heights)


def map_layers(
    sums: MapSums,
    shape: tuple[int, int],
    sample: Sample,
    edges: Mapping[str, FloatArray],
    cell_size: float,
    energy_classes_kj: tuple[float, ...] | None = None,
) -> tuple[RasterLayer, ...]:
    """Return layers of all that is known per cell of the blocks; NaN in cells that none reaches.

    ``edges`` are those of the histograms by quantity. The cell size (m) is the reference width of
    the reach probability. The energy classes (kJ) replace those of the legend.
    """
    words = {
        "rocks": thousands(sample.started),
        "width": phrase(
            "Reference width {} m (one cell): a block counts for a cell if its centre passes "
            "within half this width of the cell centre, or if it stops in the cell.",
            f"{cell_size:.4g}",
        ),
        "once": phrase("Each block counts once per cell, with its largest value there."),
        "few": phrase(
            "Where fewer than {} blocks arrive, the 95 % quantile is mostly too low (with 2 to 4 "
            "blocks by about a quarter). Compare it with the number of arriving blocks.",
            FEW_BLOCKS,
        ),
        "late": phrase(
            "Where fewer than {} blocks arrive, the 5 % quantile is mostly too late. Compare it "
            "with the number of arriving blocks.",
            FEW_BLOCKS,
        ),
        "error": phrase(
            "The standard error also covers the random choice of the release points."
            if sample.random_points
            else "The standard error covers the sampling of blocks at these release points."
        ),
    }
    breaks = {"energy": (0.0, *energy_classes_kj)} if energy_classes_kj else {}
    return tuple(
        RasterLayer(
            row.stem,
            row.title,
            phrase(row.note, **words),
            tuple(
                Band(name, row.description(name), row.unit, on_grid(values, sums.cells, shape))
                for name, values in band_values(row, sums, sample, edges).items()
            ),
            breaks.get(row.quantity, row.breaks),
            row.ramp,
        )
        for row in STATISTICS
    )
