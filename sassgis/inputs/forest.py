"""The forest of ``[effects.trees]`` on the cells of the terrain."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import ndimage

from sassgis.engine.effects.trees import ENERGY_EXPONENT, energy_ratios
from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.csv_table import CsvColumn, read_table
from sassgis.inputs.dem import on_cells, only_band, read_band
from sassgis.inputs.dem_system import extent_text
from sassgis.inputs.vector_features import Feature, polygon_of_cells, read_features
from sassgis.settings.schema import InMemory, Input
from sassgis.settings.settings import ForestPlace

_HECTARE_M2 = 1e4
#: Single trees are counted within so much of the centre of a cell (m).
TREES_WITHIN_M = 5.0
_TREES = "a CSV table with columns x, y, dbh_cm and, if wanted, conifer_share; or points"


def read_forest(
    trees: ForestPlace, grid: Grid, whole: Grid | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return stems per m² and diameter (m) of each cell: float64, shape (n_rows * n_cols,).

    Both are 0 where no forest stands. What the files hold must meet the ``whole`` terrain model of
    which the grid is a part.
    """
    stems = np.full(grid.shape, trees.stems_per_ha or 0.0)
    diameter = np.full(grid.shape, trees.dbh_cm or 0.0)
    if trees.file is not None:
        stems, diameter = _from_polygons(trees, trees.file, grid, whole or grid)
    if trees.single_trees is not None:
        stems, diameter = _from_trees(trees.single_trees, grid, whole or grid)
    if trees.stems_raster is not None:
        stems = _from_raster(trees.stems_raster, grid, "stems_raster", whole is not None)
    if trees.dbh_raster is not None:
        diameter = _from_raster(trees.dbh_raster, grid, "dbh_raster", whole is not None)
    nothing = (stems <= 0.0) | (diameter <= 0.0)
    stems = np.where(nothing, 0.0, stems) / _HECTARE_M2
    return stems.ravel(), np.where(nothing, 0.0, diameter).ravel() / 100.0


def _from_polygons(
    trees: ForestPlace, file: Input, grid: Grid, whole: Grid
) -> tuple[FloatArray, FloatArray]:
    fields = {"stems_field": trees.stems_field, "dbh_field": trees.dbh_field}
    features = read_features(
        file, whole, "effects.trees", layer=trees.layer, fields=fields, kinds=("polygon",)
    )
    polygon = polygon_of_cells(features, grid)
    maps = []
    for field, default in zip(fields.values(), (trees.stems_per_ha, trees.dbh_cm), strict=True):
        values = []
        for feature in features:
            value = default
            if field is not None and feature.text(field) is not None:
                value = feature.value(field)
            if value is None or value < 0.0:
                problem = "has no number that can be used"
                raise feature.wrong(problem, field, found=value, expected="0 or more")
            values.append(value)
        # The last counts where no polygon does (-1).
        maps.append(np.array([*values, 0.0])[polygon])
    return maps[0], maps[1]


def _from_raster(file: Input, grid: Grid, key: str, may_miss: bool) -> FloatArray:
    """Return values at the nearest cell; 0 where the raster has none."""
    field = f"effects.trees.{key}"

    def read(raster: Any) -> FloatArray:
        band = only_band(raster, file, field, "numbers")
        # Not 0: the warper shifts valid zeros by a hair where that means no value.
        stored = np.ma.filled(read_band(raster, band, file).astype(np.float64), np.nan)
        values: FloatArray = stored * raster.scales[band - 1] + raster.offsets[band - 1]
        return values

    aligned = on_cells(file, grid, field, read, np.nan)
    if np.isnan(aligned).all() and not may_miss:
        raise InputError(
            "holds no value on the DEM", file=file, field=field,
            expected="a raster that overlaps the DEM",
        )  # fmt: skip
    out: FloatArray = np.nan_to_num(aligned, nan=0.0, posinf=np.inf)
    if not np.isfinite(out).all() or (out < 0.0).any():
        raise InputError(
            "holds numbers that cannot be used", file=file, field=field, expected="0 or more"
        )
    return out


def _from_trees(file: Input, grid: Grid, whole: Grid) -> tuple[FloatArray, FloatArray]:
    """Count the stems per hectare within TREES_WITHIN_M of each cell, and find their diameter.

    The diameter (cm) is that of a fir that takes as much energy as one of them on average.
    """
    x, y, dbh_cm, conifers = _trees_of(file, whole)
    if not (whole.cell_of(x, y) >= 0).any():
        raise InputError(
            "no tree lies on the DEM", file=file, field="effects.trees.single_trees",
            found=extent_text(x.min(), y.min(), x.max(), y.max()),
            expected="coordinates of the DEM",
        )  # fmt: skip
    ratios = energy_ratios()
    factor = np.where(
        np.isnan(conifers), 1.0,
        conifers * ratios["conifers"] + (1.0 - conifers) * ratios["broadleaved"],
    )  # fmt: skip
    # Trees beyond the edge of the grid count within it.
    reach = math.ceil(TREES_WITHIN_M / grid.cell_size)
    col = np.floor((x - grid.west) / grid.cell_size).astype(np.int64) + reach
    row = np.floor((grid.north - y) / grid.cell_size).astype(np.int64) + reach
    shape = (grid.shape[0] + 2 * reach, grid.shape[1] + 2 * reach)
    near = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    count, energy = np.zeros(shape), np.zeros(shape)
    place = (row[near], col[near])
    np.add.at(count, place, 1.0)
    np.add.at(energy, place, (factor * dbh_cm**ENERGY_EXPONENT)[near])
    step = np.arange(-reach, reach + 1) * grid.cell_size
    disk = (np.hypot(step[:, None], step[None, :]) <= TREES_WITHIN_M).astype(float)
    own = (slice(reach, -reach), slice(reach, -reach))
    stems, taken = (
        np.asarray(ndimage.convolve(values, disk, mode="constant"))[own]
        for values in (count, energy)
    )
    one: FloatArray = (taken / np.maximum(stems, 1.0)) ** (1.0 / ENERGY_EXPONENT)
    per_hectare: FloatArray = stems * _HECTARE_M2 / (disk.sum() * grid.cell_size**2)
    return per_hectare, one


def _trees_of(file: Input, grid: Grid) -> tuple[FloatArray, ...]:
    """Return x, y, diameter (cm) and share of conifers (NaN: not stated) of each tree."""
    key = "effects.trees"
    is_table = isinstance(file, InMemory) and file.kind == "table"
    if is_table or file.suffix.lower() in (".csv", ".txt"):
        columns = {
            "x": CsvColumn(float), "y": CsvColumn(float), "dbh_cm": CsvColumn(float, low=0.0),
            "conifer_share": CsvColumn(float, low=0.0, default=math.nan),
        }  # fmt: skip
        rows = list(read_table(file, f"{key}.single_trees", _TREES, columns))
        found = [(where, tuple(row.values())) for where, row in rows]
    else:
        features = read_features(
            file, grid, key, fields={"single_trees": "dbh_cm"}, kinds=("point",)
        )
        found = [(f.label, _tree(f)) for f in features]
    if not found:
        raise InputError("holds no tree", file=file, expected="a row for each")
    for where, (_, _, _, conifers) in found:
        if conifers > 1.0:
            raise InputError(
                f"{where}: is out of range", file=file, field="conifer_share", found=conifers,
                expected="a share, 0 to 1",
            )  # fmt: skip
    return tuple(np.array([values for _, values in found], np.float64).T)


def _tree(feature: Feature) -> tuple[float, ...]:
    share, place = "conifer_share", feature.geometry
    conifers = math.nan if feature.text(share) is None else feature.value(share)
    return place.x, place.y, feature.value("dbh_cm"), conifers
