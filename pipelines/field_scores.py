"""Are run-out and width of the stops right at Tschamut and Authume, on rocks left out as well?

    python pipelines/field_scores.py [DATA] -o OUT [--sets 256] [--count 12] [--overwrite]

Simulates the observed rocks from where they were released, each along the path that it takes:
with the built-in classes, chosen by the description of the site alone; with ``soft_meadow``
calibrated on one half of the rocks of one site or of both, and scored on the other halves and on
the other site. Adds single contacts at Chant Sura. Writes ``results.json`` and figures. The data of
Authume state no licence: no coordinates are written.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from field_cases import tables
from field_cases.contact_scores import contacts, grazing
from field_cases.figures import field_figure
from field_cases.held_out import by_group, held_out
from field_cases.scores import SOFT, design, score, tried
from field_cases.sites import Site, authume, run_out, simulated, table_of, tschamut
from field_cases.study import write_json

import sassgis
from sassgis.io.read.ground_map import built_in_table
from sassgis.model.errors import SassgisError
from sassgis.model.settings import EngineSettings
from sassgis.report.figures import save

#: Sideways tilts and drifts (degrees) whose widths are compared.
TILTS = (10.0, 15.0, 20.0, 25.0)
DRIFTS = (0.0, 3.0, 6.0)


def widths(sites: Mapping[str, Site], count: int) -> list[dict[str, Any]]:
    """Run-out and width against what turns the heading."""
    rows = []
    for tilt, drift in itertools.product(TILTS, DRIFTS):
        settings = EngineSettings(side_tilt_deg=tilt, drift_deg=drift)
        row: dict[str, Any] = {"side_tilt_deg": tilt, "drift_deg": drift}
        for name, site in sites.items():
            found = score(site, simulated(site, table_of(site), settings, count))
            row[name] = {"error": found["error"], "width_error": found["width_error"]}
        rows.append(row)
    return rows


def main(argv: list[str] | None = None) -> None:
    """Score, and write what was found."""
    parser = tables.parser(__doc__)
    parser.add_argument("--sets", type=int, default=256, help="parameter sets that are tried")
    parser.add_argument("--count", type=int, default=12, help="simulations of each rock and set")
    given = parser.parse_args(argv)
    out: Path = tables.fresh(given.output, given.overwrite)
    (out / "notes.txt").write_text("Written by field_scores.py\n", encoding="utf-8")
    sites = {site.name: site for site in (tschamut(given.data), authume(given.data))}
    settings = EngineSettings()
    now = {name: simulated(s, table_of(s), settings, 4 * given.count) for name, s in sites.items()}
    before = {
        name: simulated(
            s, table_of(s, readings="1986"), EngineSettings(readings="1986"), 4 * given.count
        )
        for name, s in sites.items()
    }
    sets = design(given.sets)
    made = {name: tried(site, sets, settings, given.count) for name, site in sites.items()}
    soft = built_in_table().classes[built_in_table().index(SOFT)]
    results = {
        "program": f"sassgis {sassgis.__version__}",
        "side_tilt_deg": settings.side_tilt_deg,
        "drift_deg": settings.drift_deg,
        "built_in": {name: score(s, now[name]) for name, s in sites.items()},
        "readings_1986_classes_of_then": {n: score(s, before[n]) for n, s in sites.items()},
        "by_group": by_group(sites, now),
        "calibrated": held_out(sites, sets, made),
        "widths": widths(sites, given.count),
        "contacts": contacts(given.data / "chant_sura_2020", soft),
        "grazing": grazing(given.data / "chant_sura_2020", soft),
    }
    write_json(out / "results.json", results)
    shown = {name: (run_out(s, s.stops), before[name], now[name]) for name, s in sites.items()}
    save(
        field_figure(
            {n: (o, run_out(sites[n], b.stops)[b.started], run_out(sites[n], w.stops)[w.started])
             for n, (o, b, w) in shown.items()}
        ),
        out / "stops.png",
    )  # fmt: skip
    print(f"Wrote {out / 'results.json'}")


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
