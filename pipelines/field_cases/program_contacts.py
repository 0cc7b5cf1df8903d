"""Contacts of blocks in a discrete-element program, told from its trajectories.

The runs at the quarry of Authume (Garcia et al. 2022, Eng. Geol. 310:106855) were made with
Rockable: four real block shapes, not convex, on a terrain mesh of 0.5 m. They are the output of a
model, not observations.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from field_cases.sites import AUTHUME, AUTHUME_ZONES, QUARRY_DEM, QUARRY_ZONES
from field_cases.tables import field_file
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.tiles import read_terrain

RUNS = "authume_rockable_p1"
GRAVITY = 9.81
DENSITY_KGM3 = 2700.0
#: A block flies where the resultant force is its weight, to this share of it.
_WEIGHT_SHARE = 0.02
#: Samples (of 0.1 s) that a contact may take: longer ones are sliding or rolling.
_LONGEST = 2
#: Contacts that are slower along the normal, or on steeper ground, are left out (m/s, degrees): the
#: normal of a terrain of 0.5 m is not known well enough for them.
_SLOWEST_MPS, _STEEPEST_DEG = 0.5, 50.0


def program_contacts(data: Path) -> pd.DataFrame:
    """Short contacts between two flights, in the columns of observed impacts.

    Time and place (in plan) are those of the sample before. The velocities are those at the middle
    of the contact, along the ground smoothed over about the size of a block and along its normal;
    the spin is that part of it that goes with the way.
    """
    runs = np.load(field_file(data, RUNS, "trajectories.npz"))
    heights = read_terrain(field_file(data, AUTHUME, QUARRY_DEM), "local")
    zones = read_terrain(field_file(data, AUTHUME, QUARRY_ZONES), "local")
    axes = {shape: semi_axes(data, shape) for shape in np.unique(runs["shape"]).tolist()}
    samples = runs["samples"].astype(np.float64)
    found = []
    for k, (first, last) in enumerate(zip(runs["first"], runs["last"], strict=True)):
        own = samples[first:last]
        shape = str(runs["shape"][k])
        for before, after in _between_flights(own):
            found.append((f"{shape}-{k}", *own[before], *own[after], *axes[shape]))
    rows = np.array([row[1:] for row in found])
    into, out, ends = rows[:, :13], rows[:, 13:26], rows[:, 26:]
    half = 0.5 * (out[:, 0] - into[:, 0])
    v_in, v_out = into[:, 4:7].copy(), out[:, 4:7].copy()
    # Y is the vertical.
    v_in[:, 1] -= GRAVITY * half
    v_out[:, 1] += GRAVITY * half
    normal = _normals(heights, into[:, 1], into[:, 3])
    vn_in, vn_out = (v_in * normal).sum(1), (v_out * normal).sum(1)
    along = v_in - vn_in[:, None] * normal
    vt_in = np.linalg.norm(along, axis=1)
    ahead = along / vt_in[:, None]
    axle = np.cross(normal, ahead)
    slope = np.degrees(np.arccos(normal[:, 1]))
    code = zones.values.ravel()[cells_at(zones, into[:, 1], into[:, 3])]
    table = pd.DataFrame(
        {
            "rock_id": [row[0] for row in found],
            "t_s": into[:, 0],
            "x": into[:, 1],
            "y": into[:, 3],
            "ground": [AUTHUME_ZONES.get(int(c), "") if np.isfinite(c) else "" for c in code],
            # The dip along the way.
            "slope_deg": np.degrees(np.arcsin(-ahead[:, 1])),
            "vt_in_mps": vt_in,
            "vn_in_mps": vn_in,
            "omega_in_radps": (into[:, 7:10] * axle).sum(1),
            "vt_out_mps": (v_out * ahead).sum(1),
            "vn_out_mps": vn_out,
            "omega_out_radps": (out[:, 7:10] * axle).sum(1),
            # Azimuths grow clockwise, as seen from above with y to the north.
            "turn_deg": np.degrees(
                np.arctan2(
                    v_in[:, 2] * v_out[:, 0] - v_in[:, 0] * v_out[:, 2],
                    v_in[:, 0] * v_out[:, 0] + v_in[:, 2] * v_out[:, 2],
                )
            ),
            **{f"semi_axis_{c}_m": ends[:, i] for i, c in enumerate("abc")},
        }
    )
    use = (vn_in < -_SLOWEST_MPS) & (slope < _STEEPEST_DEG) & (table["ground"] != "")
    return table[use].reset_index(drop=True)


def _between_flights(own: FloatArray) -> list[tuple[int, int]]:
    """The samples before and after each short contact of one run."""
    weight = -own[0, 11]
    force = own[:, 10:13] + np.array([0.0, weight, 0.0])
    flies = np.all(np.abs(force) < _WEIGHT_SHARE * weight, axis=1)
    turns = np.flatnonzero(np.diff(flies.astype(int)))
    found = []
    for end, begin in pairwise(turns.tolist()):
        if flies[end] and begin - end <= _LONGEST:
            found.append((end, begin + 1))
    return found


def semi_axes(data: Path, shape: str) -> tuple[float, float, float]:
    """Semi-axes of an ellipsoid with a block's mass and ratios of principal extents (m)."""
    runs = np.load(field_file(data, RUNS, "trajectories.npz"))
    first = runs["first"][np.flatnonzero(runs["shape"] == shape)[0]]
    mass = -float(runs["samples"][first, 11]) / GRAVITY
    points = np.loadtxt(field_file(data, RUNS, f"{shape}.xyz"), ndmin=2)[:, :3]
    points = points - points.mean(axis=0)
    _, vectors = np.linalg.eigh(np.cov(points.T))
    extent = np.sort(np.ptp(points @ vectors, axis=0))[::-1]
    scale = np.cbrt(mass / DENSITY_KGM3 / (4.0 / 3.0 * np.pi) / extent.prod())
    a, b, c = (float(scale * e) for e in extent)
    return a, b, c


def _normals(heights: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Upward normals of the terrain, (x, up, y), smoothed over two cells; shape (n, 3)."""
    known = np.where(np.isfinite(heights.values), heights.values, np.nanmin(heights.values))
    down, right = np.gradient(gaussian_filter(known, 1.0), heights.cell_size)
    at = cells_at(heights, x, y)
    normal = np.stack([-right.ravel()[at], np.ones(len(x)), down.ravel()[at]], axis=1)
    made: FloatArray = normal / np.linalg.norm(normal, axis=1)[:, None]
    return made


def cells_at(grid: Grid, x: FloatArray, y: FloatArray) -> NDArray[np.int64]:
    """Numbers of the cells at some places; of the nearest one for places outside."""
    rows, cols = grid.shape
    col, row = (np.rint(v).astype(np.int64) for v in grid.col_row(x, y))
    return np.clip(row, 0, rows - 1) * cols + np.clip(col, 0, cols - 1)
