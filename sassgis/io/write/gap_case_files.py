"""A made case as files: terrain, ground, release points, configuration, observations."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import rasterio
from numpy.typing import NDArray

from sassgis.io.atomic_output import staged_output, writing
from sassgis.io.read.dem import affine_of
from sassgis.io.write.geopackage import add_layer
from sassgis.model.grid import FloatArray, Grid

CONFIG_NAME = "config.toml"
OBSERVATIONS_NAME = "observations"

# A made slope falls less steeply in its run-out than the usual limit of a fall line.
_CONFIG = """[project]
name = {title}

[terrain]
dem = "dem.tif"
{datum}energy_line_angle_deg = 10.0

[release]
file = "release.gpkg"

[ground]
default = {default}
file = "ground.tif"
raster_classes = {{ {classes} }}

[[blocks]]
name = "blocks"
{blocks}

[run]
seed = 1
jobs = 1
"""


def write_case(
    folder: Path,
    *,
    title: str,
    dem: Grid,
    class_names: tuple[str, ...],
    class_codes: NDArray[Any],
    releases: FloatArray,
    blocks: Mapping[str, tuple[float, float]],
    tables: Mapping[str, Mapping[str, NDArray[Any]]],
    metadata: Mapping[str, float],
) -> Path:
    """Write a case; its folder appears whole or not at all. OutputError if there is such a folder.

    Returns the configuration; observations are in the folder ``observations`` beside it.

    Parameters
    ----------
    class_codes : int, shape of the grid
        Position in ``class_names``.
    releases : float64, shape (n, 3)
        Release points x, y, z (m).
    blocks : mapping
        Keys of ``[[blocks]]`` to limits.
    """
    with staged_output(folder, overwrite=False) as work, writing(folder):
        _raster(work / "dem.tif", dem, dem.values)
        _raster(work / "ground.tif", dem, (class_codes + 1).astype(np.uint8))
        points = gpd.GeoDataFrame(
            geometry=gpd.points_from_xy(*np.asarray(releases).T[:3]), crs=dem.crs
        )
        add_layer(work / "release.gpkg", "release", points, "Point")
        config = _CONFIG.format(
            title=json.dumps(title),
            datum=f"vertical_datum = {json.dumps(dem.vertical_datum)}\n"
            if dem.vertical_datum
            else "",
            default=json.dumps(class_names[0]),
            classes=", ".join(f"{k + 1} = {json.dumps(n)}" for k, n in enumerate(class_names)),
            blocks="\n".join(f"{k} = [{low!r}, {high!r}]" for k, (low, high) in blocks.items()),
        )
        (work / CONFIG_NAME).write_text(config, encoding="utf-8")
        write_observations(work / OBSERVATIONS_NAME, tables, metadata)
    return folder / CONFIG_NAME


def write_observations(
    folder: Path, tables: Mapping[str, Mapping[str, NDArray[Any]]], metadata: Mapping[str, float]
) -> Path:
    """Write tables of observations (columns by name) as a folder of CSV files; returns it."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, columns in tables.items():
            # Tenths of a millimetre of national coordinates; nobody measures nearer.
            pd.DataFrame(dict(columns)).to_csv(
                folder / f"{name}.csv", index=False, float_format="%.11g"
            )
        keys = pd.DataFrame({"key": list(metadata), "value": list(metadata.values())})
        keys.to_csv(folder / "metadata.csv", index=False)
    return folder


def folder_digest(folder: Path) -> str:
    """SHA-256 over names and contents of all files of a folder, in the order of their names."""
    total = hashlib.sha256()
    for file in sorted(p for p in folder.rglob("*") if p.is_file()):
        total.update(f"{file.relative_to(folder).as_posix()}\n".encode())
        total.update(hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()


def _raster(file: Path, grid: Grid, values: NDArray[Any]) -> None:
    n_rows, n_cols = grid.shape
    with rasterio.open(
        file, "w", driver="GTiff", width=n_cols, height=n_rows, count=1, dtype=values.dtype,
        crs=grid.crs, transform=affine_of(grid), compress="deflate",
    ) as dataset:  # fmt: skip
        dataset.write(values, 1)
