"""Sources of zones, from the dataset of a simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
import xarray as xr

from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid
from sassgis.hazard.sources import Sampled
from sassgis.settings.hazard_rules import HazardPreset, Source, SourceCounts
from sassgis.simulation.control_lines import ControlLineSums

_FROM = "a dataset of sassgis.simulate"


def dataset_grid(maps: xr.Dataset) -> Grid:
    """Return the grid of the maps, with the heights of the terrain.

    InputError if the dataset is none of a simulation.
    """
    names = getattr(maps, "variables", ())
    if not {"terrain", "spatial_ref"} <= set(names):
        raise InputError(
            "is no result of a simulation", field="ds",
            found=", ".join(map(str, names)) or type(maps).__name__, expected=_FROM,
        )  # fmt: skip
    system = maps["spatial_ref"].attrs
    west, cell, _, north, _, _ = map(float, str(system["GeoTransform"]).split())
    heights = np.asarray(maps["terrain"].values, np.float64)
    n_rows, n_cols = heights.shape
    grid = Grid(
        heights, west, north, cell, system.get("crs_wkt", ""), system.get("vertical_datum", "")
    )
    x, _ = grid.cell_centres(np.arange(n_cols))
    _, y = grid.cell_centres(np.arange(n_rows) * n_cols)
    gaps = [np.abs(np.asarray(maps[d]) - own).max() for d, own in (("x", x), ("y", y))]
    if max(gaps) > 1e-3 * cell:
        raise InputError(
            "is a part of a dataset", field="ds", found=f"{n_rows} x {n_cols} cells",
            expected="the whole, as the simulation gave it: cut the zones instead",
        )  # fmt: skip
    return grid


def dataset_sources(maps: xr.Dataset, preset: HazardPreset) -> tuple[list[Sampled], FloatArray]:
    """Return the sources with their counts, and the energies of these (kJ).

    InputError if nothing was counted for zones, or not at the thresholds of the preset, or a source
    has no onset frequency.
    """
    if "arrivals" not in maps:
        raise InputError(
            "has no counts for zones", field="ds",
            expected=f"{_FROM} with the width that frequencies refer to: "
            "simulate(..., ref_width_m=10)",
        )  # fmt: skip
    energies = np.asarray(maps["energy"], np.float64)
    missing = [t for t in preset.thresholds_kj if not np.isclose(energies, t, rtol=1e-9).any()]
    if missing:
        raise InputError(
            f"has no counts at {', '.join(f'{t:g}' for t in missing)} kJ", field="ds",
            found="a simulation for other rules",
            expected=f'simulate(..., rules="{preset.name}")',
        )  # fmt: skip
    owner, cells = np.asarray(maps["arrival_source"]), np.asarray(maps["arrival_cell"])
    counts, squares = (np.asarray(maps[n], np.int64) for n in ("arrivals", "arrivals_square"))
    column: dict[str, Any] = {
        n: maps[n].values
        for n in ("area", "scenario", "onset_frequency", "simulated_blocks", "never_started",
                  "block_width", "release_outline")
    }  # fmt: skip
    found = []
    for k in range(maps.sizes["source"]):
        area, scenario = str(column["area"][k]), str(column["scenario"][k])
        frequency = float(column["onset_frequency"][k])
        if not frequency >= 0.0:
            raise InputError(
                f"{area} / {scenario} has no onset frequency", field="ds.onset_frequency",
                found=frequency,
                expected="blocks per year: onset_frequency among the blocks of simulate, or values "
                "set in ds.onset_frequency",
            )  # fmt: skip
        rows = owner == k
        source = Source(
            area=area,
            scenario=scenario,
            frequency=frequency,
            rocks=int(column["simulated_blocks"][k]),
            rocks_per_line=int(maps.attrs["blocks_per_point"]),
            random_points=bool(maps.attrs["random_points"]),
            block_width_m=float(column["block_width"][k]),
            never_started=int(column["never_started"][k]),
        )
        own = SourceCounts(cells[rows].astype(np.int64), counts[rows], squares[rows])
        none = SourceCounts.none(energies.size)
        outline = shapely.from_wkt(str(column["release_outline"][k]))
        found.append(Sampled(source, own, none, ControlLineSums(()), outline))
    return found, energies
