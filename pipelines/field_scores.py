"""Are run-out and width of the stops right at Tschamut and Authume, on rocks left out as well?

    python pipelines/field_scores.py [DATA] -o OUT [--count 96] [--halves 5] [--draws N] [--jobs 2]

Writes each site as a user would (configuration, release, observations) and runs ``sassgis run``
with the built-in classes, chosen by the description of the site alone; with the class of the other
site; with the readings and classes of 1986; and with what ``sassgis calibrate`` recommends after it
saw a random half of the rocks, scored on the other half and at the other site. Writes
``results.json`` and a figure. The data of Authume state no licence: these two hold no coordinates;
what is in ``OUT/work`` must not be passed on.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from field_cases import tables
from field_cases.figures import field_figure
from field_cases.held_out import held_out, parameters
from field_cases.scores import by_group, by_mass, repeated, score, site_bands, widths
from field_cases.sites import Simulated, Site, authume, run_out, simulated, tschamut
from field_cases.tables import write_json

import sassgis
from sassgis.report.figures import save
from sassgis.runs.calibrate import calibrate
from sassgis.settings.settings import EngineSettings, TerrainSettings


def published(data: Path) -> list[dict[str, str]]:
    """Scores of other open codes on the same data."""
    rows = pd.read_csv(tables.field_file(data, ".", "published_field_numbers.csv"), dtype=str)
    own = rows[rows["quantity"].str.contains("simulator")]
    return own[["site", "quantity", "value", "unit", "source"]].to_dict("records")


def main(argv: list[str] | None = None) -> None:
    """Run, score, and write what was found."""
    parser = tables.parser(__doc__)
    parser.add_argument("--count", type=int, default=96, help="simulations of each rock")
    parser.add_argument("--halves", type=int, default=5, help="random halves calibrated on")
    parser.add_argument("--draws", type=int, help="as of sassgis calibrate")
    given = parser.parse_args(argv)
    out: Path = tables.fresh(given.output)
    work = out / "work"

    def run(site: Site, name: str, settings: Mapping[str, Any] | None = None) -> Simulated:
        return simulated(site, work / f"{site.name}_{name}", given.count, settings)

    writers = {"Tschamut": tschamut, "Authume": authume}
    sites = {
        name: write(given.data, tables.fresh(work / f"{name}_site"), divisions=given.halves)
        for name, write in writers.items()
    }
    slope = {name: site.slope for name, site in sites.items()}
    foreign = dict(zip(slope, reversed(slope.values()), strict=True))
    others = {
        name: write(given.data, tables.fresh(work / f"{name}_with_other"), foreign[name])
        for name, write in writers.items()
    }
    elsewhere = dict(zip(slope, reversed(others.values()), strict=True))
    now = {name: run(site, "built_in") for name, site in sites.items()}
    strange = {name: run(site, "other_class") for name, site in others.items()}
    paper = {"engine.readings": "1986"}
    before = {name: run(site, "1986", paper) for name, site in sites.items()}
    all_rocks = {
        name: calibrate(
            [s.case.pair("all")], work / f"{name}_calibrated", jobs=given.jobs, draws=given.draws
        )
        for name, s in sites.items()
    }
    settings = EngineSettings()
    results = {
        "program": f"sassgis {sassgis.__version__}",
        "side_tilt_deg": settings.side_tilt_deg,
        "drift_deg": settings.drift_deg,
        "segment_tolerance_m": TerrainSettings().segment_tolerance_m,
        "simulations_of_each_rock": given.count,
        "classes": slope,
        "built_in": {name: score(s, now[name]) for name, s in sites.items()},
        "class_of_the_other_site": {name: score(s, strange[name]) for name, s in others.items()},
        "bands_of_classes": {
            kind: {
                n: site_bands(s, m[n], work / f"{n}_{kind}_bands", given.jobs)
                for n, s in of.items()
            }
            for kind, of, m in (("own", sites, now), ("other", others, strange))
        },
        "readings_and_classes_1986": {name: score(s, before[name]) for name, s in sites.items()},
        "by_group": {k: v for n, s in sites.items() for k, v in by_group(s, now[n]).items()},
        "by_mass": {name: by_mass(s, now[name]) for name, s in sites.items()},
        "repeated": {k: v for n, s in sites.items() for k, v in repeated(s, now[n]).items()},
        "published": published(given.data),
        "held_out": {
            name: held_out(
                s, now[name], elsewhere[name], work, given.count, given.jobs, given.draws
            )
            for name, s in sites.items()
        },
        "parameters": parameters(all_rocks),
        "widths": widths(sites, run),
    }
    write_json(out / "results.json", results)
    shown = {
        n: tuple(run_out(s, m[n].stops)[m[n].started] for m in (before, now))
        for n, s in sites.items()
    }
    figure = field_figure({n: (run_out(s, s.stops), *shown[n]) for n, s in sites.items()})
    save(figure, out / "stops.png")
    print(f"Wrote {out / 'results.json'}")


if __name__ == "__main__":
    tables.in_one_line(main)
