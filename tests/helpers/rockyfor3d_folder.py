"""A folder of inputs of Rockyfor3D: a slope with two kinds of source cells, nets and trees."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from helpers.small_slope import CELL, COLS, NORTH, ROWS, WEST, heights


def write_grid(file: Path, values: np.ndarray, cell: float = CELL) -> None:
    """A raster as Rockyfor3D reads it."""
    rows = "\n".join(" ".join(f"{v:.6g}" for v in row) for row in values)
    file.write_text(
        f"ncols {values.shape[1]}\nnrows {values.shape[0]}\nxllcorner {WEST}\n"
        f"yllcorner {NORTH - cell * values.shape[0]}\ncellsize {cell}\nNODATA_value -9999\n{rows}\n"
    )


def made(folder: Path, more: Mapping[str, np.ndarray] | None = None) -> Path:
    """The folder with what every run needs, and more rasters by their names."""
    folder.mkdir(exist_ok=True)
    zero = np.zeros((ROWS, COLS))
    density, d1, d2, d3, form = (zero.copy() for _ in range(5))
    large, small = np.s_[10:14, 3:7], np.s_[30:33, 3:8]
    density[large], density[small] = 2700.0, 2600.0
    for sides, at in (((1.2, 1.0, 0.8), large), ((0.5, 0.4, 0.4), small)):
        d1[at], d2[at], d3[at] = sides
    form[large], form[small] = 1.0, 2.0
    soil = np.full((ROWS, COLS), 4.0)
    soil[:, 45:] = 1.0
    rasters = {
        "dem": heights(), "soiltype": soil, "rockdensity": density, "d1": d1, "d2": d2, "d3": d3,
        "blshape": form, "rg70": 0.05 * soil, "rg20": 0.1 * soil, "rg10": 0.2 * soil,
        **(more or {}),
    }  # fmt: skip
    for name, values in rasters.items():
        write_grid(folder / f"{name}.asc", values)
    return folder
