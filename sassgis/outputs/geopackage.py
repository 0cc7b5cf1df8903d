"""Points, lines and areas as layers of one GeoPackage that brings its own styles."""

from __future__ import annotations

import sqlite3
import warnings
from collections.abc import Mapping, Sequence
from contextlib import closing
from importlib import resources
from pathlib import Path
from typing import Any

import geopandas as gpd
import pyogrio
import shapely

from sassgis.errors import OutputError
from sassgis.files.atomic_output import writing
from sassgis.files.gdal_safety import pyogrio_settings
from sassgis.files.vector_layer import KEY_COLUMN, VectorLayer, translated_vector
from sassgis.outputs.qgis.entries import qml
from sassgis.settings.styles import FieldInfo

GEOMETRY_COLUMN = "geom"
METADATA_TABLE = "run_metadata"
#: Stands where GeoPackage wants a time of writing, so that equal input gives equal files; the
#: time of a run is that of its files.
FIXED_TIME = "2000-01-01T00:00:00.000Z"

_SCHEMA_EXTENSION = "http://www.geopackage.org/spec121/#extension_schema"


def write_geopackage(
    path: Path, layers: Sequence[VectorLayer], metadata: Mapping[str, object] | None = None
) -> Path:
    """Write layers, their styles and a table of metadata into a new GeoPackage (version 1.3).

    Each layer has its title as IDENTIFIER, a description, a QGIS style in ``layer_styles`` and its
    columns' aliases, units and descriptions in ``gpkg_data_columns``; the metadata are in
    ``run_metadata``. Equal input gives equal bytes with the same versions of GDAL and SQLite.
    ValueError if a layer holds another kind of geometry than its style draws, or names repeat.
    """
    layers = [translated_vector(layer) for layer in layers]
    names = [layer.name for layer in layers]
    if not names or len(set(names)) != len(names):
        raise ValueError(f"layers need one name each: {names}")
    if path.exists():
        raise OutputError(f"{path}: exists already")
    prepared = [_prepare(layer) for layer in layers]
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        for layer, (frame, geometry_type) in zip(layers, prepared, strict=True):
            add_layer(
                path,
                layer.name,
                frame,
                geometry_type,
                promote_to_multi=geometry_type.startswith("Multi"),
                dataset_options={"VERSION": "1.3"},
                options={"IDENTIFIER": layer.title, "DESCRIPTION": layer.description},
            )
        with closing(sqlite3.connect(path)) as database:
            with database:
                _write_styles(database, layers)
                _write_columns(database, layers)
                _create(database, METADATA_TABLE)
                about = "How this result was computed"
                register_table(database, METADATA_TABLE, "Run metadata", about)
                database.executemany(
                    f"INSERT INTO {METADATA_TABLE} (key, value) VALUES (?, ?)",
                    [(k, None if v is None else str(v)) for k, v in (metadata or {}).items()],
                )
            database.execute("VACUUM")
            _check(database, layers, path)
    return path


_ALLOWED = {
    "marker": {"Point", "MultiPoint"},
    "line": {"LineString", "MultiLineString"},
    "fill": {"Polygon", "MultiPolygon"},
}


def _prepare(layer: VectorLayer) -> tuple[gpd.GeoDataFrame, str]:
    """Return the frame in the one type of geometry that its table will have, and that type."""
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


def add_layer(
    path: Path, name: str, frame: gpd.GeoDataFrame, geometry_type: str, **more: Any
) -> None:
    """Write a layer into a GeoPackage, which is made if missing; ``more`` goes to pyogrio."""
    options = {"GEOMETRY_NAME": GEOMETRY_COLUMN, "FID": KEY_COLUMN, **more.pop("options", {})}
    if frame.crs is None:
        options["SRID"] = "-1"  # Undefined Cartesian; GDAL would take undefined geographic.
    with warnings.catch_warnings(), pyogrio_settings({"OGR_CURRENT_DATE": FIXED_TIME}):
        # Local coordinates are a choice of the user, to whom its meaning was explained.
        warnings.filterwarnings("ignore", message="'crs' was not provided")
        pyogrio.write_dataframe(
            frame,
            path,
            layer=name,
            driver="GPKG",
            geometry_type=geometry_type,
            layer_options=options,
            **more,
        )


def _create(database: sqlite3.Connection, *tables: str) -> None:
    file = resources.files("sassgis") / "data" / "geopackage_tables.sql"
    statements = file.read_text(encoding="utf-8").split(";\n")
    for table in tables:
        (statement,) = (own for own in statements if f" {table} (" in own.replace('"', ""))
        database.execute(statement)


def register_table(database: sqlite3.Connection, table: str, title: str, description: str) -> None:
    """Make a table without geometry a part of the GeoPackage."""
    database.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, last_change, "
        "srs_id) VALUES (?, 'attributes', ?, ?, ?, 0)",
        (table, title, description, FIXED_TIME),
    )


def _write_styles(database: sqlite3.Connection, layers: Sequence[VectorLayer]) -> None:
    _create(database, "layer_styles")
    register_table(database, "layer_styles", "layer_styles", "QGIS styles of the layers")
    # QGIS asks for the empty string as schema: a NULL there would silently lose the style.
    database.executemany(
        "INSERT INTO layer_styles VALUES (NULL, '', '', ?, ?, ?, ?, '', 1, ?, '', NULL, ?)",
        [
            (own.name, GEOMETRY_COLUMN, own.name[:30], qml(own), own.title, FIXED_TIME)
            for own in layers
        ],
    )


def _write_columns(database: sqlite3.Connection, layers: Sequence[VectorLayer]) -> None:
    own = [(layer.name, name, info) for layer in layers for name, info in layer.fields.items()]
    register_columns(
        database, [(table, name, info.label, info.description) for table, name, info in own]
    )
    for table, name, info in own:
        _write_domain(database, table, name, info)


def _write_domain(database: sqlite3.Connection, table: str, column: str, info: FieldInfo) -> None:
    """Write the values allowed in a column as a constraint of the schema extension."""
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
    """Register titles (GDAL: alternative names) and descriptions by the schema extension."""
    tables = ("gpkg_data_columns", "gpkg_data_column_constraints")
    _create(database, *tables, "gpkg_extensions")
    database.executemany(
        "INSERT INTO gpkg_extensions VALUES (?, NULL, 'gpkg_schema', ?, 'read-write')",
        [(table, _SCHEMA_EXTENSION) for table in tables],
    )
    database.executemany(
        "INSERT INTO gpkg_data_columns (table_name, column_name, name, title, description) "
        "VALUES (?1, ?2, ?2, ?3, ?4)",
        columns,
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
