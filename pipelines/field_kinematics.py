"""Are rocks as fast, as high and as often on the ground as real ones?

    python pipelines/field_kinematics.py [DATA] -o OUT [--count 24] [--search 0] [--jobs 2]

Compares speeds, heights, contacts and spins at Tschamut with those of the built-in class, in all
rocks and in both halves; those of a block of 780 kg at Chant Sura with published ones, on a slope
as described; and says what blocks of several sizes do on slopes and fans. With ``--search N`` it
fits the soils to all sites, looking at N sets of values, once with all rocks of Tschamut and once
with half of them, and scores these on the other half. Writes ``results.json`` and a figure.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from field_cases import soil_fit, tables
from field_cases.contact_scores import filmed
from field_cases.figures import kinematics_figure
from field_cases.kinematics import (
    compared,
    fan,
    kinematics,
    observed,
    slopes,
    wheel_below_cliff,
)
from field_cases.sites import authume, tschamut
from field_cases.tables import write_json

import sassgis
from sassgis.report.figures import save
from sassgis.runs.calibrate import read_case

CLASSES = ("debris", "talus", "rock", "forest_soil", "soft_meadow")


def published(data: Path) -> list[dict[str, Any]]:
    """Speeds, spins and heights of the quantities that are compared."""
    rows = pd.read_csv(tables.field_file(data, ".", "published_kinematics.csv"), dtype=str)
    below = rows["site"].str.startswith("Chant Sura") & rows["site"].str.contains("region 2")
    kept = rows[below & rows["statistic"].str.startswith("median")]
    return kept[["quantity", "statistic", "value", "unit", "source"]].to_dict("records")


def main(argv: list[str] | None = None) -> None:
    """Simulate, compare, and write what was found."""
    parser = tables.parser(__doc__)
    parser.add_argument("--count", type=int, default=24, help="simulations of each rock")
    parser.add_argument("--search", type=int, default=0, help="sets of values of a fit")
    given = parser.parse_args(argv)
    out: Path = tables.fresh(given.output)
    site = tschamut(given.data, tables.fresh(out / "work" / "Tschamut"))
    everything = read_case(*site.case.pair("all"))
    fit, left = (read_case(*site.case.pair(side)) for side in site.case.splits["halves"])
    made = kinematics(everything, everything.table, given.count, given.seed)
    as_measured = {"outline_edges": 0.0, "outline_share": 1.0}
    boxes = kinematics(everything, everything.table, given.count, given.seed, as_measured)
    results: dict[str, Any] = {
        "program": f"sassgis {sassgis.__version__}",
        "simulations_of_each_rock": given.count,
        "rocks": everything.n_rocks,
        "tschamut": compared(observed(everything), made),
        "ellipses_of_boxes": compared(observed(everything), boxes),
        "half": {
            name: compared(observed(own), kinematics(own, own.table, given.count, given.seed))
            for name, own in (("fit", fit), ("left_out", left))
        },
        "chant_sura": wheel_below_cliff(given.seed),
        "published": published(given.data),
        "slopes": slopes(CLASSES, given.seed),
        "fan": fan(CLASSES, given.seed),
    }
    if given.search:
        quarry = authume(given.data, tables.fresh(out / "work" / "Authume"))
        slope, films = read_case(*quarry.case.pair("all")), filmed(given.data)
        values = [
            soil_fit.fitted(soil_fit.Sites(rocks, slope, films, seed=given.seed), given.search)
            for rocks in (everything, fit)
        ]
        table, engine = soil_fit.table_of(left.table, values[1]), soil_fit.engine_of(values[1])
        other = kinematics(left, table, given.count, given.seed, engine)
        results["fitted_to_all"] = values[0]
        results["fitted_to_a_half"] = {
            "values": values[1], "left_out": compared(observed(left), other)
        }  # fmt: skip
    write_json(out / "results.json", results)
    save(kinematics_figure(observed(everything), made), out / "kinematics.png")
    print(f"Wrote {out / 'results.json'}")


if __name__ == "__main__":
    tables.in_one_line(main)
