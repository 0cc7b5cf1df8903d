"""A result folder, read back."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import rasterio
import shapely
from pyogrio.errors import DataLayerError

from sassgis.errors import InputError
from sassgis.files.atomic_output import MANIFEST_NAME
from sassgis.files.gdal_safety import read_frame, vector_file
from sassgis.grid import FloatArray, Grid
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.inputs.dem import open_raster
from sassgis.settings.exposure import ExposedObject, PlacedObjects
from sassgis.settings.results import Band, RasterClass, RasterLayer
from sassgis.studies.stored_result import StoredResult

#: Bands that are read of each map; the map of levels brings its classes.
_BANDS = {
    "reach_probability": ("reach", "standard_error"),
    "energy": ("q95",),
    "passing_height": ("q95",),
    "hazard_level": ("level",),
}
_RISK_LAYERS = ("risk_objects", "risk_lines", "risk_points")
_OBJECT_LAYERS = ("exposed_areas", "exposed_lines", "exposed_points")
_PER_YEAR = ("deaths_per_year", "loss_per_year")
_VALUES = ("energy_q95_kj", "height_q95_m")
RESULT_FILE, ZONE_FILE = "result.gpkg", "hazard.gpkg"
EDITS_FILE, EDITS_LAYER = "edits.gpkg", "edits"


def check_is_result(folder: Path) -> None:
    """Raise InputError if a folder is no result of sassgis."""
    if not (folder / MANIFEST_NAME).is_file():
        found = (
            "a folder without it" if folder.is_dir() else "a file" if folder.exists() else "nothing"
        )
        raise InputError(
            "is not a result of sassgis", file=folder, found=found,
            expected=f"a folder with {MANIFEST_NAME}",
        )  # fmt: skip


def read_manifest(folder: Path) -> Mapping[str, Any]:
    """Return the manifest of a result."""
    check_is_result(folder)
    file = folder / MANIFEST_NAME
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError("cannot be read", file=file, found=str(error)) from None
    wanted = (
        "sassgis", "versions", "inputs", "seed", "ref_widths_m", "preset", "settings", "counts",
    )  # fmt: skip
    if not isinstance(content, dict) or not set(wanted) <= set(content):
        raise InputError("is no manifest of sassgis", file=file, expected=", ".join(wanted))
    for key in ("settings", "counts"):
        if not isinstance(content[key], dict):
            found = type(content[key]).__name__
            raise InputError("is no table", file=file, field=key, found=found)
    for key, value in content["counts"].items():
        if not isinstance(value, int):
            raise InputError("is no whole number", file=file, field=f"counts.{key}", found=value)
    return content


def read_layer(file: Path, name: str, columns: Sequence[str] = ()) -> gpd.GeoDataFrame | None:
    """Return a layer of a result; None where the file or the layer is not there.

    With ``columns`` it must have these, and a geometry in each row.
    """
    if not file.is_file():
        return None
    with vector_file(file, None):
        try:
            frame = read_frame(file, name)
        except DataLayerError:
            return None
    if not isinstance(frame, gpd.GeoDataFrame):
        return None
    if missing := [c for c in columns if c not in frame]:
        raise InputError("a column is missing", file=file, field=f"layer {name}, {missing[0]}")
    if columns and (empty := np.flatnonzero(frame.geometry.isna() | frame.geometry.is_empty)).size:
        found = f"row {int(empty[0]) + 1}"
        raise InputError("a geometry is missing", file=file, field=f"layer {name}", found=found)
    return frame


def read_result(folder: Path) -> StoredResult:
    """Read the parts of a result that can be compared with another.

    It is one of ``sassgis run`` or ``sassgis zone``, or an area or the mosaic of a batch.
    """
    manifest = read_manifest(folder)
    if "rocks" not in manifest["counts"]:
        file = folder / MANIFEST_NAME
        raise InputError("a number is missing", file=file, field="counts.rocks")
    files = {stem: folder / "maps" / f"{stem}.tif" for stem in _BANDS}
    reach = files["reach_probability"]
    if not reach.is_file():
        expected = "a result of sassgis run, zone or batch, with maps/reach_probability.tif"
        raise InputError("this result has no maps to compare", file=folder, expected=expected)
    maps = {s: _read_map(f, _BANDS[s]) for s, f in files.items() if f.is_file()}
    objects, risk, values = _read_objects(folder)
    level = maps.get("hazard_level")
    zones, codes = (None, ()) if level is None else _read_zones(folder / ZONE_FILE, level.classes)
    lines = _read_control_lines(folder / RESULT_FILE)
    return StoredResult(
        folder=folder, manifest=manifest,
        grid=_read_grid(reach, folder / "maps" / "terrain.tif", manifest), maps=maps,
        control_lines={str(r["name"]): r for r in lines},
        traces=tuple((str(r["name"]), str(r["kind"]), r["geometry"]) for r in lines),
        release=_read_release(folder / RESULT_FILE), zones=zones, level_codes=codes,
        objects=objects, risk=risk, values=values,
    )  # fmt: skip


def _read_grid(reach: Path, terrain: Path, manifest: Mapping[str, Any]) -> Grid:
    with open_raster(reach, "maps") as dataset:
        frame = dataset.transform, dataset.shape
    values: FloatArray = np.full(frame[1], np.nan)
    if terrain.is_file():
        with open_raster(terrain, "maps") as dataset:
            if (dataset.transform, dataset.shape) == frame:
                values = dataset.read(1, masked=True).astype(np.float64).filled(np.nan)
    crs, datum = str(manifest.get("crs", "")), str(manifest.get("vertical_datum", ""))
    return Grid(values, frame[0].c, frame[0].f, frame[0].a, crs, datum)


def _read_map(file: Path, wanted: Sequence[str]) -> RasterLayer:
    with open_raster(file, "maps") as dataset:
        names = {dataset.tags(i).get("NAME"): i for i in dataset.indexes}
        if missing := [name for name in wanted if name not in names]:
            raise InputError("band is missing", file=file, field=missing[0])
        try:
            bands = tuple(
                Band(
                    name,
                    dataset.tags(names[name]).get("DESCRIPTION", name),
                    dataset.units[names[name] - 1] or "",
                    dataset.read(names[name], masked=True).astype(np.float32).filled(np.nan),
                )
                for name in wanted
            )
        except rasterio.errors.RasterioError as error:
            raise InputError("cannot be read", file=file, found=str(error)) from None
        tags = dataset.tags()
        classes = _classes(dataset)
        return RasterLayer(
            stem=file.stem,
            title=tags.get("TITLE", file.stem),
            note=tags.get("NOTE", ""),
            bands=bands,
            breaks=(),
            ramp="",
            classes=classes,
        )


def level_classes(folder: Path) -> tuple[RasterClass, ...]:
    """Return hazard levels of a zoning, in the colours of its map; none without that map."""
    file = folder / "maps" / "hazard_level.tif"
    if not file.is_file():
        return ()
    with open_raster(file, "maps") as dataset:
        return _classes(dataset)


def _classes(dataset: Any) -> tuple[RasterClass, ...]:
    """Return classes of a map by its tags, in the colours of its palette; none of numbers."""
    palette = dataset.colormap(1) if dataset.dtypes[0] == "uint8" else {}
    classes = []
    named = dataset.tags(1).get("CLASSES", "")
    # A label may hold "; ", too.
    for text in re.split(r"; (?=-?\d+ = )", named) if named else ():
        value, label = text.split(" = ", 1)
        colour = "#{:02x}{:02x}{:02x}".format(*palette.get(int(value), (128, 128, 128))[:3])
        classes.append(RasterClass(int(value), label, colour))
    return tuple(classes)


def _read_zones(
    file: Path, classes: Sequence[RasterClass]
) -> tuple[Coverage | None, tuple[str, ...]]:
    """Read zones of hazard level by class, and the codes of the levels that occur."""
    frame = read_layer(file, "hazard_zones", ("label", "hazard_level"))
    if frame is None:
        return None, ()
    value = {c.label: c.value for c in classes}
    codes = dict(zip(frame["label"], frame["hazard_level"], strict=True))
    if unknown := set(codes) - set(value):
        problem = "zones of a level that the map does not have"
        raise InputError(problem, file=file, found=sorted(unknown))
    numbers = np.array([value[label] for label in frame["label"]], np.int64)
    ordered = sorted(classes, key=lambda c: c.value)
    return (
        Coverage(frame.geometry.to_numpy(), numbers),
        tuple(codes.get(c.label, c.label) for c in ordered),
    )


def _read_control_lines(file: Path) -> list[dict[str, Any]]:
    rows = []
    for name in ("stations", "barriers"):
        frame = read_layer(file, name, ("name", "kind", "rocks"))
        if frame is not None:
            rows += [
                {str(k): v for k, v in row.items()}
                | {"geometry": shapely.get_coordinates(row["geometry"])}
                for row in pd.DataFrame(frame).to_dict("records")
            ]
    return rows


def _read_release(file: Path) -> tuple[FloatArray, ...]:
    frame = read_layer(file, "release_areas")
    if frame is None:
        return ()
    parts = shapely.get_parts(frame.geometry.to_numpy())
    return tuple(shapely.get_coordinates(shapely.get_exterior_ring(p)) for p in parts)


_Values = dict[str, dict[str, tuple[float, ...]]]


def _read_objects(folder: Path) -> tuple[PlacedObjects, dict[str, dict[str, float]], _Values]:
    """Return exposed objects, and by the name of the whole sums of risk and values."""
    objects: list[ExposedObject] = []
    shapes: list[Any] = []
    risk: dict[str, dict[str, float]] = {}
    values: _Values = {}
    frames = [read_layer(folder / ZONE_FILE, name) for name in _RISK_LAYERS]
    wholes = [read_layer(folder / RESULT_FILE, name) for name in _OBJECT_LAYERS]
    if not any(frame is not None for frame in frames):
        frames = wholes
    for frame in frames:
        for row in [] if frame is None else frame.to_dict("records"):
            one = ExposedObject(row["name"], row["kind"], parent=row.get("part_of") or "")
            parts = shapely.get_parts(row["geometry"])
            objects += [one] * len(parts)
            shapes += list(parts)
            if _PER_YEAR[0] in row:
                sums = risk.setdefault(one.whole, dict.fromkeys(_PER_YEAR, 0.0))
                for column in _PER_YEAR:
                    sums[column] += float(row[column])
    for frame in wholes:
        for row in [] if frame is None or _VALUES[0] not in frame else frame.to_dict("records"):
            values[row["name"]] = {
                column: tuple(
                    np.nan if (value := row[column + end]) is None else float(value)
                    for end in ("", "_low", "_high")
                )
                for column in _VALUES
            }
    return PlacedObjects(tuple(objects), tuple(shapes)), risk, values
