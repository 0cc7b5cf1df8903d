"""Campaigns drawn from the runs of a discrete-element program, as observers with faults note them.

What the program did is known exactly; what is put on top (a scale of the speeds, starts stated
elsewhere) as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from field_cases.program_contacts import (
    DENSITY_KGM3,
    GRAVITY,
    RUNS,
    cells_at,
    program_contacts,
    semi_axes,
)
from field_cases.sites import AUTHUME, AXES, QUARRY_DEM, STOP
from field_cases.tables import Tables, field_file
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.tiles import read_terrain

#: Errors of measurement, as they are stated.
SPEED_REL, POSITION_M, HEIGHT_M = 0.05, 0.25, 0.1
#: Stations, as shares of the median run-out; half of their width (m).
STATIONS, HALF_WIDTH_M = (0.25, 0.45, 0.65), 60.0


@dataclass(frozen=True)
class Campaign:
    """What was noted of some runs.

    Attributes
    ----------
    rocks : DataFrame
        Columns as of ``field_cases.sites.Site``.
    tables : mapping of name to DataFrame
        Besides rocks and deposits.
    drop_m : (float, float)
        Height of the centre above the ground at the release.
    """

    rocks: pd.DataFrame
    tables: Tables
    metadata: dict[str, object]
    drop_m: tuple[float, float]


@dataclass(frozen=True)
class ProgramRuns:
    """The runs, their contacts, and the terrain."""

    samples: FloatArray
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    shape: NDArray[np.str_]
    axes: dict[str, tuple[float, float, float]]
    contacts: pd.DataFrame
    heights: Grid

    @classmethod
    def read(cls, data: Path) -> ProgramRuns:
        """From the folder of the field data."""
        runs = np.load(field_file(data, RUNS, "trajectories.npz"))
        rest = np.flatnonzero(runs["at_rest"])
        return cls(
            runs["samples"].astype(np.float64),
            runs["first"][rest].astype(np.int64),
            runs["last"][rest].astype(np.int64),
            np.array([f"{s}-{k}" for k, s in zip(rest, runs["shape"][rest], strict=True)]),
            {s: semi_axes(data, s) for s in np.unique(runs["shape"]).tolist()},
            program_contacts(data),
            read_terrain(field_file(data, AUTHUME, QUARRY_DEM), "local"),
        )


def ground_at(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Height of the cell at each place."""
    found: FloatArray = grid.values.ravel()[cells_at(grid, x, y)]
    return found


def campaign(runs: ProgramRuns, n: int, everything: bool, effect: str, seed: int) -> Campaign:
    """Note ``n`` runs; ``effect`` is one of "", "scale" and "start"."""
    rng = np.random.default_rng([seed, 1964])
    own = rng.choice(runs.first.size, n, replace=False)
    start = runs.samples[runs.first[own]]
    stop = runs.samples[runs.last[own] - 1]
    mean = (stop - start)[:, [1, 3]].mean(axis=0)
    ahead = mean / np.linalg.norm(mean)
    fault = rng.uniform([0.2, 0.03, 0.0], [1.2, 0.25, 0.15])
    scale = 1.2 if effect == "scale" else 1.0
    # The terrain model ends a few metres above the releases.
    shift = 15.0 * ahead if effect == "start" else 0.0
    names = runs.shape[own]

    def noted(values: FloatArray, sd: float) -> FloatArray:
        return values + rng.normal(0.0, sd, values.shape)

    def fast(values: FloatArray) -> FloatArray:
        return scale * values * (1.0 + rng.normal(0.0, SPEED_REL, values.shape))

    rocks = pd.DataFrame({"rock_id": names, "density_kgm3": DENSITY_KGM3, "place": 0})
    rocks["label"] = [name.split("-")[0] for name in names]
    rocks[["x", "y"]] = start[:, [1, 3]] + shift
    places = noted(stop[:, [1, 3]], POSITION_M)
    rocks[STOP] = 2.0 * np.rint(places / 2.0) if rng.random() < 0.5 else places
    rocks["mass_kg"] = -start[:, 11] / GRAVITY
    rocks[AXES] = [runs.axes[label] for label in rocks["label"]]
    passages, paths = [], []
    far = np.median(np.linalg.norm((stop - start)[:, [1, 3]], axis=1))
    middle = start[:, [1, 3]].mean(axis=0)
    for k, name in zip(own.tolist(), names.tolist(), strict=True):
        rows = runs.samples[runs.first[k] : runs.last[k]]
        along = (rows[:, [1, 3]] - middle) @ ahead
        for j, share in enumerate(STATIONS):
            cross = np.flatnonzero((along[:-1] < share * far) & (along[1:] >= share * far))
            if cross.size and rng.random() >= fault[2]:
                i = int(cross[0])
                u = (share * far - along[i]) / (along[i + 1] - along[i])
                passages.append((name, f"S{j + 1}", *(rows[i] + u * (rows[i + 1] - rows[i]))))
        paths += [(name, *row) for row in rows]
    columns = ["x", "z", "y", *(f"{q}{c}" for q in "vw" for c in "xyz")]
    passed = pd.DataFrame(passages, columns=["rock_id", "station", "t", *columns, *"abc"])
    path = pd.DataFrame(paths, columns=["rock_id", "t_s", *columns, *"abc"])
    tables = {"stations": _stations(middle, ahead, far)}
    for name, table in (("passages", passed), ("trajectories", path)):
        ground = ground_at(runs.heights, table["x"].to_numpy(), table["y"].to_numpy())
        height = np.maximum(noted(table["z"].to_numpy() - ground, HEIGHT_M), 0.0)
        speed = fast(np.linalg.norm(table[["vx", "vy", "vz"]], axis=1))
        turns = np.linalg.norm(table[["wx", "wy", "wz"]], axis=1) / (2.0 * np.pi)
        more = {"speed_mps": speed, "rotation_hz": turns, "z": noted(table["z"], HEIGHT_M)}
        more |= {c: noted(table[c], POSITION_M) for c in "xy"}
        table = table[[c for c in ("rock_id", "station", "t_s") if c in table]].assign(**more)
        tables[name] = table.assign(height_m=height) if name == "passages" else table
    tables["impacts"] = _contacts(runs.contacts, names, fault, fast)
    known = ("contact_min_normal_speed_mps", "contact_min_interval_s", "passages_missed_share")
    metadata: dict[str, object] = {
        "speed_error_rel": SPEED_REL, "position_error_m": POSITION_M, "height_error_m": HEIGHT_M
    }  # fmt: skip
    metadata |= {key: v for key, v in zip(known, fault.tolist(), strict=True) if rng.random() < 0.5}
    kept = tables if everything else {k: tables[k] for k in ("stations", "passages")}
    above = start[:, 2] - ground_at(runs.heights, start[:, 1], start[:, 3])
    return Campaign(rocks, kept, metadata, (float(above.min()), float(above.max())))


def _stations(middle: FloatArray, ahead: FloatArray, far: float) -> pd.DataFrame:
    aside = HALF_WIDTH_M * np.array([-ahead[1], ahead[0]])
    at = [middle + share * far * ahead for share in STATIONS]
    rows = [(f"S{j + 1}", *(p - aside), *(p + aside)) for j, p in enumerate(at)]
    return pd.DataFrame(rows, columns=["station", "x0", "y0", "x1", "y1"])


def _contacts(
    contacts: pd.DataFrame, names: NDArray[np.str_], fault: FloatArray, fast: object
) -> pd.DataFrame:
    """Contacts that are strong enough, and long enough after the one before."""
    own = contacts[contacts["rock_id"].isin(names) & (-contacts["vn_in_mps"] >= fault[0])]
    own = own.sort_values(["rock_id", "t_s"])
    since = own.groupby("rock_id")["t_s"].diff().fillna(np.inf)
    own = own[since >= fault[1]].copy()
    for name in ("vt_in_mps", "vn_in_mps", "vt_out_mps", "vn_out_mps"):
        own[name] = fast(own[name].to_numpy())  # type: ignore[operator]
    own["impact"] = own.groupby("rock_id").cumcount() + 1
    return own.drop(columns=["ground", "t_s", *AXES])
