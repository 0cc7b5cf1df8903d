"""Do impacts at Chant Sura follow the impact law, and does soft ground explain the rest?

    python pipelines/gap_chant_sura.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folder ``chant_sura_2020`` (A. Caviezel et al. 2020, Induced Rockfall Dataset #2,
EnviDat, doi 10.16904/envidat.174, WSL Data Policy; scars: A. Caviezel et al. 2019, Earth Surf.
Dynam. 7, 199; G. Lu et al. 2019, Landslides 16, 2353). Writes the configuration, the terrain (7.7 m
of it), the contacts that can be used, their one-step predictions, the diagnosis, ``results.json``.

There are no stops and no stations: the case covers single impacts only.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import shapely
from field_cases.contacts import read_contacts
from field_cases.impact_law import contact_study
from field_cases.scars import scar_study
from field_cases.study import study
from field_cases.tables import (
    FieldCase,
    field_file,
    fresh,
    in_one_line,
    parser,
    split_in_two,
    write_areas,
    write_case,
    write_dem,
)

FOLDER = "chant_sura_2020"
DEM = "terrain_rf16_contact_extended.asc"
CONFIG = """[project]
name = "Chant Sura"

[terrain]
dem = "dem.tif"
crs = "EPSG:2056"
vertical_datum = "LN02"
smoothing_m = 0.5
segment_tolerance_m = 0.05

[release]
file = "release.gpkg"
name_field = "name"
rocks_per_point = 50

[ground]
default = "soft_meadow"

[[blocks]]
name = "EOTA 221"
axis_1_m = [0.30, 0.465]
axis_2_m = [0.30, 0.465]
axis_3_m = [0.15, 0.235]
density_kgm3 = 2670
"""


def write(data: Path, out: Path) -> FieldCase:
    """Write the case: each rock in the tables is one run."""
    field_file(data, FOLDER, "observed_contact_events_extended.csv")
    folder = data / FOLDER
    contacts, rocks = read_contacts(folder)
    write_dem(field_file(data, FOLDER, DEM), out / "dem.tif")
    place = shapely.Point(*rocks[["x", "y"]].iloc[0]).buffer(0.2)
    write_areas(out / "release.gpkg", {"platform": place}, "EPSG:2056")
    contacts.to_csv(out / "contacts.csv", index=False)
    used = contacts[contacts["left_out"] == ""]
    impacts = used.drop(columns=["left_out", "above_ground_m"])
    why = contacts.loc[contacts["left_out"] != "", ["rock_id", "impact", "left_out"]]
    notes = [
        f"{len(contacts)} contacts of {len(rocks)} runs; {len(used)} can be used",
        *(f"left out: {w.rock_id} contact {w.impact}: {w.left_out}" for w in why.itertuples()),
        "flights are parabolas through two points, exact to g: no information on air drag, and no "
        "trajectories are written",
        "spin is measured in the axes of the rock: its size is known, its direction is not; it is "
        "assumed to be forward rolling",
        "normal of the ground: the plane through the terrain within 0.5 m of the contact",
        "ground by expert judgement: soft_meadow everywhere",
    ]
    meta = {"speed_error_rel": 0.1, "rotation_error_rel": 0.1, "position_error_m": 0.2}
    tables: dict[str, pd.DataFrame] = {"rocks": rocks, "impacts": impacts}
    with_contact = {r: "run" for r in rocks["rock_id"] if r in set(used["rock_id"])}
    return write_case(
        "chant_sura", out, CONFIG, tables, meta, {"halves": split_in_two(with_contact)}, notes
    )


def main(argv: list[str] | None = None) -> None:
    """Write the case, predict each contact, diagnose."""
    given = parser(__doc__).parse_args(argv)
    case = write(given.data, fresh(given.output))
    folder = given.data / FOLDER
    more = {
        "contacts": contact_study(folder, given.output, given.seed),
        "scars": scar_study(folder, given.output, given.seed),
    }
    study(case, given, {}, more)


if __name__ == "__main__":
    in_one_line(main)
