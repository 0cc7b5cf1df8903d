"""Templates: files of a new site, configurations, empty tables of observations."""

from __future__ import annotations

import json
import os
import re
import shutil
import sqlite3
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import geopandas as gpd
import pandas as pd
import pyproj
import tomli_w

import sassgis
from sassgis.engine.effects.registry import EFFECTS
from sassgis.errors import InputError, OutputError
from sassgis.files.atomic_output import staged_file, staged_output, write_new, writing
from sassgis.files.plain_file import seen_from
from sassgis.files.vector_layer import described_layer
from sassgis.gap.observations.tables import (
    METADATA_KEYS,
    METADATA_TEXTS,
    POINT_TABLES,
    TABLES,
    Column,
)
from sassgis.inputs.config import FILE_KEYS, LISTS, SECTIONS, declared_sections, first_line
from sassgis.inputs.rockyfor3d import rasters_of, read_rockyfor3d
from sassgis.inputs.site_layers import outline_of, site_layers, with_values
from sassgis.inputs.tiles import open_terrain
from sassgis.outputs.geopackage import add_layer, register_columns, register_table, write_geopackage
from sassgis.outputs.layers.maps import terrain_layer
from sassgis.outputs.manifest import plain
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup
from sassgis.outputs.qgis.run_project import write_project
from sassgis.outputs.zone_tables import write_table
from sassgis.settings.map_run import Config
from sassgis.settings.process import crs_parts, parse_crs
from sassgis.settings.schema import Declared, InMemory, is_preset_file

_HEAD = """\
# Configuration of a sassgis run.
#
# Paths are relative to this file. Units are part of the names: m, m/s (mps), rad/s (radps), kg/m3
# (kgm3), kJ (kj), degrees (deg). Where a range [low, high] is asked for, a single number will do.
# A line that starts with "# key =" shows an optional key: with its default, or with an example if
# it has none. Unknown keys are errors, so that a misspelt one cannot go unnoticed.
"""
_SHORT_HEAD = """\
# Configuration of a sassgis run: the lines that every site must decide. All keys with their meaning
# and default: `sassgis init --all`, or docs/configuration.md. Paths are relative to this file.
# The block is an example. Lines that start with "# key =" are needed for zones and have no default.
"""
#: What every site must decide, and the value that stands there if no file says it. None: that of
#: the template. What has no sensible value for all sites stands as a comment.
_SHORT: Mapping[str, Mapping[str, object]] = {
    "terrain": {"dem": None},
    "release": {"file": None, "spacing_m": None, "rocks_per_point": 20},
    "ground": {"default": None},
    "blocks": {"name": None, "volume_m3": (0.5, 2.0), "onset_frequency": None},
    "hazard": {"preset": None, "ref_width_m": None, "blocks": "auto"},
}
#: What a new configuration has in place of the default.
_IN_PLACE = {("release", "rocks_per_point"), ("hazard", "blocks")}
#: Column of the meanings, where a line is not longer.
_WIDTH = 32
_HIDDEN = ("onset_frequency", "ref_width_m")
#: Sections that are left out of a run unless they are asked for.
_OPTIONAL = ("stations", "barriers", "profile", "objects")
#: Sections whose defaults are seldom changed, and stand as comments.
_QUIET = ("engine", "blocks")


#: Keys with their values, by section; a section with double brackets may come several times.
Given = Iterable[tuple[str, Mapping[str, object]]]


def short_template(given: Given = ()) -> str:
    """Return the few lines that every site must decide, and the sections ``given``."""
    keys = declared_sections()
    sections: list[tuple[str, dict[str, str]]] = []
    for name, short in _SHORT.items():
        plain = {k: _value(keys[name][k]) if v is None else v for k, v in short.items()}
        for own in [dict(values) for section, values in given if section == name] or [{}]:
            hidden = {k for k in _HIDDEN if k not in own}
            lines = {
                f"{'# ' if k in hidden else ''}{k}": toml_value(v) for k, v in (plain | own).items()
            }
            sections.append((name, lines))
    for name, values in given:
        if name not in _SHORT:
            sections.append((name, {k: toml_value(v) for k, v in values.items()}))
    parts = [_SHORT_HEAD]
    lengths = [len(f"{key} = {text}") for _, lines in sections for key, text in lines.items()]
    width = min(max(lengths), _WIDTH)
    for name, lines in sections:
        rows = [_bracketed(name)]
        for key, text in lines.items():
            meaning = re.split(r"[;:] ", keys[name][key.removeprefix("# ")].description)[0]
            rows.append(f"{f'{key} = {text}':<{width}}  # {meaning}")
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts)


def _bracketed(section: str) -> str:
    return f"[[{section}]]" if section in LISTS else f"[{section}]"


def config_template(given: Given = ()) -> str:
    """Return a commented configuration with every key; what is ``given`` replaces examples."""
    known = {name: dict(values) for name, values in given}
    parts = [_HEAD]
    for name, keys in declared_sections().items():
        own_values = known.get(name, {})
        optional = name not in known and (name in _OPTIONAL or "." in name)
        head = f"{'# ' if optional else ''}{_bracketed(name)}"
        lines = [*_wrapped(_summary(name), "# "), head]
        for own in keys.values():
            quiet = optional or name in _QUIET or name in _OPTIONAL or "." in name
            in_place = (name, own.name) in _IN_PLACE
            shown = (
                own.name in own_values
                or in_place
                or (_is_shown(own, quiet=quiet) and not (name in known and name in _OPTIONAL))
            )
            value = own_values.get(own.name, _SHORT[name][own.name] if in_place else _value(own))
            lines.append(f"{'' if shown else '# '}{own.name} = {toml_value(value)}")
            lines += _wrapped(_text(own), "#     ")
        parts.append("\n".join(lines) + "\n")
    # A second layer of a kind, as roads next to buildings.
    more = [(n, v) for n, v in given if v != known.get(n)]
    for name, values in more:
        rows = [f"{key} = {toml_value(value)}" for key, value in values.items()]
        parts.append("\n".join([_bracketed(name), *rows]) + "\n")
    return "\n".join(parts)


def _summary(section: str) -> str:
    """Return the summary of a section: the first line of the docstring of its type."""
    if "." in section:
        return first_line(EFFECTS[section.split(".")[1]].settings)
    return first_line(SECTIONS[section])


def _is_shown(own: Declared, *, quiet: bool) -> bool:
    """Return whether a key stands in the template as a setting, and not as a comment."""
    if own.example is not None and own.example.needed:
        return True
    return not quiet and not own.is_required and own.default is not None


def _value(own: Declared) -> Any:
    value = own.default if own.example is None else own.example.value
    # A range of equal limits is written as one number.
    if isinstance(value, tuple) and len(value) == 2 and value[0] == value[1]:
        return value[0]
    return value


def _text(own: Declared) -> str:
    text = own.description
    if own.is_required or (own.example is not None and own.example.needed):
        return text
    return f"{text} (no default)" if own.default is None and "default" not in text else text


def toml_value(value: Any) -> str:
    """Return a value on one line, as TOML has it."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def _wrapped(text: str, start: str) -> list[str]:
    return textwrap.wrap(text, 100, initial_indent=start, subsequent_indent=start)


_SUFFIXES = {"raster": ".tif", "layer": ".gpkg", "table": ".csv"}


def save_config(config: Config, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a configuration as a TOML file, from which the same run can be made again.

    Inputs that are in memory are written next to it; files are named as seen from there. Those that
    are there already are replaced with ``overwrite`` only.

    Raises
    ------
    OutputError
        If a file is there already, or cannot be written.
    """
    file = Path(path)
    document = written_document(config, file, overwrite)
    write_new(file, tomli_w.dumps(document), overwrite)
    return file


def written_document(config: Config, path: Path, overwrite: bool = False) -> dict[str, Any]:
    """Return a configuration as a document for ``path``; writes what is in memory there."""
    # Symbolic links are followed: the way up from the new place counts real folders.
    base, place = Path(os.path.realpath(config.base)), Path(os.path.realpath(path)).parent

    def named(value: Any, own: str) -> str:
        if not isinstance(value, InMemory):
            return seen_from(place, Path(base, Path(value).expanduser()))
        file = path.parent / f"{own}{_SUFFIXES[value.kind]}"
        with staged_file(file, overwrite) as work, writing(work):
            if value.kind == "raster":
                work.write_bytes(value.data)
            elif value.kind == "table":
                work.write_text(value.data, encoding="utf-8", newline="\n")
            else:
                value.data.to_file(work, driver="GPKG", layer=file.stem)
        return file.name

    def section(name: str, values: Any, own: str) -> Any:
        if not isinstance(values, Mapping):
            return values
        files = FILE_KEYS.get(name, ())
        return {
            key: named(value, own if key == "file" else key) if key in files else plain(value)
            for key, value in values.items()
        }

    document: dict[str, Any] = {}
    for name, values in config.given.items():
        if name in LISTS:
            document[name] = [section(name, v, f"{name}_{k}") for k, v in enumerate(values, 1)]
        elif name == "effects":
            document[name] = {k: section(f"effects.{k}", v, k) for k, v in values.items()}
        else:
            document[name] = section(name, values, name)
    preset = document.get("hazard", {}).get("preset")
    # As the configuration distinguishes a file from the name of a built-in preset.
    if isinstance(preset, str) and is_preset_file(preset):
        document["hazard"]["preset"] = named(preset, "preset")
    return document


_GROUPS = (
    ("Stations and measures", ("stations", "barriers")),
    ("Edits", ("edits",)),
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
        raise OutputError(f"{path}: cannot see what to write; expected a name ending in .gpkg")
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
    text += short_template(with_values(made.keys, assignments))
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
