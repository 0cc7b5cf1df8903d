"""Is the run-out at Tschamut wrong, because of which effect, and how far does the gap shrink?

    python pipelines/gap_tschamut2014.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folder ``tschamut2014`` (A. Volkwein and W. Gerber 2018, Repetitive trajectory
testing in Tschamut 2014, EnviDat, doi 10.16904/envidat.34; ODbL). Writes configuration, terrain,
observations of all runs and of two splits, the diagnoses, and ``results.json``. The terrain was not
surveyed: it is a surface of 5 m cells interpolated from the heights of the tracked rocks, clipped
10 m beyond them. Stops are last positions of the tracking. Three blocks were released repeatedly:
the unit of resampling is the run, not the block.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from field_cases import tables
from field_cases.study import study

from sassgis.model.errors import SassgisError

FOLDER = "tschamut2014"
XY = ["x_m", "y_m"]
BLOCKS = {1: "St. Leonard", 2: "heaviest", 4: "plate"}
#: Release places, by the least x of each; within one, positions scatter by a metre.
PLACES_M = (0.0, 17.5, 25.0, 32.0, 45.0)
#: The terrain is known this far beyond the tracks (m); further out it is an extrapolated plane.
BEYOND_M = 10.0
CONFIG = """[project]
name = "Tschamut 2014"

[terrain]
dem = "dem.tif"
crs = "local"
path = "fall_line"
energy_line_angle_deg = 10.0
[release]
file = "release.gpkg"
name_field = "name"
rocks_per_point = 50
[ground]
default = "soft_meadow"
[engine]
readings = "1986"
[[blocks]]
name = "Tschamut"
axis_1_m = [0.185, 0.25]
axis_2_m = [0.15, 0.195]
axis_3_m = [0.10, 0.16]
density_kgm3 = [2579, 3010]
"""


def write(data: Path, out: Path) -> tables.FieldCase:
    """Write the case: each rock in the tables is one run."""
    release = pd.read_csv(tables.field_file(data, FOLDER, "release_points.csv"))
    stops = pd.read_csv(tables.field_file(data, FOLDER, "observed_deposition.csv"))
    sizes = pd.read_csv(tables.field_file(data, FOLDER, "block_metadata.csv")).set_index("block_id")
    runs = release.merge(stops, on="trajectory_id", suffixes=("", "_stop"), validate="1:1")
    same = runs.duplicated(["x_m", "y_m", "x_m_stop", "y_m_stop"])
    copies = runs.loc[same, "trajectory_id"].tolist()
    runs = runs[~same]
    axes = np.sort(sizes[["size_x_m", "size_y_m", "size_z_m"]].to_numpy() / 2.0, axis=1)[:, ::-1]
    half = pd.DataFrame(axes, index=sizes.index).loc[runs["block_id"]].to_numpy()
    place = np.searchsorted(PLACES_M, runs["x_m"]) - 1
    away = (runs[XY] - runs.groupby(place)[XY].transform("mean")).to_numpy()
    scatter = float(np.sqrt((away**2).sum() / (2 * (len(runs) - len(PLACES_M)))))
    ids, block = runs["trajectory_id"], runs["block_id"].map(BLOCKS)
    mass = runs["mass_kg"]
    rocks = pd.DataFrame({"rock_id": ids, "x": runs["x_m"], "y": runs["y_m"], "mass_kg": mass})
    rocks[["semi_axis_a_m", "semi_axis_b_m", "semi_axis_c_m"]] = half
    rocks["density_kgm3"] = mass / (4.0 / 3.0 * np.pi * half.prod(axis=1))
    deposits = pd.DataFrame(
        {"rock_id": ids, "x": runs["x_m_stop"], "y": runs["y_m_stop"], "mass_kg": mass}
    )
    points = runs[XY].to_numpy()
    ends = np.vstack([points, runs[["x_m_stop", "y_m_stop"]].to_numpy()])
    tracks = shapely.MultiPoint(ends).convex_hull.buffer(BEYOND_M)
    tables.write_dem(tables.field_file(data, FOLDER, "terrain.asc"), out / "dem.tif", tracks)
    areas = {
        f"place {i + 1}": shapely.MultiPoint(points[place == i]).convex_hull.buffer(0.5)
        for i in range(len(PLACES_M))
    }
    tables.write_areas(out / "release.gpkg", areas, None)
    runs.assign(rock_id=ids, block=block)[["rock_id", "block"]].to_csv(out / "groups.csv")
    plate = (runs["block_id"] == 4).to_numpy()
    splits = {
        "halves": tables.split_in_two(dict(zip(ids, block, strict=True))),
        "plate": (ids[~plate].tolist(), ids[plate].tolist()),
    }
    notes = [
        f"{len(release)} runs; left out as exact copies of another run: {copies}",
        f"{block.value_counts().to_dict()} runs of each block",
        f"positions at a release place scatter by {scatter:.2f} m: stated as position_error_m",
        "heights are taken from the terrain and release speeds are first samples: not used",
        "density: the weighed mass over the volume of the ellipsoid of the measured axes",
        "ground by expert judgement: soft_meadow everywhere (not in the data)",
    ]
    meta = {"position_error_m": round(scatter, 2)}
    seen = {"rocks": rocks, "deposits": deposits}
    return tables.write_case("tschamut", out, CONFIG, seen, meta, splits, notes)


def main(argv: list[str] | None = None) -> None:
    """Write the case, diagnose it on one half and score on the other."""
    given = tables.parser(__doc__).parse_args(argv)
    case = write(given.data, tables.fresh(given.output))
    groups = pd.read_csv(given.output / "groups.csv")
    study(case, given, dict(zip(groups["rock_id"], groups["block"], strict=True)))


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
