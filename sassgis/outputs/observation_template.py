"""Empty tables of field observations, to be filled in."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import geopandas as gpd
import pandas as pd

from sassgis.errors import OutputError
from sassgis.files.atomic_output import writing
from sassgis.gap.observations.tables import (
    METADATA_KEYS,
    METADATA_TEXTS,
    POINT_TABLES,
    TABLES,
    Column,
)
from sassgis.outputs.geopackage import add_layer, register_columns, register_table
from sassgis.settings.crs import parse_crs

_METADATA = "metadata"
_README = "README.txt"
_KEYS = {**METADATA_KEYS, **METADATA_TEXTS}
#: Columns that the geometry of a layer takes the place of.
_PLACES = frozenset({"x", "y", "x0", "y0", "x1", "y1"})


def observations_template(path: Path | str, *, crs: str | None = None) -> Path:
    """Write empty tables with all columns, to be filled in.

    The path is a new file with the suffix ``.gpkg``, where units stand in the descriptions of the
    columns, or a folder for CSV files (new or empty), which also gets a README.txt with them.
    ``crs`` is the system of the GeoPackage, such as "EPSG:2056"; best that of the DEM.

    Raises
    ------
    OutputError
        If it exists already or cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() == ".gpkg":
        return _gpkg_template(path, crs)
    if path.suffix:
        raise OutputError(f"{path}: cannot see what to write; expected a folder or a .gpkg file")
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise OutputError(f"{path}: exists already and is not empty")
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        for table, columns in TABLES.items():
            header = ",".join(c.name for c in columns)
            (path / f"{table}.csv").write_text(header + "\n", encoding="utf-8")
        keys = "".join(f"{key},\n" for key in _KEYS)
        (path / f"{_METADATA}.csv").write_text(f"key,value\n{keys}", encoding="utf-8")
        (path / _README).write_text(_guide(), encoding="utf-8")
    return path


def _guide() -> str:
    lines = [
        "Tables of field observations. Fill in what was measured and leave the rest empty;",
        "whole tables and columns may be deleted. One row for each rock, station, passage, ...",
        "x, y and z are in the coordinates and heights of the DEM. Points for decimals.",
        "A rock_id with a suffix after a point (R7.2) is a piece of R7. A deposit or passage of",
        "unknown origin has an empty rock_id; the check then tells how many there are.",
    ]
    for table, columns in TABLES.items():
        lines += ["", table, *_rows(columns)]
    lines += ["", f"{_METADATA} (key, value)"]
    lines += _rows(_KEYS.values())
    return "\n".join(lines) + "\n"


def _rows(columns: Iterable[Column]) -> list[str]:
    return [f"  {c.name:<18} {c.unit or '-':<6} {c.meaning}" for c in columns]


def _gpkg_template(path: Path, crs: str | None) -> Path:
    if path.exists():
        raise OutputError(f"{path}: exists already")
    system = None if crs is None else parse_crs(crs)
    described: list[tuple[str, str, str, str]] = []
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        for table, columns in TABLES.items():
            # Geometry holds the place; z stays for those who digitise in the plane.
            own = [c for c in columns if c.name not in _PLACES]
            data = {c.name: pd.Series(dtype="str" if c.text else "float64") for c in own}
            frame = gpd.GeoDataFrame(data, geometry=gpd.GeoSeries([], crs=system), crs=system)
            add_layer(path, table, frame, "Point Z" if table in POINT_TABLES else "LineString")
            described += [
                (table, c.name, f"{c.name} [{c.unit}]" if c.unit else c.name, c.meaning)
                for c in own
            ]
        with closing(sqlite3.connect(path)) as database, database:
            database.execute(
                f'CREATE TABLE "{_METADATA}" (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, '
                '"key" TEXT, "value" TEXT)'
            )
            keys = [(key,) for key in _KEYS]
            database.executemany(f'INSERT INTO "{_METADATA}" ("key") VALUES (?)', keys)
            register_table(database, _METADATA, "metadata", "How well was measured")
            register_columns(database, described)
    return path
