"""Field observations from a GeoPackage or a folder of CSV files.

What cannot be used is left out and said so, row by row; reading fails only where nothing is left.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pyproj
import shapely
from numpy.typing import NDArray
from pyproj.exceptions import CRSError

from sassgis.gap.observations.checks import check_observations, empty_tables
from sassgis.gap.observations.observation_finding import LeftOut, Level, ObservationFinding
from sassgis.gap.observations.observed import Observations, without
from sassgis.gap.observations.tables import (
    METADATA_KEYS,
    TABLE_TYPES,
    TABLES,
    Column,
    Metadata,
    Stations,
    Table,
)
from sassgis.io.read.csv_table import csv_cells
from sassgis.io.read.offline import read_frame, vector_file
from sassgis.io.read.plain_file import check_text, read_text
from sassgis.io.read.vector_features import nearest, onto_grid
from sassgis.model.crs import parse_crs
from sassgis.model.errors import InputError, shown
from sassgis.model.grid import FloatArray, Grid, IntArray

__all__ = ["read_observations", "validate_observations"]

log = logging.getLogger(__name__)

#: Name under which messages speak of the observations.
_KEY = "observations"
_METADATA = "metadata"
#: Words that say that a cell is empty, in lower case.
_EMPTY = frozenset({"", "-", "na", "n/a", "nan", "null", "none", "<na>", "?", "-9999", "-9999.0"})
#: Tables of a GeoPackage that are not about rocks.
_FOREIGN = frozenset({"layer_styles", "run_metadata"})
#: Units that people write instead, with what to multiply by.
_UNITS = {
    "_kmh": ("_mps", "divided by 3.6"),
    "_kph": ("_mps", "divided by 3.6"),
    "_t": ("_kg", "times 1000"),
    "_cm": ("_m", "divided by 100"),
    "_mm": ("_m", "divided by 1000"),
    "_degps": ("_radps", "times 0.01745"),
    "_dps": ("_radps", "times 0.01745"),
    "_rpm": ("_hz", "divided by 60"),
    "_radps": ("_hz", "divided by 6.2832"),
    "_hz": ("_radps", "times 6.2832"),
}


@dataclass(frozen=True)
class _Raw:
    """A table as it stands in its file: columns of text, numbers or whatever, and its shapes."""

    name: str
    file: Path
    rows: IntArray
    columns: Mapping[str, NDArray[Any]]
    shapes: tuple[Any, ...] | None = None
    crs: Any = None


class _Findings:
    """Collects what is found while reading."""

    def __init__(self) -> None:
        self.all: list[ObservationFinding] = []

    def add(
        self,
        level: Level,
        problem: str,
        raw: _Raw | None = None,
        column: str = "",
        rows: Sequence[int] | IntArray = (),
        *,
        file: str | Path = "",
        found: str = "",
        expected: str = "",
        left_out: LeftOut = "",
    ) -> None:
        self.all.append(
            ObservationFinding(
                level,
                shown(problem),
                str(file or (raw.file if raw else "")),
                raw.name if raw else "",
                shown(column),
                tuple(int(r) for r in rows),
                shown(found),
                shown(expected),
                left_out,
            )
        )


# ---------------------------------------------------------------------------------------------
# Reading


def read_observations(
    path: Path | str, grid: Grid | None = None, *, crs: str | None = None
) -> Observations:
    """Read observations, check them, and leave out what cannot be used.

    Parameters
    ----------
    path
        A GeoPackage, or a folder of CSV files; with tables named as in
        ``sassgis.gap.observations.tables.TABLES``, and ``metadata``. Any of them may be missing.
    grid
        The DEM. Geometries are brought into its coordinates, and all is compared with it.
    crs
        Coordinates to bring geometries into where there is no DEM, such as "EPSG:2056".

    Returns
    -------
    Observations
        With the findings; each is logged as well. What they call left out is not in the tables.

    Raises
    ------
    InputError
        If there is no such file or folder, it cannot be read, it holds no table of observations
        with rows, or no table with places lies on the DEM.
    """
    path = Path(path)
    findings = _Findings()
    raws, metadata = _raw_tables(path, findings)
    tables: dict[str, Table] = {}
    failed: list[InputError] = []
    for name, raw in raws.items():
        try:
            tables[name] = _table(raw, grid, crs, findings)
        except InputError as error:
            failed.append(error)
            findings.add(
                "error",
                error.problem,
                raw,
                found=str(error.found or ""),
                expected=error.expected or "",
                left_out="table",
            )
    observations = Observations(
        **tables,  # type: ignore[arg-type]
        metadata=_metadata(metadata, findings) if metadata else Metadata(),
        files={name: str(raw.file) for name, raw in raws.items()},
    )
    found = [*findings.all, *empty_tables(observations, [r for r in raws if r in tables])]
    checked = check_observations(observations, grid)
    hopeless = [f for f in found if f.problem == "holds no observed rock"]
    if hopeless and failed:
        raise failed[0]
    _refuse_elsewhere(observations, checked, path)
    if hopeless:
        raise InputError(
            hopeless[0].problem,
            file=path,
            found=hopeless[0].found,
            expected=hopeless[0].expected,
        )
    # What was left out while reading is gone already: only its record is kept.
    observations = replace(observations, findings=tuple(found))
    observations = without(observations, checked)
    for finding in observations.findings:
        log.log(
            logging.ERROR if finding.level == "error" else logging.WARNING,
            "%s",
            str(finding).partition(": ")[2],
        )
    return observations


def validate_observations(
    observations: Observations, grid: Grid | None = None
) -> list[ObservationFinding]:
    """All that their owner should know about observations.

    Parameters
    ----------
    observations : Observations
        As read, or made up by a program.
    grid : Grid, optional
        The DEM; without it, nothing is compared with the terrain.

    Returns
    -------
    list of ObservationFinding
        Errors first; ``str`` gives one line that names file, table, column and row.
    """
    fresh = [f for f in check_observations(observations, grid) if f not in observations.findings]
    # Leaving values out must not turn into new findings of the same kind.
    known = {(f.problem, f.table, f.column) for f in observations.findings}
    fresh = [f for f in fresh if (f.problem, f.table, f.column) not in known]
    return sorted((*observations.findings, *fresh), key=lambda f: f.level != "error")


def _refuse_elsewhere(
    observations: Observations, checked: Sequence[ObservationFinding], path: Path
) -> None:
    """Raise InputError where every table that has places lies beside the DEM."""
    beside = {f.table: f for f in checked if f.problem.startswith("no row lies on the DEM")}
    placed = {name for name, columns in observations.present.items() if {"x", "y"} <= columns}
    if placed and placed <= set(beside):
        first = beside[sorted(placed, key=list(TABLES).index)[0]]
        raise InputError(
            first.problem,
            file=first.file or path,
            field=first.table,
            found=first.found,
            expected=first.expected,
        )


def _raw_tables(path: Path, findings: _Findings) -> tuple[dict[str, _Raw], _Raw | None]:
    if not path.exists():
        raise InputError(
            "not found", file=path, field=_KEY, expected="a GeoPackage or a folder of CSV files"
        )
    raws = _csv_folder(path, findings) if path.is_dir() else _geopackage(path, findings)
    metadata = raws.pop(_METADATA, None)
    if not raws:
        raise InputError(
            "holds no table of observations",
            file=path,
            field=_KEY,
            expected=f"at least one of {', '.join(TABLES)}"
            + (" (each a CSV file)" if path.is_dir() else ""),
        )
    return {name: raws[name] for name in TABLES if name in raws}, metadata


def _known_table(name: str, file: Path, findings: _Findings) -> str | None:
    lower = name.strip().lower()
    if lower in TABLES or lower == _METADATA:
        return lower
    if lower not in _FOREIGN:
        findings.add(
            "warning",
            f"table {name} is not one of observations and is not read",
            file=file,
            expected=nearest(lower, (*TABLES, _METADATA)),
        )
    return None


def _csv_folder(folder: Path, findings: _Findings) -> dict[str, _Raw]:
    raws: dict[str, _Raw] = {}
    for file in sorted(p for p in folder.iterdir() if p.suffix.lower() == ".csv"):
        name = _known_table(file.stem, file, findings)
        if name is None:
            continue
        columns, delimiter, lines = csv_cells(read_text(file, _KEY, "a table (CSV)"), file)
        texts = {c.name for c in TABLES.get(name, ()) if c.text} | {"key", "value"}
        rows, cells, short = [], [], []
        for line, row in lines:
            if len(row) == len(columns):
                rows.append(line)
                cells.append([v.strip() for v in row])
            else:
                short.append(line)
        data = {c: np.array([row[i] for row in cells], dtype=object) for i, c in enumerate(columns)}
        if delimiter == ";":
            for c in data:
                if c.lower() not in texts:
                    data[c] = np.array([v.replace(",", ".") for v in data[c]], dtype=object)
        raws[name] = raw = _Raw(name, file, np.array(rows, np.int64), data)
        if len(set(columns)) < len(columns):
            twice = next(c for c in columns if columns.count(c) > 1)
            findings.add("warning", "column is there twice: the last one is read", raw, twice)
        if short:
            findings.add(
                "error",
                "does not fit the header",
                raw,
                rows=short,
                expected=f"{len(columns)} values (texts with a {delimiter} in quotes)",
                left_out="row",
            )
    return raws


def _geopackage(file: Path, findings: _Findings) -> dict[str, _Raw]:
    raws = {}
    with vector_file(file, _KEY):
        for layer, geometry in pyogrio.list_layers(file).tolist():
            name = _known_table(str(layer), file, findings)
            if name is None:
                continue
            frame = read_frame(file, layer, fid_as_index=True, on_invalid="ignore")
            shapes, crs = None, None
            if geometry is not None and isinstance(frame, gpd.GeoDataFrame):
                shapes, crs = tuple(frame.geometry.array), frame.crs
                frame = pd.DataFrame(frame.drop(columns=frame.geometry.name))
            columns = {str(c): frame[c].to_numpy(dtype=object) for c in frame.columns}
            raws[name] = _Raw(name, file, frame.index.to_numpy(np.int64), columns, shapes, crs)
    return raws


# ---------------------------------------------------------------------------------------------
# One table


def _table(raw: _Raw, grid: Grid | None, crs: str | None, findings: _Findings) -> Table:
    columns = _named_columns(raw, findings)
    n = raw.rows.size
    data: dict[str, Any] = {"row": raw.rows}
    for column in TABLES[raw.name]:
        if column.text:
            values = columns.get(column.name)
            names = [""] * n if values is None else _names(values)
            data[column.name] = _short(raw, column.name, names, findings)
        elif column.name in columns:
            data[column.name] = _numbers(raw, column, columns[column.name], findings)
    if raw.shapes is not None:
        data |= _placed(raw, data, grid, crs, findings)
    elif raw.name != "stations":
        _half_places(raw, data, findings)
    keep = _identified(raw, data, findings)
    if raw.name == "stations":
        return _stations(raw, data, keep, findings)
    table = TABLE_TYPES[raw.name].of(**data).take(keep)
    if raw.name == "trajectories" and len(table):
        return _by_time(table)
    return table


def _by_time(table: Table) -> Table:
    """Rows by rock, in the order of their first appearance, then by time."""
    ids = table.rock_id.tolist()  # type: ignore[attr-defined]
    place = {name: i for i, name in enumerate(dict.fromkeys(ids))}
    rank = np.array([place[i] for i in ids], np.int64)
    return table.take(np.lexsort((table.t_s, rank)))  # type: ignore[attr-defined]


def _named_columns(raw: _Raw, findings: _Findings) -> dict[str, NDArray[Any]]:
    """Columns under their own names; those that are not known are not read."""
    own = {name: column for column in TABLES[raw.name] for name in (column.name, *column.aliases)}
    result: dict[str, NDArray[Any]] = {}
    for given, values in raw.columns.items():
        name = given.strip().lower()
        if name in own:
            # The name itself goes before any other spelling.
            if own[name].name not in result or name == own[name].name:
                result[own[name].name] = values
            continue
        if name in ("", "fid", "id", "geom", "geometry", "wkt"):
            continue
        known = [c.name for c in TABLES[raw.name]]
        findings.add(
            "warning",
            "column is not known and is not read",
            raw,
            given,
            expected=_meant(name, known),
        )
    return result


def _meant(name: str, known: Sequence[str]) -> str:
    """The column that was probably meant, also in another unit."""
    for unit, (right, factor) in _UNITS.items():
        if name.endswith(unit) and (stem := name[: -len(unit)] + right) in known:
            return f"{stem}: the values {factor}"
    with_unit = [k for k in known if re.sub(r"_(mps|hz|m|kg|m3|kgm3|radps|deg|s)$", "", k) == name]
    return f"{with_unit[0]}, with its unit" if with_unit else nearest(name, known)


def _names(values: NDArray[Any]) -> list[str]:
    """Identifiers as text; 7.0 from a column of numbers is 7, but 7.2 is a piece of it."""
    names = []
    for value in values.tolist():
        if value is None or value != value or str(value) == "<NA>":
            names.append("")
        elif isinstance(value, float) and value.is_integer():
            names.append(str(int(value)))
        else:
            names.append(str(value).strip())
    filled = [n for n in names if n]
    # Spreadsheets write whole numbers so; a piece 0 of every rock is not meant.
    if filled and all(re.fullmatch(r"\d+\.0", n) for n in filled):
        names = [n.removesuffix(".0") for n in names]
    return names


def _short(raw: _Raw, column: str, texts: list[str], findings: _Findings) -> list[str]:
    """Texts, empty where they are too long or cannot be shown."""
    wrong: dict[int, InputError] = {}
    for i, text in enumerate(texts):
        try:
            check_text(text, raw.file, column)
        except InputError as error:
            wrong[i], texts[i] = error, ""
    if wrong:
        first = next(iter(wrong.values()))
        findings.add(
            "error",
            first.problem,
            raw,
            column,
            raw.rows[list(wrong)],
            found=str(first.found),
            expected=str(first.expected),
            left_out="value",
        )
    return texts


def _numbers(raw: _Raw, column: Column, values: NDArray[Any], findings: _Findings) -> FloatArray:
    """Numbers of a column; NaN where there is none or it cannot be one."""
    texts = np.array([str(v).strip() for v in values.tolist()], dtype=object)
    empty = np.array([t.lower() in _EMPTY for t in texts.tolist()], np.bool_)
    numbers = pd.to_numeric(pd.Series(np.where(empty, "nan", texts)), errors="coerce")
    result: FloatArray = numbers.to_numpy(np.float64, copy=True)
    odd = ~empty & ~np.isfinite(result)
    if odd.any():
        comma = any("," in t for t in texts[odd].tolist())
        findings.add(
            "error",
            "is not a number",
            raw,
            column.name,
            raw.rows[odd],
            found=repr(texts[odd][0]),
            expected="a number, with a point for decimals" if comma else "a number",
            left_out="value",
        )
    with np.errstate(invalid="ignore"):
        wrong = (result < column.low) | (result > column.high)
        if column.positive:
            wrong |= result == 0.0
    if wrong.any():
        low = "above 0" if column.positive else f"{column.low:g} or more"
        limits = low if math.isinf(column.high) else f"{column.low:g} to {column.high:g}"
        findings.add(
            "error",
            "cannot be",
            raw,
            column.name,
            raw.rows[wrong],
            found=f"{result[wrong][0]:g}",
            expected=f"{limits} {column.unit}".strip(),
            left_out="value",
        )
    result[odd | wrong] = np.nan
    return result


def _identified(raw: _Raw, data: Mapping[str, Any], findings: _Findings) -> NDArray[np.bool_]:
    """Rows that say what they are about."""
    keep = np.ones(raw.rows.size, np.bool_)
    # A block or a passage without a name is an unattributed one: its table requires none.
    for column in TABLE_TYPES[raw.name].required:
        if column not in data:
            continue
        values = np.asarray(data[column])
        there = np.isfinite(values) if values.dtype.kind == "f" else values != ""
        lost = keep & ~there
        if lost.any():
            problem = "point has no time" if column == "t_s" else "has no name"
            findings.add("error", problem, raw, column, raw.rows[lost], left_out="row")
        keep &= there
    return keep


def _half_places(raw: _Raw, data: dict[str, Any], findings: _Findings) -> None:
    """An x without its y is no place."""
    nothing = np.full(raw.rows.size, np.nan)
    x, y = np.isfinite(data.get("x", nothing)), np.isfinite(data.get("y", nothing))
    half = x ^ y
    if half.any():
        findings.add("error", "x or y is missing", raw, "x, y", raw.rows[half], left_out="value")
        for c in ("x", "y"):
            data[c] = np.where(half, np.nan, data.get(c, nothing))


# ---------------------------------------------------------------------------------------------
# Places


def _placed(
    raw: _Raw, data: Mapping[str, Any], grid: Grid | None, crs: str | None, findings: _Findings
) -> dict[str, Any]:
    """Coordinates of the features of a layer, in those of the DEM."""
    assert raw.shapes is not None
    lines = raw.name == "stations"
    wanted = ("LineString", "MultiLineString") if lines else ("Point", "MultiPoint")
    shapes = list(raw.shapes)
    there = np.array([s is not None and not s.is_empty for s in shapes], np.bool_)
    fits = np.array(
        [
            ok and s.geom_type in wanted and bool(np.isfinite(shapely.get_coordinates(s)).all())
            for s, ok in zip(shapes, there.tolist(), strict=True)
        ],
        np.bool_,
    )
    if (odd := there & ~fits).any():
        findings.add(
            "error",
            "geometry cannot be used",
            raw,
            rows=raw.rows[odd],
            found=shapes[int(np.flatnonzero(odd)[0])].geom_type,
            expected="a line across the slope" if lines else "a point",
            left_out="row" if lines else "value",
        )
    index = np.flatnonzero(fits)
    flat = [shapely.force_2d(shapes[i]) for i in index.tolist()]
    labels = [f"row {r}" for r in raw.rows[index].tolist()]
    moved = _moved(flat, raw, grid, crs, labels) if flat else []
    n = raw.rows.size
    if lines:
        vertices: list[FloatArray] = [np.empty((0, 2))] * n
        for i, shape in zip(index.tolist(), moved, strict=True):
            merged = shapely.line_merge(shape)
            if merged.geom_type != "LineString":
                findings.add(
                    "error",
                    "station is made of separate parts",
                    raw,
                    rows=[raw.rows[i]],
                    expected="one line without gaps",
                    left_out="row",
                )
                continue
            vertices[i] = shapely.get_coordinates(merged)
        return {"vertices": tuple(vertices)}
    x, y, z = np.full((3, n), np.nan)
    for i, shape in zip(index.tolist(), moved, strict=True):
        x[i], y[i] = shapely.get_coordinates(shape)[0]
        if shapes[i].has_z:
            z[i] = shapely.get_coordinates(shapes[i], include_z=True)[0, 2]
    result = {}
    for name, values in (("x", x), ("y", y), ("z", z)):
        # Columns fill in where a feature has no geometry, or a flat one.
        result[name] = np.where(np.isfinite(values), values, data.get(name, np.nan))
    if raw.crs is not None:
        # Coordinates in columns are in a system that nobody stated, next to shapes that have one.
        for name in ("x", "y"):
            result[name] = np.where(fits, result[name], np.nan)
    return result


def _moved(
    shapes: Sequence[Any], raw: _Raw, grid: Grid | None, crs: str | None, labels: Sequence[str]
) -> list[Any]:
    if grid is not None:
        return onto_grid(shapes, raw.crs, grid, raw.file, _KEY, labels)
    if crs is None or raw.crs is None:
        return list(shapes)
    try:
        transformer = pyproj.Transformer.from_crs(
            pyproj.CRS.from_user_input(raw.crs), parse_crs(crs), always_xy=True
        )
    except CRSError as error:
        raise InputError("unknown coordinate system", file=raw.file, found=str(error)) from None

    def move(points: FloatArray) -> FloatArray:
        return np.column_stack(transformer.transform(points[:, 0], points[:, 1]))

    return [shapely.transform(s, move) for s in shapes]


def _stations(
    raw: _Raw, data: Mapping[str, Any], keep: NDArray[np.bool_], findings: _Findings
) -> Stations:
    n = raw.rows.size
    vertices: list[FloatArray] = list(data.get("vertices", [np.empty((0, 2))] * n))
    ends = [data.get(c, np.full(n, np.nan)) for c in ("x0", "y0", "x1", "y1")]
    for i in range(n):
        if len(vertices[i]) == 0 and all(np.isfinite(e[i]) for e in ends):
            x0, y0, x1, y1 = (float(e[i]) for e in ends)
            vertices[i] = np.array([[x0, y0], [x1, y1]])
        if len(vertices[i]):
            again = np.append(False, (np.diff(vertices[i], axis=0) == 0.0).all(axis=1))
            vertices[i] = vertices[i][~again]
    lineless = keep & np.array([len(v) < 2 for v in vertices], np.bool_)
    if lineless.any():
        findings.add(
            "warning",
            "station has no line: its passages are used by their own x and y",
            raw,
            "x0, y0, x1, y1",
            raw.rows[lineless],
            expected="a line, or x0, y0, x1, y1",
        )
    return Stations.of(row=raw.rows, station=data["station"], vertices=tuple(vertices)).take(keep)


# ---------------------------------------------------------------------------------------------
# Metadata


def _metadata(raw: _Raw, findings: _Findings) -> Metadata:
    columns = {k.strip().lower(): v for k, v in raw.columns.items()}
    if not {"key", "value"} <= set(columns):
        findings.add(
            "error",
            "metadata cannot be read",
            raw,
            found=", ".join(raw.columns) or "nothing",
            expected="columns key and value",
            left_out="table",
        )
        return Metadata()
    known: dict[str, float] = {}
    others: dict[str, str] = {}
    keys = _short(raw, "key", _names(columns["key"]), findings)
    values = ["" if v is None or v != v else str(v).strip() for v in columns["value"].tolist()]
    values = _short(raw, "value", values, findings)
    for row, key, text in zip(raw.rows.tolist(), keys, values, strict=True):
        name = key.lower()
        if name not in METADATA_KEYS:
            others[key] = text
            if key and "nearest" in (hint := nearest(name, tuple(METADATA_KEYS))):
                findings.add(
                    "warning", f"key {key} is only passed on", raw, "key", [row], expected=hint
                )
            continue
        if text.lower() in _EMPTY:
            continue
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        relative = name.endswith("_rel")
        if not (math.isfinite(number) and number >= 0.0) or (relative and number >= 1.0):
            findings.add(
                "error",
                f"{key} cannot be used" + (": looks like percent" if number >= 1.0 else ""),
                raw,
                "value",
                [row],
                found=repr(text),
                expected="a share, such as 0.05" if relative else "a number, 0 or more",
                left_out="value",
            )
            continue
        known[name] = number
    return Metadata(**known, others=others)
