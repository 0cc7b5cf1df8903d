"""Maps as an xarray.Dataset: names as of the files, with system, units, meanings, denominators."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyproj
import shapely
import xarray as xr

from sassgis.grid import Grid
from sassgis.hazard.sources import Sampled
from sassgis.settings.results import RasterLayer

#: The coordinate that holds the system, as CF and rioxarray know it.
GRID_MAPPING = "spatial_ref"
_PLACE = ("y", "x")


def maps_dataset(
    layers: Sequence[RasterLayer], grid: Grid, attributes: Mapping[str, object]
) -> xr.Dataset:
    """Return maps on a grid; NaN where they say nothing.

    Each variable has ``long_name``, ``units`` and ``comment`` (denominator, reference width), maps
    of classes also ``flag_values`` and ``flag_meanings``.
    """
    found = {}
    for layer in layers:
        for band in layer.bands:
            values = xr.DataArray(band.values, dims=_PLACE)
            values.attrs = {
                "long_name": band.description, "units": band.unit or "1", "comment": layer.note,
            }  # fmt: skip
            if layer.classes and band is layer.bands[0]:
                values.attrs |= {
                    "flag_values": np.array([c.value for c in layer.classes], np.int32),
                    "flag_meanings": " ".join(c.label.replace(" ", "_") for c in layer.classes),
                }
            values.encoding["grid_mapping"] = GRID_MAPPING
            single = len(layer.bands) == 1 or layer.stem.startswith(band.name)
            found[layer.stem if single else f"{layer.stem}_{band.name}"] = values
    about = {key: value for key, value in attributes.items() if value is not None}
    return xr.Dataset(found, _coordinates(grid), {"Conventions": "CF-1.10", **about})


def _coordinates(grid: Grid) -> dict[str, Any]:
    n_rows, n_cols = grid.shape
    x, _ = grid.cell_centres(np.arange(n_cols))
    _, y = grid.cell_centres(np.arange(n_rows) * n_cols)
    place = (grid.west, grid.cell_size, 0.0, grid.north, 0.0, -grid.cell_size)
    system: dict[str, Any] = {}
    if grid.crs:
        with warnings.catch_warnings():
            # CF has no word for some parameters of oblique systems; the text has them.
            warnings.simplefilter("ignore", UserWarning)
            system = {**pyproj.CRS.from_wkt(grid.crs).to_cf(), GRID_MAPPING: grid.crs}
    system["GeoTransform"] = " ".join(repr(float(v)) for v in place)
    if grid.vertical_datum:
        system["vertical_datum"] = grid.vertical_datum
    found: dict[str, Any] = {}
    for axis, centres, name in (("y", y, "northing"), ("x", x, "easting")):
        standard = {"standard_name": f"projection_{axis}_coordinate", "units": "m"}
        found[axis] = axis, centres, {"axis": axis.upper(), "long_name": name, **standard}
    return {**found, GRID_MAPPING: ((), 0, system)}


def with_sources(
    maps: xr.Dataset, sampled: Sequence[Sampled], energies_kj: np.ndarray, ref_width_m: float
) -> xr.Dataset:
    """Return the maps with the counts that hazard curves are made of, by source, cell and energy.

    A source for which no frequency is stated has NaN. The energies, float64 of shape (n,), are
    those of the counts.
    """
    sources = [s.source for s in sampled]
    cells = [s.cells for s in sampled]
    width = f"within half the reference width of {ref_width_m:g} m of the centre of the cell"
    per_source = {
        "onset_frequency": ([s.frequency for s in sources], "blocks released per year", "1/year"),
        "simulated_blocks": ([s.rocks for s in sources], "simulated blocks", "1"),
        "never_started": (
            [s.never_started for s in sources], "simulated blocks that never started", "1",
        ),
        "block_width": ([s.block_width_m for s in sources], "mean width of the blocks", "m"),
    }  # fmt: skip
    counts = {
        "arrivals": ("count", f"blocks that come {width} with at least the energy"),
        "arrivals_square": ("square", "sum of the squares of the arrivals of each release point"),
    }
    none = np.zeros((0, energies_kj.size), np.int64)
    return maps.assign_coords(
        area=("source", [s.area for s in sources]),
        scenario=("source", [s.scenario for s in sources]),
        energy=("energy", energies_kj, {"long_name": "kinetic energy", "units": "kJ"}),
    ).assign(
        {
            **{
                name: ("source", np.asarray(values), {"long_name": text, "units": unit})
                for name, (values, text, unit) in per_source.items()
            },
            "release_outline": (
                "source", np.array([shapely.to_wkt(s.release, -1) for s in sampled], object),
                {"long_name": "release area of the source, as WKT"},
            ),
            "arrival_source": (
                "arrival", np.repeat(np.arange(len(cells)), [c.places.size for c in cells]),
                {"long_name": "source of the row of arrivals"},
            ),
            "arrival_cell": (
                "arrival", np.concatenate([np.empty(0, np.int64), *(c.places for c in cells)]),
                {"long_name": "cell of the row of arrivals, row by row from the north-west"},
            ),
            **{
                name: (
                    ("arrival", "energy"),
                    np.concatenate([none, *(getattr(c, part) for c in cells)]),
                    {"long_name": text, "units": "1"},
                )
                for name, (part, text) in counts.items()
            },
        }
    )  # fmt: skip
