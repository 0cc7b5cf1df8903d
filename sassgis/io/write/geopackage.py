"""Points, lines and areas as layers of one GeoPackage that brings its own styles."""

from __future__ import annotations

import sqlite3
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import geopandas as gpd
import pyogrio
import shapely

from sassgis.io.qgis.markup import qml
from sassgis.io.qgis.vector_style import vector_style_elements
from sassgis.io.said_layers import said_vector
from sassgis.io.staging import writing
from sassgis.io.vector_layer import KEY_COLUMN, VectorLayer
from sassgis.model.errors import OutputError
from sassgis.model.styles import FieldInfo

GEOMETRY_COLUMN = "geom"
METADATA_TABLE = "run_metadata"
#: Stands where GeoPackage wants a time of writing, so that equal input gives equal files; the
#: time of a run is that of its files.
FIXED_TIME = "2000-01-01T00:00:00.000Z"

_SCHEMA_EXTENSION = "http://www.geopackage.org/spec121/#extension_schema"


def layer_qml(layer: VectorLayer) -> str:
    """The style as text, as the table ``layer_styles`` keeps it."""
    return qml(
        vector_style_elements(layer.style, layer.columns, layer.fields),
        labels=bool(layer.style.label_column),
    )


def write_geopackage(
    path: Path, layers: Sequence[VectorLayer], metadata: Mapping[str, object] | None = None
) -> Path:
    """Write layers, their styles and a table of metadata into a new GeoPackage (version 1.3).

    Each layer has its title as IDENTIFIER, a description, a QGIS style in ``layer_styles`` and its
    columns' aliases, units and descriptions in ``gpkg_data_columns``. Equal input gives equal
    bytes with the same versions of GDAL and SQLite.

    Parameters
    ----------
    path : Path
        Must not exist.
    layers : sequence of VectorLayer
        At least one.
    metadata : mapping, optional
        Rows of the table ``run_metadata`` (key, value).

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        If the file exists or the disk is full or not writable.
    ValueError
        If a layer holds another kind of geometry than its style draws, or names repeat.
    """
    layers = [said_vector(layer) for layer in layers]
    names = [layer.name for layer in layers]
    if not names or len(set(names)) != len(names):
        raise ValueError(f"layers need one name each: {names}")
    if path.exists():
        raise OutputError(f"{path}: exists already")
    prepared = [_prepare(layer) for layer in layers]
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with _gdal_time(FIXED_TIME):
            for layer, (frame, geometry_type) in zip(layers, prepared, strict=True):
                _write_layer(path, layer, frame, geometry_type)
        with closing(sqlite3.connect(path)) as database:
            with database:
                _write_styles(database, layers)
                _write_columns(database, layers)
                _write_metadata(database, metadata or {})
            database.execute("VACUUM")
            _check(database, layers, path)
    return path


# --- geometry --------------------------------------------------------------------------------

_ALLOWED = {
    "marker": {"Point", "MultiPoint"},
    "line": {"LineString", "MultiLineString"},
    "fill": {"Polygon", "MultiPolygon"},
}


def _prepare(layer: VectorLayer) -> tuple[gpd.GeoDataFrame, str]:
    """The frame in the one type of geometry that its table will have, and that type."""
    frame = layer.frame.rename_geometry(GEOMETRY_COLUMN)
    geometry = frame.geometry
    found = set(geometry.geom_type.dropna().unique())
    if strange := found - _ALLOWED[layer.style.symbol.kind]:
        raise ValueError(f"layer {layer.name}: cannot draw {', '.join(sorted(strange))}")
    if bool(geometry.has_z.any()) and not bool(geometry.has_z.all()):
        geometry = gpd.GeoSeries(
            shapely.force_3d(geometry.to_numpy()), index=frame.index, crs=frame.crs
        )
    single, multi = sorted(_ALLOWED[layer.style.symbol.kind], key=len)
    # Areas are always multi: cut or merged ones may come in parts in one run and not in the next.
    kind = multi if multi in found or single == "Polygon" else single
    frame = frame.set_geometry(geometry)
    return frame, kind + (" Z" if bool(geometry.has_z.any()) else "")


def _write_layer(
    path: Path, layer: VectorLayer, frame: gpd.GeoDataFrame, geometry_type: str
) -> None:
    options: dict[str, Any] = {
        "IDENTIFIER": layer.title,
        "DESCRIPTION": layer.description,
        "GEOMETRY_NAME": GEOMETRY_COLUMN,
        "FID": KEY_COLUMN,
        "SPATIAL_INDEX": "YES",
    }
    if frame.crs is None:
        options["SRID"] = "-1"  # Undefined Cartesian; GDAL would take undefined geographic.
    with warnings.catch_warnings():
        # Local coordinates are a choice of the user, to whom its meaning was explained.
        warnings.filterwarnings("ignore", message="'crs' was not provided")
        pyogrio.write_dataframe(
            frame,
            path,
            layer=layer.name,
            driver="GPKG",
            geometry_type=geometry_type,
            promote_to_multi=geometry_type.startswith("Multi"),
            dataset_options={"VERSION": "1.3"},
            layer_options=options,
        )


@contextmanager
def _gdal_time(stamp: str) -> Iterator[None]:
    before = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": stamp})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})


# --- tables ----------------------------------------------------------------------------------


def register_table(database: sqlite3.Connection, table: str, title: str, description: str) -> None:
    """Make a table without geometry a part of the GeoPackage."""
    database.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, last_change, "
        "srs_id) VALUES (?, 'attributes', ?, ?, ?, 0)",
        (table, title, description, FIXED_TIME),
    )


def _write_styles(database: sqlite3.Connection, layers: Sequence[VectorLayer]) -> None:
    database.execute(
        'CREATE TABLE "layer_styles" ("id" INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, '
        '"f_table_catalog" TEXT(256), "f_table_schema" TEXT(256), "f_table_name" TEXT(256), '
        '"f_geometry_column" TEXT(256), "styleName" TEXT(30), "styleQML" TEXT, "styleSLD" TEXT, '
        '"useAsDefault" BOOLEAN, "description" TEXT, "owner" TEXT(30), "ui" TEXT(30), '
        "\"update_time\" DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')))"
    )
    register_table(database, "layer_styles", "layer_styles", "QGIS styles of the layers")
    # QGIS asks for the empty string as schema: a NULL there would silently lose the style.
    database.executemany(
        'INSERT INTO "layer_styles" ("f_table_catalog", "f_table_schema", "f_table_name", '
        '"f_geometry_column", "styleName", "styleQML", "styleSLD", "useAsDefault", "description", '
        "\"owner\", \"ui\", \"update_time\") VALUES ('', '', ?, ?, ?, ?, '', 1, ?, '', NULL, ?)",
        [
            (
                layer.name,
                GEOMETRY_COLUMN,
                layer.name[:30],
                layer_qml(layer),
                layer.title,
                FIXED_TIME,
            )
            for layer in layers
        ],
    )


def _write_columns(database: sqlite3.Connection, layers: Sequence[VectorLayer]) -> None:
    register_columns(
        database,
        [
            (layer.name, column, info.label, info.description)
            for layer in layers
            for column, info in layer.fields.items()
        ],
    )
    for layer in layers:
        for column, info in layer.fields.items():
            _write_domain(database, layer.name, column, info)


def _write_domain(database: sqlite3.Connection, table: str, column: str, info: FieldInfo) -> None:
    """What may stand in a column, as a constraint of the schema extension (GDAL: field domain)."""
    name = f"{table}_{column}".lower()
    rows: list[tuple[str | float | None, ...]] = []
    if info.choices:
        rows = [(name, "enum", c, None, None, None, None, None) for c in info.choices]
    elif info.low is not None or info.high is not None:
        ends = [(None, None) if end is None else (end, 1) for end in (info.low, info.high)]
        rows = [(name, "range", None, *ends[0], *ends[1], info.description)]
    if rows:
        database.executemany(
            "INSERT INTO gpkg_data_column_constraints VALUES (?, ?, ?, ?, ?, ?, ?, ?)", rows
        )
        database.execute(
            "UPDATE gpkg_data_columns SET constraint_name = ? "
            "WHERE table_name = ? AND column_name = ?",
            (name, table, column),
        )


def register_columns(
    database: sqlite3.Connection, columns: Sequence[tuple[str, str, str, str]]
) -> None:
    """Aliases with units, by the GeoPackage schema extension (GDAL's alternative names).

    Parameters
    ----------
    database
    columns
        Table, column, title and description of each.
    """
    database.execute(
        "CREATE TABLE IF NOT EXISTS gpkg_data_columns (table_name TEXT NOT NULL, column_name TEXT "
        "NOT NULL, name TEXT, title TEXT, description TEXT, mime_type TEXT, constraint_name TEXT, "
        "CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name), "
        "CONSTRAINT gdc_tn UNIQUE (table_name, name))"
    )
    database.execute(
        "CREATE TABLE IF NOT EXISTS gpkg_data_column_constraints (constraint_name TEXT NOT NULL, "
        "constraint_type TEXT NOT NULL, value TEXT, min NUMERIC, min_is_inclusive BOOLEAN, "
        "max NUMERIC, max_is_inclusive BOOLEAN, description TEXT, "
        "CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value))"
    )
    database.execute(
        "CREATE TABLE IF NOT EXISTS gpkg_extensions (table_name TEXT, column_name TEXT, "
        "extension_name TEXT NOT NULL, definition TEXT NOT NULL, scope TEXT NOT NULL, "
        "CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name))"
    )
    database.executemany(
        "INSERT INTO gpkg_extensions VALUES (?, NULL, 'gpkg_schema', ?, 'read-write')",
        [
            ("gpkg_data_columns", _SCHEMA_EXTENSION),
            ("gpkg_data_column_constraints", _SCHEMA_EXTENSION),
        ],
    )
    database.executemany(
        "INSERT INTO gpkg_data_columns (table_name, column_name, name, title, description) "
        "VALUES (?, ?, ?, ?, ?)",
        [
            (table, column, column, title, description)
            for table, column, title, description in columns
        ],
    )


def _write_metadata(database: sqlite3.Connection, metadata: Mapping[str, object]) -> None:
    database.execute(
        f'CREATE TABLE "{METADATA_TABLE}" ("id" INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, '
        '"key" TEXT NOT NULL UNIQUE, "value" TEXT)'
    )
    register_table(database, METADATA_TABLE, "Run metadata", "How this result was computed")
    database.executemany(
        f'INSERT INTO "{METADATA_TABLE}" ("key", "value") VALUES (?, ?)',
        [(key, None if value is None else str(value)) for key, value in metadata.items()],
    )


def _check(database: sqlite3.Connection, layers: Sequence[VectorLayer], path: Path) -> None:
    """Make sure that what was handed to GDAL is in the file."""
    (verdict,) = database.execute("PRAGMA integrity_check").fetchone()
    if verdict != "ok":
        raise OutputError(f"{path}: cannot be written: {verdict}")
    for layer in layers:
        (count,) = database.execute(f'SELECT count(*) FROM "{layer.name}"').fetchone()
        if count != len(layer.frame):
            raise OutputError(
                f"{path}: layer {layer.name}: {count} of {len(layer.frame)} features were written"
            )
