"""One table of field observations: from cells and shapes to numbers and names.

Unusable values are excluded and reported row by row.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from sassgis.errors import InputError, shown
from sassgis.files.plain_file import check_text
from sassgis.gap.observations.observed import LeftOut, Level, ObservationFinding
from sassgis.gap.observations.tables import (
    METADATA_KEYS,
    METADATA_TEXTS,
    POINT_TABLES,
    TABLE_TYPES,
    TABLES,
    Column,
    Metadata,
    Stations,
    Table,
)
from sassgis.gap.verdict.verdict import FEATURES, CauseWeights, Thresholds
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.inputs.vector_features import nearest, onto_grid, text_of, without_repeats
from sassgis.settings.schema import Input

#: Name under which messages speak of the observations.
KEY = "observations"
#: Words that say that a cell is empty, in lower case.
_EMPTY = frozenset({"", "-", "na", "n/a", "nan", "null", "none", "<na>", "?", "-9999", "-9999.0"})
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
class RawTable:
    """A table as it stands in its file: columns of text, numbers or whatever, and its shapes.

    What is found while it is read is added to ``findings``, which all tables share.
    """

    name: str
    file: Input
    rows: IntArray
    columns: Mapping[str, NDArray[Any]]
    findings: list[ObservationFinding]
    shapes: tuple[Any, ...] | None = None
    crs: Any = None

    def note(
        self,
        problem: str,
        column: str = "",
        rows: Sequence[int] | IntArray = (),
        *,
        found: str = "",
        expected: str = "",
        left_out: LeftOut = "",
    ) -> None:
        """Note something about rows: an error where something is left out for it."""
        level: Level = "error" if left_out else "warning"
        where = str(self.file), self.name, shown(column), tuple(int(r) for r in rows)
        detail = shown(found), shown(expected), left_out
        self.findings.append(ObservationFinding(level, shown(problem), *where, *detail))


def table_of(raw: RawTable, grid: Grid | None) -> Table:
    """Return the usable rows of a table, in the coordinates of the DEM."""
    columns = _named_columns(raw)
    n = raw.rows.size
    data: dict[str, Any] = {"row": raw.rows}
    for column in TABLES[raw.name]:
        if column.text:
            values = columns.get(column.name)
            if values is None and column.name in TABLE_TYPES[raw.name].required:
                found = ", ".join(map(str, raw.columns)) or "no columns"
                raise InputError("column is missing", found=found, expected=column.name)
            names = [""] * n if values is None else _names(values)
            data[column.name] = _short(raw, column.name, names)
        elif column.name in columns:
            data[column.name] = _numbers(raw, column, columns[column.name])
    if raw.shapes is not None:
        data |= _placed(raw, data, grid)
    elif raw.name in POINT_TABLES:
        _half_places(raw, data)
    keep = _identified(raw, data)
    if raw.name not in POINT_TABLES:
        return _stations(raw, data, keep)
    table = TABLE_TYPES[raw.name].of(**data).take(keep)
    if table.by_time and len(table):
        # By rock, in the order of their first appearance, then by time.
        rock = pd.factorize(table.rock_id)[0]
        return table.take(np.lexsort((table.numbers[table.by_time], rock)))
    return table


def _named_columns(raw: RawTable) -> dict[str, NDArray[Any]]:
    """Return columns under their names; those that are not known are not read."""
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
        raw.note("column is not known and is not read", given, expected=_meant(name, known))
    return result


def _meant(name: str, known: Sequence[str]) -> str:
    """Return the column that was probably meant, also in another unit."""
    for unit, (right, factor) in _UNITS.items():
        if name.endswith(unit) and (stem := name[: -len(unit)] + right) in known:
            return f"{stem}: the values {factor}"
    with_unit = [k for k in known if re.sub(r"_(mps|hz|m|kg|m3|kgm3|radps|deg|s)$", "", k) == name]
    return f"{with_unit[0]}, with its unit" if with_unit else nearest(name, known)


def _names(values: NDArray[Any]) -> list[str]:
    """Return identifiers as text; 7.0 from a column of numbers is 7, but 7.2 is a fragment."""
    names = [text_of(value) or "" for value in values.tolist()]
    filled = [n for n in names if n]
    # Spreadsheets write whole numbers so; a fragment 0 of every rock is not meant.
    if filled and all(re.fullmatch(r"\d+\.0", n) for n in filled):
        names = [n.removesuffix(".0") for n in names]
    return names


def _short(raw: RawTable, column: str, texts: list[str]) -> list[str]:
    """Return texts, empty where they are too long or cannot be shown."""
    wrong: dict[int, InputError] = {}
    for i, text in enumerate(texts):
        try:
            check_text(text, raw.file, column)
        except InputError as error:
            wrong[i], texts[i] = error, ""
    if wrong:
        first, rows = next(iter(wrong.values())), raw.rows[list(wrong)]
        detail = {"found": str(first.found), "expected": str(first.expected)}
        raw.note(first.problem, column, rows, left_out="value", **detail)
    return texts


def _numbers(raw: RawTable, column: Column, values: NDArray[Any]) -> FloatArray:
    """Return numbers of a column; NaN where there is none or it cannot be one."""
    texts = np.array([str(v).strip() for v in values.tolist()], dtype=object)
    empty = np.array([t.lower() in _EMPTY for t in texts.tolist()], np.bool_)
    numbers = pd.to_numeric(pd.Series(np.where(empty, "nan", texts)), errors="coerce")
    result: FloatArray = numbers.to_numpy(np.float64, copy=True)
    lost = partial(raw.note, column=column.name, left_out="value")
    odd = ~empty & ~np.isfinite(result)
    if odd.any():
        comma = any("," in t for t in texts[odd].tolist())
        expected = "a number, with a point for decimals" if comma else "a number"
        found = repr(texts[odd][0])
        lost("is not a number", rows=raw.rows[odd], found=found, expected=expected)
    with np.errstate(invalid="ignore"):
        wrong = (result < column.low) | (result > column.high)
        if column.positive:
            wrong |= result == 0.0
    if wrong.any():
        low = "above 0" if column.positive else f"{column.low:g} or more"
        limits = low if math.isinf(column.high) else f"{column.low:g} to {column.high:g}"
        expected, found = f"{limits} {column.unit}".strip(), f"{result[wrong][0]:g}"
        lost("cannot be", rows=raw.rows[wrong], found=found, expected=expected)
    result[odd | wrong] = np.nan
    return result


def _identified(raw: RawTable, data: Mapping[str, Any]) -> NDArray[np.bool_]:
    """Return rows that say what they are about."""
    keep = np.ones(raw.rows.size, np.bool_)
    # A block or a passage without a name is an unattributed one: its table requires none.
    for column in TABLE_TYPES[raw.name].required:
        if column not in data:
            continue
        values = np.asarray(data[column])
        there = np.isfinite(values) if values.dtype.kind == "f" else values != ""
        lost = keep & ~there
        if lost.any():
            timeless = column == TABLE_TYPES[raw.name].by_time
            problem = "point has no time" if timeless else "has no name"
            raw.note(problem, column, raw.rows[lost], left_out="row")
        keep &= there
    return keep


def _half_places(raw: RawTable, data: dict[str, Any]) -> None:
    """Drop places of which one coordinate is missing."""
    nothing = np.full(raw.rows.size, np.nan)
    there = [np.isfinite(data.get(c, nothing)) for c in ("x", "y")]
    half = there[0] ^ there[1]
    if not half.any():
        return
    # Values that are not numbers were reported before.
    said = [f.rows for f in raw.findings if f.table == raw.name and f.column in ("x", "y")]
    missing = half & ~np.isin(raw.rows, np.concatenate([*said, np.empty(0, np.int64)]))
    if missing.any():
        raw.note("x or y is missing", "x, y", raw.rows[missing], left_out="value")
    for c in ("x", "y"):
        data[c] = np.where(half, np.nan, data.get(c, nothing))


def _placed(raw: RawTable, data: Mapping[str, Any], grid: Grid | None) -> dict[str, Any]:
    """Return coordinates of the features of a layer, in those of the DEM."""
    assert raw.shapes is not None
    lines = raw.name not in POINT_TABLES
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
        raw.note(
            "geometry cannot be used",
            rows=raw.rows[odd],
            found=shapes[int(np.flatnonzero(odd)[0])].geom_type,
            expected="a line across the slope" if lines else "a point",
            left_out="row" if lines else "value",
        )
    index = np.flatnonzero(fits)
    flat = [shapely.force_2d(shapes[i]) for i in index.tolist()]
    labels = [f"row {r}" for r in raw.rows[index].tolist()]
    # Without a DEM they stay in their coordinates.
    moved = flat
    if grid is not None and flat:
        moved = onto_grid(flat, raw.crs, grid, raw.file, KEY, labels)
    n = raw.rows.size
    if lines:
        vertices: list[FloatArray] = [np.empty((0, 2))] * n
        for i, shape in zip(index.tolist(), moved, strict=True):
            merged = shapely.line_merge(shape)
            if merged.geom_type == "LineString":
                vertices[i] = shapely.get_coordinates(merged)
                continue
            problem, expected = "station is made of separate parts", "one line without gaps"
            raw.note(problem, rows=[raw.rows[i]], expected=expected, left_out="row")
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


def _stations(raw: RawTable, data: Mapping[str, Any], keep: NDArray[np.bool_]) -> Stations:
    n = raw.rows.size
    vertices: list[FloatArray] = list(data.get("vertices", [np.empty((0, 2))] * n))
    ends = np.array([data.get(c, np.full(n, np.nan)) for c in ("x0", "y0", "x1", "y1")])
    for i, (x0, y0, x1, y1) in enumerate(ends.T):
        if len(vertices[i]) == 0 and np.isfinite(ends[:, i]).all():
            vertices[i] = np.array([[x0, y0], [x1, y1]])
        vertices[i] = without_repeats(vertices[i])
    lineless = keep & np.array([len(v) < 2 for v in vertices], np.bool_)
    if lineless.any():
        problem = "station has no line: its passages are used by their own x and y"
        place = "x0, y0, x1, y1"
        raw.note(problem, place, raw.rows[lineless], expected=f"a line, or {place}")
    return Stations.of(row=raw.rows, station=data["station"], vertices=tuple(vertices)).take(keep)


def metadata_of(raw: RawTable) -> Metadata:
    """Read how well was measured; keys that are not known are passed on."""
    columns = {k.strip().lower(): v for k, v in raw.columns.items()}
    if not {"key", "value"} <= set(columns):
        found, expected = ", ".join(raw.columns) or "nothing", "columns key and value"
        raw.note("metadata cannot be read", found=found, expected=expected, left_out="table")
        return Metadata()
    lost = partial(raw.note, left_out="value")
    known: dict[str, float] = {}
    others: dict[str, str] = {}
    keys = _short(raw, "key", _names(columns["key"]))
    values = ["" if v is None or v != v else str(v).strip() for v in columns["value"].tolist()]
    values = _short(raw, "value", values)
    for row, key, text in zip(raw.rows.tolist(), keys, values, strict=True):
        name = key.lower()
        if name not in METADATA_KEYS:
            others[key] = text
            if not key or name in METADATA_TEXTS:
                continue
            if "nearest" in (hint := nearest(name, tuple(METADATA_KEYS))):
                raw.note(f"key {key} is only passed on", "key", [row], expected=hint)
            continue
        if text.lower() in _EMPTY:
            continue
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        relative = name.endswith(("_rel", "_share"))
        if not (math.isfinite(number) and number >= 0.0) or (relative and number >= 1.0):
            problem = f"{key} cannot be used" + (": looks like percent" if number >= 1.0 else "")
            expected = "a share, such as 0.05" if relative else "a number, 0 or more"
            lost(problem, "value", [row], found=repr(text), expected=expected)
            continue
        known[name] = number
    return Metadata(**known, others=others)


#: Chosen on batteries of development, and frozen for all that is reported.
THRESHOLDS = Path(str(files("sassgis").joinpath("data/gap_thresholds.json")))


def read_thresholds() -> dict[str, Any]:
    """Return the frozen thresholds and weights of the diagnosis.

    Its list ``battery_seeds`` names the batteries that were looked at while they were chosen.
    """
    return dict(json.loads(THRESHOLDS.read_text(encoding="utf-8")))


def thresholds_of(content: dict[str, Any]) -> Thresholds:
    """Return thresholds in the content of their file; others keep their defaults."""
    names = {field.name for field in fields(Thresholds)}
    return Thresholds(**{k: v for k, v in content.items() if k in names})


def cause_weights_of(content: dict[str, Any]) -> CauseWeights:
    """Return the weights of the fingerprints in the content of their file."""
    own = content["weights"]
    return CauseWeights(
        np.array([float(own[name]) for name in FEATURES]),
        *(float(own[field.name]) for field in fields(CauseWeights)[1:]),
    )
