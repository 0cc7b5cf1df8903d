"""A folder of inputs of Rockyfor3D as the layers and keys of a configuration.

Names and meaning of the files are those of Rockyfor3D (v5.2) as we know them: its manual was not
at hand, and docs/rockyfor3d.md says of each how far that is checked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from affine import Affine
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial import cKDTree

from sassgis.engine.effects.trees import energy_ratios
from sassgis.errors import InputError
from sassgis.files.plain_file import read_text
from sassgis.grid import FloatArray, IntArray
from sassgis.inputs.dem import open_raster, read_band
from sassgis.inputs.dem_system import extent_text
from sassgis.inputs.site_layers import StartKeys, seen_from_folder

_OPTION = "--rockyfor3d"
_wrong = partial(InputError, field=_OPTION)
_SUFFIXES = (".asc", ".tif", ".tiff")
#: The density of the rock of source cells, under the names that it has.
_DENSITY = ("bldens", "rockdensity", "rock_density")
_NEEDED = ("dem", "soiltype", "d1", "d2", "d3")
#: Forms of blocks by their number, and volume over the product of the three diameters.
_FORMS = {
    1: ("rectangular", 1.0), 2: ("ellipsoidal", math.pi / 6.0), 3: ("spherical", math.pi / 6.0),
    4: ("disc-shaped", math.pi / 6.0),
}  # fmt: skip
#: More kinds of blocks, or release areas, than these are put together.
_MOST_SCENARIOS, _MOST_AREAS = 12, 50


@cache
def soil_types() -> Mapping[int, Any]:
    """Return name, ground class and source of each soil type (data/rockyfor3d_soils.csv)."""
    with (resources.files("sassgis") / "data" / "rockyfor3d_soils.csv").open("rb") as file:
        table = pd.read_csv(file, index_col="soil_type")
    return dict(zip(table.index.tolist(), table.itertuples(), strict=True))


@dataclass(frozen=True)
class Converted:
    """Conversion of a folder of Rockyfor3D.

    Layers and tables are to be written next to the configuration as ``<name>.gpkg`` and
    ``<name>.csv``; notes say what was taken how, and what has no counterpart.
    """

    keys: StartKeys
    layers: dict[str, gpd.GeoDataFrame] = field(default_factory=dict)
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Folder:
    """The rasters of a folder, which lie on the cells of its dem."""

    path: Path
    files: Mapping[str, Path]
    transform: Affine
    shape: tuple[int, int]

    def has(self, name: str) -> bool:
        return name in self.files

    def read(self, name: str) -> FloatArray:
        """Return values of a raster; NaN where it holds none."""
        file = self.files[name]
        with open_raster(file, _OPTION) as raster:
            here, there = tuple(raster.transform)[:6], tuple(self.transform)[:6]
            tolerance = 1e-3 * abs(self.transform.a)
            if raster.shape != self.shape or not np.allclose(here, there, rtol=0.0, atol=tolerance):
                found, expected = (
                    f"{shape[0]} x {shape[1]} cells, corner {place[2]:.10g}, {place[5]:.10g}"
                    for shape, place in ((raster.shape, here), (self.shape, there))
                )
                problem = "does not lie on the cells of dem"
                raise _wrong(problem, file=file, found=found, expected=expected)
            raw = read_band(raster, 1, file)
        values: FloatArray = np.ma.filled(raw.astype(np.float64), np.nan)
        return values

    def centres(self, rows: IntArray, cols: IntArray) -> FloatArray:
        """Return x and y of the centres of cells, shape (n, 2)."""
        a, b, c, d, e, f = tuple(self.transform)[:6]
        u, v = cols + 0.5, rows + 0.5
        return np.column_stack([a * u + b * v + c, d * u + e * v + f])


def read_rockyfor3d(path: Path, config_folder: Path, crs: str | None) -> Converted:
    """Read a folder of Rockyfor3D.

    It has ``dem``, ``soiltype``, ``d1``, ``d2``, ``d3`` and a density of the rock as rasters;
    ``blshape``, ``rg70``, ``rg20``, ``rg10``, nets and forest where there are any. Paths are
    written as seen from the folder of the configuration; ``crs`` is that of the layers that are
    made.
    """
    folder = _opened(path)
    keys: StartKeys = [("terrain", {"dem": seen_from_folder(config_folder, folder.files["dem"])})]
    out = Converted(keys)
    _release(folder, crs, out)
    soil = folder.read("soiltype")
    keys.append(("ground", _ground(folder, soil, config_folder, out)))
    _nets(folder, crs, out)
    _forest(folder, config_folder, out)
    _left(folder, out)
    return out


_WRONG = "is no folder of Rockyfor3D"


def rasters_of(path: Path) -> dict[str, Path]:
    """Return the rasters of a folder by name; of several of one name the first in the alphabet."""
    if not path.is_dir():
        raise _wrong(_WRONG, file=path, expected="the folder with dem.asc")
    return {
        file.stem.lower(): file
        for file in sorted(path.iterdir(), reverse=True)
        if file.suffix.lower() in _SUFFIXES
    }


def _opened(path: Path) -> _Folder:
    files = rasters_of(path)
    missing = [name for name in _NEEDED if name not in files]
    if not any(name in files for name in _DENSITY):
        missing.append(_DENSITY[0])
    if missing:
        expected = ", ".join(f"{n}.asc" for n in (*_NEEDED, _DENSITY[0]))
        found = f"no {', '.join(f'{n}.asc' for n in missing)}"
        raise _wrong(_WRONG, file=path, found=found, expected=expected)
    with open_raster(files["dem"], _OPTION) as raster:
        return _Folder(path, files, raster.transform, raster.shape)


def _release(folder: _Folder, crs: str | None, out: Converted) -> None:
    """Return release areas and block scenarios of the source cells."""
    density = folder.read(next(name for name in _DENSITY if folder.has(name)))
    source = np.nan_to_num(density) > 0.0
    sides = np.array([folder.read(name)[source] for name in ("d1", "d2", "d3")])
    if not source.any() or not (np.nan_to_num(sides) > 0.0).all():
        problem = "has source cells without a block" if source.any() else "has no source cell"
        expected = "a density, and d1, d2 and d3 above 0, on every source cell"
        raise _wrong(problem, file=folder.path, expected=expected)
    form = np.full(sides.shape[1], 2.0)
    if folder.has("blshape"):
        form = folder.read("blshape")[source]
        unknown = sorted({*form.tolist()} - {*map(float, _FORMS)})
        if unknown:
            known = ", ".join(f"{k} ({name})" for k, (name, _) in _FORMS.items())
            problem, file = "holds a form that is not known", folder.files["blshape"]
            raise _wrong(problem, file=file, found=f"{unknown[0]:g}", expected=known)
    kinds, which = np.unique(
        np.vstack([np.round(sides, 2), np.round(density[source]), form]), axis=1,
        return_inverse=True,
    )  # fmt: skip
    scenarios, of_kind = _scenarios(kinds)
    label = np.zeros(folder.shape, np.int32)
    label[source] = of_kind[which.ravel()] + 1
    out.layers["release"] = _areas(label, [s["name"] for s in scenarios], folder, crs)
    release = {"file": "release.gpkg", "name_field": "name", "scenario_field": "scenario"}
    out.keys.append(("release", {**release, "spacing_m": abs(folder.transform.a)}))
    out.keys.extend(("blocks", own) for own in scenarios)
    out.notes.append(
        f"Each of the {int(source.sum())} source cells is a release point; release areas: "
        f"{len(out.layers['release'])}. release.rocks_per_point is the number of "
        "simulations per source cell. What is typed into Rockyfor3D's window is no file: a "
        "variation of the volume is a range of volume_m3 here, a fall height is drop_m."
    )


def _scenarios(kinds: FloatArray) -> tuple[list[dict[str, Any]], IntArray]:
    """Make a scenario for each kind of block, or for several of like volume if there are many.

    ``kinds`` has a column for each: three diameters (m), density (kg/m³), form. Returns the
    scenarios and the scenario of each kind.
    """
    share = np.array([_FORMS[int(k)][1] for k in kinds[4]])
    volume = kinds[:3].prod(axis=0) * share
    order = np.argsort(volume, kind="stable")
    groups = np.array_split(order, min(order.size, _MOST_SCENARIOS))
    of_kind = np.zeros(order.size, np.int64)
    scenarios: list[dict[str, Any]] = []
    sides = np.sort(kinds[:3], axis=0)[::-1] / kinds[:3].max(axis=0)
    for number, group in enumerate(groups):
        of_kind[group] = number
        forms = sorted({_FORMS[int(k)][0] for k in kinds[4, group]})
        name = f"{np.median(volume[group]):.3g} m3 {' or '.join(forms)}"
        if name in [s["name"] for s in scenarios]:
            name = f"{name} {number + 1}"
        scenarios.append(
            {
                "name": name,
                "volume_m3": _span(volume[group]),
                "shape": tuple(_span(side[group]) for side in sides),
                "density_kgm3": _span(kinds[3, group]),
            }
        )
    return scenarios, of_kind


def _span(values: FloatArray) -> float | tuple[float, float]:
    low, high = (float(f"{v:.4g}") for v in (values.min(), values.max()))
    return low if low == high else (low, high)


def _areas(
    label: NDArray[np.int32], names: Sequence[str], folder: _Folder, crs: str | None
) -> gpd.GeoDataFrame:
    """Return centres of the source cells of each scenario; connected ones apart if they are few."""
    several = [ndimage.label(label == k, np.ones((3, 3))) for k in range(1, len(names) + 1)]
    if sum(count for _, count in several) > _MOST_AREAS:
        several = [((label == k).astype(np.int32), 1) for k in range(1, len(names) + 1)]
    rows = [
        {
            "scenario": name,
            "geometry": shapely.MultiPoint(folder.centres(*np.nonzero(parts == part))),
        }
        for name, (parts, count) in zip(names, several, strict=True)
        for part in range(1, count + 1)
    ]
    frame = gpd.GeoDataFrame(rows, geometry="geometry", crs=crs)
    frame.insert(0, "name", [f"source {k}" for k in range(1, len(rows) + 1)])
    return frame


def _ground(
    folder: _Folder, soil: FloatArray, config_folder: Path, out: Converted
) -> dict[str, object]:
    """Return soil types as ground classes, and what the roughness heights are there."""
    known = soil_types()
    present = np.unique(soil[np.isfinite(soil)]).tolist()
    wrong = partial(_wrong, file=folder.files["soiltype"], expected=", ".join(map(str, known)))
    if not present:
        raise wrong("holds no soil type", found=f"{soil.size} cells, all nodata")
    for number in present:
        if number not in known:
            raise wrong("holds a soil type that is not known", found=f"{number:g}")
    rough = {n: folder.read(n) for n in ("rg70", "rg20", "rg10") if folder.has(n)}
    known_cells = np.isfinite(soil).sum()
    for number in map(int, present):
        own, here = known[number], soil == number
        heights = ", ".join(
            f"{n} {np.nanmean(v[here]):.2f} m"
            for n, v in rough.items()
            if np.isfinite(v[here]).any()
        )
        out.notes.append(
            f"Soil type {number} ({own.name}), {100.0 * here.sum() / known_cells:.1f} % of the "
            "cells with a soil type, is ground "
            f"class {own.ground_class}" + (f"; mean of {heights}." if heights else ".")
        )
    out.notes.append(
        "Which class takes the place of a soil type is our judgement, not checked against the "
        "manual (sassgis/data/rockyfor3d_soils.csv). Calibrate the classes, or change "
        "ground.raster_classes."
    )
    if rough:
        out.notes.append(
            "rg70, rg20 and rg10 have no counterpart: how rough the ground is, is in each ground "
            "class (dp_min, dp_max, d_star_m). [effects.roughness] obstacle_m is the nearest key."
        )
    # Between soil types and no soil type lies no cell.
    default = known[int(np.bincount(soil[np.isfinite(soil)].astype(np.int64)).argmax())]
    return {
        "default": default.ground_class,
        "file": seen_from_folder(config_folder, folder.files["soiltype"]),
        "raster_classes": {str(int(n)): known[int(n)].ground_class for n in present},
    }


def _nets(folder: _Folder, crs: str | None, out: Converted) -> None:
    """Convert cells with the number of a net to lines with its height and capacity."""
    names = ("net_number", "net_height", "net_energy")
    given = [name for name in names if folder.has(name)]
    if not given:
        return
    if len(given) < len(names):
        missing = next(name for name in names if name not in given)
        problem, expected = "has nets without all of their rasters", f"{missing}.asc as well"
        raise _wrong(problem, file=folder.path, found=", ".join(given), expected=expected)
    number, height, energy = (folder.read(name) for name in names)
    rows = []
    for net in np.unique(number[np.nan_to_num(number) > 0.0]).tolist():
        here = number == net
        if not (np.nanmax(height[here]) > 0.0 and np.nanmax(energy[here]) > 0.0):
            expected = "net_height and net_energy above 0 on its cells"
            problem, found = "has a net without height or energy", f"net {net:g}"
            raise _wrong(problem, file=folder.path, found=found, expected=expected)
        parts, count = ndimage.label(here, np.ones((3, 3)))
        for part in range(1, count + 1):
            line = _centre_line(folder, *np.nonzero(parts == part))
            if line is None:
                out.notes.append(f"A single cell of net {net:g} is left out.")
                continue
            name = f"net {net:g}" + (f" ({part})" if count > 1 else "")
            numbers = [float(np.nanmedian(v[parts == part])) for v in (height, energy)]
            rows.append((name, *numbers, line))
    if not rows:
        return
    columns = ["name", "height_m", "capacity_kj", "geometry"]
    out.layers["nets"] = gpd.GeoDataFrame(rows, columns=columns, geometry="geometry", crs=crs)
    nets: dict[str, object] = {
        "name": "nets", "kind": "net", "file": "nets.gpkg", "name_field": "name",
        "height_m_field": "height_m", "capacity_kj_field": "capacity_kj",
    }  # fmt: skip
    out.keys.append(("barriers", nets))
    out.notes.append(
        f"{len(rows)} {'nets are lines' if len(rows) > 1 else 'net is a line'} along the middle of "
        "the cells. height_m is vertical here; that net_height is, too, is not checked."
    )


def _centre_line(folder: _Folder, rows: IntArray, cols: IntArray) -> Any:
    """Return longest of the shortest ways through the cells of a net; None for a single cell."""
    if rows.size < 2:
        return None
    pairs = cKDTree(np.column_stack([rows, cols])).query_pairs(1.5, output_type="ndarray")
    one, two = pairs.T
    length = np.hypot(rows[one] - rows[two], cols[one] - cols[two])
    graph = coo_matrix((length, (one, two)), shape=(rows.size, rows.size))
    distance, before = shortest_path(graph, directed=False, return_predecessors=True)
    start, at = np.unravel_index(int(np.argmax(distance)), distance.shape)
    path = [int(at)]
    while path[-1] != start:
        path.append(int(before[start, path[-1]]))
    points = folder.centres(rows[path], cols[path])
    return shapely.LineString(points).simplify(0.75 * abs(folder.transform.a))


def _forest(folder: _Folder, config_folder: Path, out: Converted) -> None:
    """Convert the forest: single trees, or stands on cells."""
    listed = next((f for f in folder.path.iterdir() if f.name.lower() == "treefile.txt"), None)
    conifers = folder.read("conif_percent") if folder.has("conif_percent") else None
    if listed is not None:
        out.tables["trees"] = _trees(listed, folder, conifers)
        out.keys.append(("effects.trees", {"single_trees": "trees.csv"}))
        out.notes.append(
            f"{len(out.tables['trees'])} trees of {listed.name}: stems are counted within 5 m, and "
            "blocks meet them at random along their path."
        )
        return
    stands = [name for name in ("nrtrees", "dbhmean") if folder.has(name)]
    if len(stands) < 2:
        if stands:
            out.notes.append(f"{stands[0]} alone makes no forest: nrtrees and dbhmean do.")
        return
    keys: dict[str, object] = {
        "stems_raster": seen_from_folder(config_folder, folder.files["nrtrees"]),
        "dbh_raster": seen_from_folder(config_folder, folder.files["dbhmean"]),
    }
    stems = np.nan_to_num(folder.read("nrtrees"))
    if conifers is not None and stems.sum() > 0.0:
        share = float(np.average(np.nan_to_num(conifers), weights=stems)) / 100.0
        ratios = energy_ratios()
        mean = share * ratios["conifers"] + (1.0 - share) * ratios["broadleaved"]
        keys |= {"species": "conifers", "efficiency": round(mean / ratios["conifers"], 3)}
        out.notes.append(
            f"The forest has {100.0 * share:.0f} % conifers: one factor on the energy of a stem "
            "for all of it (not checked)."
        )
    out.keys.append(("effects.trees", keys))
    if folder.has("dbhstd"):
        out.notes.append("dbhstd has no counterpart: all stems of a cell have its mean diameter.")


def _trees(file: Path, folder: _Folder, conifers: FloatArray | None) -> pd.DataFrame:
    """Return x, y, diameter (cm) and, where stated, share of conifers of each tree."""
    expected = "x, y, diameter at breast height (cm) and, if wanted, share of conifers (%)"
    wrong = partial(_wrong, file=file, expected=expected)
    lines = [line.replace(",", " ").replace(";", " ").split()
             for line in read_text(file, _OPTION, expected).splitlines()]  # fmt: skip
    found: list[list[float]] = []
    for number, words in enumerate(lines, start=1):
        try:
            values = [float(word) for word in words]
        except ValueError:
            if number == 1:  # a header
                continue
            values = []
        if words and len(values) not in (3, 4):
            raise wrong(f"row {number}: is no tree", found=" ".join(words))
        if words:
            found.append([*values, *([math.nan] if len(values) == 3 else [])])
    if not found:
        raise wrong("holds no tree")
    x, y, dbh, share = np.array(found).T
    west, north, side = folder.transform.c, folder.transform.f, folder.transform.a
    col, row = (np.floor(v / side).astype(np.int64) for v in (x - west, north - y))
    inside = (row >= 0) & (row < folder.shape[0]) & (col >= 0) & (col < folder.shape[1])
    if not inside.any():
        raise wrong("no tree lies on dem", found=extent_text(x.min(), y.min(), x.max(), y.max()))
    if conifers is not None:
        missing = inside & np.isnan(share)
        share[missing] = conifers[row[missing], col[missing]]
    frame = pd.DataFrame({"x": x, "y": y, "dbh_cm": dbh})
    return frame if np.isnan(share).all() else frame.assign(conifer_share=share / 100.0)


def _left(folder: _Folder, out: Converted) -> None:
    """Note the files of which nothing was made."""
    read = {
        *_NEEDED, *_DENSITY, "blshape", "rg70", "rg20", "rg10", "net_number", "net_height",
        "net_energy", "nrtrees", "dbhmean", "dbhstd", "conif_percent",
    }  # fmt: skip
    others = sorted(file.name for name, file in folder.files.items() if name not in read)
    if others:
        out.notes.append(f"Not read: {', '.join(others)}.")
