"""Files of a new site, samples, and empty tables of observations."""

from __future__ import annotations

import os
import shutil
import sqlite3
import textwrap
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import pandas as pd
import pyproj

import sassgis
from sassgis.errors import InputError, OutputError
from sassgis.files.atomic_output import staged_file, staged_output, writing
from sassgis.files.plain_file import seen_from
from sassgis.files.vector_layer import described_layer
from sassgis.gap.observations.tables import (
    METADATA_KEYS,
    METADATA_TEXTS,
    POINT_TABLES,
    TABLES,
    Column,
)
from sassgis.inputs.rockyfor3d import rasters_of, read_rockyfor3d
from sassgis.inputs.site_layers import outline_of, project_keys, site_layers, with_values
from sassgis.inputs.tiles import open_terrain
from sassgis.outputs.config_template import short_template
from sassgis.outputs.frames import write_table
from sassgis.outputs.geopackage import add_layer, register_columns, register_table, write_geopackage
from sassgis.outputs.layers.maps import terrain_layer
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup
from sassgis.outputs.qgis.project import write_project
from sassgis.settings.crs import crs_parts, parse_crs

_GROUPS = (
    ("Stations and measures", ("stations", "barriers")),
    (
        "Edits",
        (
            "edits",
            "assessed_area",
        ),
    ),
    ("Exposed objects", ("buildings", "people", "roads", "lines")),
    ("Release", ("release_areas",)),
    ("Forest", ("forest",)),
    ("Ground", ("ground",)),
)


def site_template(
    path: Path,
    *,
    crs: str | None = None,
    override_crs: bool = False,
    dem: Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Write an empty GeoPackage of a site and, next to it, a QGIS project to draw in; returns that.

    The path ends in ``.gpkg``; the project has the same name with ``.qgz``. ``crs`` is a projected
    system in metres, such as "EPSG:2056", by default that of the terrain model, in place of which
    it counts with ``override_crs``. The terrain model lies under the drawing; a folder of tiles
    gives system and extent only, as QGIS opens single files.
    """
    if path.suffix.lower() != ".gpkg":
        raise InputError("cannot be written", file=path, expected="a name ending in .gpkg")
    project = path.with_suffix(".qgz")
    ground: tuple[LayerEntry, ...] = ()
    if dem is None:
        if crs is None:
            expected = 'a code such as "EPSG:2056", or --dem'
            raise InputError("no coordinate system is given", field="--crs", expected=expected)
        system = _plane(crs)
        extent = _area_of_use(system)
        wkt = system.to_wkt()
    else:
        frame = open_terrain(dem, crs, None, override_crs).outline()
        wkt, extent = frame.crs, frame.bounds
        if dem.is_file():
            place = seen_from(path.resolve().parent, dem.resolve())
            relief = replace(terrain_layer(frame), note=f"Terrain model {dem.name}.")
            ground = (LayerEntry(relief, place),)
    layers = {}
    for own in site_layers():
        columns = {
            name: pd.Series(dtype="str" if info.low is None else "float64")
            for name, info in own.fields.items()
        }
        layers[own.name] = described_layer(
            f"{own.name}.site", columns, [], wkt, own.style, fields=own.fields
        )
    groups = [
        *(
            LayerGroup(title, tuple(LayerEntry(layers[n], path.name) for n in names))
            for title, names in _GROUPS
        ),
        *([LayerGroup("Terrain", ground)] if ground else []),
    ]
    with staged_file(project, overwrite) as drawing, staged_file(path, overwrite) as data:
        write_geopackage(data, list(layers.values()))
        write_project(
            drawing,
            title=path.stem,
            crs=wkt,
            groups=groups,
            extent=extent,
            abstract="Site to be drawn for a rockfall simulation with sassgis.",
        )
    return project


def _plane(text: str) -> pyproj.CRS:
    """Return the plane part of a projected system in metres."""
    system = crs_parts(parse_crs(text, field="--crs"))[0]
    if not system.is_projected or system.axis_info[0].unit_name not in ("metre", "meter"):
        problem, found = "is not a projected system in metres", str(system.name)
        expected = 'a projected system such as "EPSG:2056"'
        raise InputError(problem, field="--crs", found=found, expected=expected)
    return system


def _area_of_use(system: pyproj.CRS) -> tuple[float, float, float, float]:
    """Return the area of use of the system, in its coordinates."""
    area = system.area_of_use
    if area is None:
        return (0.0, 0.0, 1000.0, 1000.0)
    west, south, east, north = pyproj.Transformer.from_crs(
        "EPSG:4326", system, always_xy=True
    ).transform_bounds(area.west, area.south, area.east, area.north)
    return west, south, east, north


def write_rockyfor3d_site(
    file: Path, folder: Path, assignments: Sequence[str] = (), overwrite: bool = False
) -> tuple[list[Path], list[str]]:
    """Write a configuration from a folder of Rockyfor3D, and next to it what it is made into.

    Assignments are keys that the user sets, as ``terrain.crs=EPSG:2056``. Returns the files, and
    what their user must know of them.
    """
    terrain = dict(with_values([("terrain", {})], assignments))["terrain"]
    dem = rasters_of(folder).get("dem", folder / "dem.asc")
    made = read_rockyfor3d(folder, file.parent, outline_of(dem, terrain).crs or None)
    comments = "".join(
        textwrap.fill(note, 100, initial_indent="# - ", subsequent_indent="#   ") + "\n"
        for note in made.notes
    )
    text = f"# From {folder.name}, inputs of Rockyfor3D.\n{comments}\n"
    text += short_template(with_values([*project_keys(file), *made.keys], assignments))
    files = [file]
    with ExitStack() as staged:
        for name, layer in made.layers.items():
            files.append(file.parent / f"{name}.gpkg")
            work = staged.enter_context(staged_file(files[-1], overwrite))
            layer.to_file(work, driver="GPKG", layer=name)
        for name, table in made.tables.items():
            files.append(file.parent / f"{name}.csv")
            write_table(staged.enter_context(staged_file(files[-1], overwrite)), [table])
        staged.enter_context(staged_file(file, overwrite)).write_text(text, encoding="utf-8")
    return files, made.notes


def sample_folder() -> Path:
    """Return the folder of the samples, of the package or the source tree; InputError if none."""
    package = Path(sassgis.__file__).resolve().parent
    for folder in (package / "data" / "sample_dem", package.parent / "sample_dem"):
        if (folder / "valley" / "config.toml").is_file():
            return folder
    raise InputError("the sample terrain is missing from this installation", file=package)


def write_samples(folder: Path) -> None:
    """Write the samples, with their configurations, into a new folder; it appears whole or not."""
    if os.path.lexists(folder):
        raise OutputError(f"{folder}: exists already; choose a new folder")
    with staged_output(folder, overwrite=False) as work:
        shutil.copytree(
            sample_folder(),
            work,
            ignore=shutil.ignore_patterns("__pycache__", "*.py"),
            copy_function=shutil.copyfile,
            dirs_exist_ok=True,
        )


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
    InputError
        If the path is neither; if the system is not understood.
    OutputError
        If it exists already or cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() == ".gpkg":
        return _gpkg_template(path, crs)
    if path.suffix:
        raise InputError("cannot be written", file=path, expected="a folder or a .gpkg file")
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
    system = None if crs is None else parse_crs(crs, field="--crs")
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
