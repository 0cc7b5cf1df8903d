"""Ground classes, their ranges and the forest on the cells of the terrain model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.engine.effects.trees import ENERGY_EXPONENT, energy_ratios
from sassgis.errors import InputError, notice
from sassgis.files.plain_file import read_text, toml_table
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.csv_table import CsvColumn, check_columns, errors_of_row, read_table, row_of
from sassgis.inputs.dem import on_cells, only_band, open_raster, read_band
from sassgis.inputs.dem_system import extent_text
from sassgis.inputs.vector_features import (
    Feature,
    polygon_of_cells,
    read_features,
    refuse_twice,
    refuse_unknown,
)
from sassgis.settings.blocks import ForestPlace
from sassgis.settings.ground import (
    EVERY_CLASS,
    PARAMETERS,
    RANGED,
    TRUST_TEXT,
    GroundClass,
    GroundTable,
    RangeRule,
)
from sassgis.settings.schema import AnyInput, InMemory, Input, named
from sassgis.settings.settings import GroundSettings

_NO_CODE = np.iinfo(np.int32).min
_DATA = resources.files("sassgis") / "data"


#: The built-in classes by named set of readings. Values calibrated with one set of readings would
#: be wrong with another; those for "1986" are the estimates that its studies were made with.
_BUILT_IN = {"hazard": "ground_classes.csv", "1986": "ground_classes_1986.csv"}


def built_in_table(readings: str = "hazard") -> GroundTable:
    """Return ground classes that come with sassgis, for a named set of readings of the engine.

    ``source`` says what was read and what chosen.
    """
    with resources.as_file(_DATA / _BUILT_IN[readings]) as file:
        return GroundTable(tuple(_read_classes(file)))


def read_ground_table(path: AnyInput | None = None, readings: str = "hazard") -> GroundTable:
    """Read the ground classes of a run.

    The user's table, CSV or TOML (``[[classes]]``), has a name and the PARAMETERS of a GroundClass
    and, if wanted, source and trust. A class of a built-in name replaces that one; others are
    added. ``readings`` are those of built_in_table.
    """
    table = built_in_table(readings)
    if path is None:
        return table
    classes = {c.name: c for c in table.classes}
    own = _read_classes(named(path))
    problem = "ground class is defined twice"
    refuse_twice((c.name for c in own), "names that differ", problem, file=path, field="name")
    for ground_class in own:
        if ground_class.name in classes:
            notice(f"{path}: class {ground_class.name} replaces the built-in one", "info")
        classes[ground_class.name] = ground_class
    return GroundTable(tuple(classes.values()))


def _columns(file: Input) -> dict[str, CsvColumn]:
    """Return columns of a table of classes; values without a stated trust are estimates."""
    return {
        "name": CsvColumn(),
        **{parameter: CsvColumn(float) for parameter in PARAMETERS},
        "mu_v": CsvColumn(float, default=0.0),
        "source": CsvColumn(default=f"own table {file.name}"),
        "trust": CsvColumn(known=tuple(TRUST_TEXT), default="estimate"),
    }


def _read_classes(file: Input) -> list[GroundClass]:
    what = "a table of ground classes, CSV or TOML"
    if file.suffix.lower() == ".toml":
        text = read_text(file, "ground.classes", what)
        rows = list(_toml_rows(text, file))
    else:
        rows = list(read_table(file, "ground.classes", what, _columns(file)))
    if not rows:
        raise InputError("holds no ground class", file=file, expected="at least one row")
    classes = []
    for where, row in rows:
        with errors_of_row(where, file):
            classes.append(GroundClass(**row))
    return classes


def _toml_rows(text: str, file: Input) -> Iterator[tuple[str, dict[str, Any]]]:
    wrong = partial(InputError, file=file)
    document = toml_table(text, file, "[[classes]] sections")
    rows = document.get("classes")
    if set(document) != {"classes"} or not isinstance(rows, list):
        found = f"keys {', '.join(document) or 'none'}"
        expected = "[[classes]] sections and nothing else"
        raise wrong("is not a table of ground classes", found=found, expected=expected)
    columns = _columns(file)
    for place, row in enumerate(rows, start=1):
        where = f"class number {place}"
        if not isinstance(row, dict):
            raise wrong(f"{where} is not a section", expected="[[classes]]")
        check_columns(list(row), columns, file, where)
        yield where, row_of(row, columns, where, file)


def read_ranges(table: GroundTable, own: Input | None = None) -> tuple[RangeRule, ...]:
    """Return rules of the built-in table, and after them those of the user.

    That may name the classes of ``table``. It is a CSV with the columns class (``*`` for every
    other class), parameter, kind (value, offset, factor), low, high and, if wanted, source,
    verified, sites, rocks and together.
    """
    with resources.as_file(_DATA / "ground_ranges.csv") as file:
        rules = _read_rules(file, None)
    return rules if own is None else (*rules, *_read_rules(own, table))


def _read_rules(file: Input, table: GroundTable | None) -> tuple[RangeRule, ...]:
    classes = () if table is None else (*table.names, EVERY_CLASS)
    columns = {
        "class": CsvColumn(known=classes, what="ground class"),
        "parameter": CsvColumn(known=RANGED),
        "kind": CsvColumn(known=("value", "offset", "factor")),
        "low": CsvColumn(float),
        "high": CsvColumn(float),
        "source": CsvColumn(default=f"own table {file.name}"),
        "verified": CsvColumn(bool, default=False),
        "sites": CsvColumn(int, low=0, default=0),
        "rocks": CsvColumn(int, low=0, default=0),
        "together": CsvColumn(default=""),
    }
    rules = []
    what = "a table of ranges of ground classes (CSV)"
    for where, row in read_table(file, "ranges", what, columns):
        with errors_of_row(where, file):
            rules.append(RangeRule(*row.values()))
    return tuple(rules)


def ground_raster(
    ground: GroundSettings, grid: Grid, table: GroundTable, whole: Grid | None = None
) -> NDArray[np.int32]:
    """Return the ground class of each cell of the DEM, as position in the table (int32).

    A cell takes the class of the polygon over its centre (polygon_of_cells), or of the nearest cell
    of a raster of codes; where nothing is said, the default class. What the file holds must meet
    the ``whole`` terrain model of which the grid is a part; its heights are not looked at.
    """
    if ground.file is None:
        return np.full(grid.shape, default_class(ground, table), dtype=np.int32)
    if ground.raster_classes is not None:
        return _from_codes(ground, ground.file, grid, table, whole is not None)
    return _from_polygons(ground, ground.file, grid, table, whole or grid)


def default_class(ground: GroundSettings, table: GroundTable) -> int:
    """Return the position of the default class; InputError if the table does not hold it."""
    place = ground.config_file, "ground.default"
    return _class_index(ground.default, table, "default class", *place)


def _class_index(name: str, table: GroundTable, who: str, file: Input | None, field: str) -> int:
    refuse_unknown(name, table.names, f"{who} is not a known ground class", file=file, field=field)
    return table.index(name)


def _from_polygons(
    ground: GroundSettings, file: Input, grid: Grid, table: GroundTable, whole: Grid
) -> NDArray[np.int32]:
    default = default_class(ground, table)
    if _is_raster(file):
        expected = 'ground.raster_classes beside it, such as {1 = "rock", 2 = "debris"}'
        raise InputError("is a raster", file=file, field="ground.file", expected=expected)
    field = ground.class_field
    features = read_features(
        file, whole, "ground", layer=ground.layer, fields={"class_field": field}, label=field,
        kinds=("polygon",),
    )  # fmt: skip
    classes = []
    for feature in features:
        name = feature.text(field)
        if name is None:
            expected = f"one of {', '.join(table.names)}"
            raise feature.wrong("has no ground class", field, expected=expected)
        classes.append(_class_index(name, table, f"class of {feature.label}", file, field))
    # The last counts where no polygon does (-1).
    by_polygon = np.array([*classes, default], np.int32)
    return by_polygon[polygon_of_cells(features, grid)]


def _is_raster(file: Input) -> bool:
    """Return whether a file holds a raster (a GeoPackage may hold both: then its layers count)."""
    if isinstance(file, InMemory):
        return file.kind == "raster"
    if file.suffix.lower() == ".gpkg":
        return False
    try:
        with open_raster(file, "ground.file") as dataset:
            return bool(dataset.count)
    except InputError:
        return False


def _from_codes(
    ground: GroundSettings, file: Input, grid: Grid, table: GroundTable, may_miss: bool
) -> NDArray[np.int32]:
    default, field = default_class(ground, table), "ground.raster_classes"
    indices = {
        code: _class_index(name, table, f"class of code {code}", file, field)
        for code, name in (ground.raster_classes or {}).items()
    }
    aligned = on_cells(file, grid, "ground.file", partial(_codes, file=file), _NO_CODE)
    present, counts = np.unique(aligned, return_counts=True)
    if present.tolist() == [_NO_CODE] and not may_miss:
        expected = "a raster that overlaps the DEM"
        problem = "holds no ground class on the DEM"
        raise InputError(problem, file=file, field="ground.file", expected=expected)
    result = np.full(grid.shape, default, dtype=np.int32)
    for code, count in zip(present.tolist(), counts.tolist(), strict=True):
        if code == _NO_CODE:
            continue
        if code not in indices:
            codes = ", ".join(map(str, sorted(indices)))
            raise InputError(
                "holds a code without a class", file=file, field=field,
                found=f"code {code} in {count} cells",
                expected=f"a class for it; known codes: {codes}",
            )  # fmt: skip
        result[aligned == code] = indices[code]
    return result


def _codes(dataset: Any, file: Input) -> NDArray[np.int32]:
    """Return codes as whole numbers; nodata as a number that no code can have."""
    raw = read_band(dataset, only_band(dataset, file, "ground.file", "codes"), file)
    values = np.asarray(raw.data, dtype=np.float64)
    known = ~np.ma.getmaskarray(raw) & ~np.isnan(values)
    odd = known & ((values != np.rint(values)) | (np.abs(values) > 2**31 - 2))
    if odd.any():
        row, col = np.unravel_index(int(np.argmax(odd)), values.shape)
        raise InputError(
            "holds a code that is no whole number", file=file, field="ground.file",
            found=f"{values[row, col]:g} at row {row + 1}, column {col + 1}",
            expected="whole numbers",
        )  # fmt: skip
    return np.where(known, values, _NO_CODE).astype(np.int32)


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
        stems, diameter = _forest_of_polygons(trees, trees.file, grid, whole or grid)
    if trees.single_trees is not None:
        stems, diameter = _from_trees(trees.single_trees, grid, whole or grid)
    if trees.stems_raster is not None:
        stems = _from_raster(trees.stems_raster, grid, "stems_raster", whole is not None)
    if trees.dbh_raster is not None:
        diameter = _from_raster(trees.dbh_raster, grid, "dbh_raster", whole is not None)
    nothing = (stems <= 0.0) | (diameter <= 0.0)
    stems = np.where(nothing, 0.0, stems) / _HECTARE_M2
    return stems.ravel(), np.where(nothing, 0.0, diameter).ravel() / 100.0


def _forest_of_polygons(
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
