"""Are run-out and width of the stops right at Tschamut and Authume, on rocks left out as well?

    python pipelines/field_scores.py [DATA] -o OUT [--sets 256] [--count 16]

Simulates the observed rocks from where they were released, each along the path that it takes: with
the built-in classes, chosen by the description of the site alone; with the class that was
calibrated at the other site; with the class of the slope calibrated on random halves of the rocks,
and scored on the other halves and at the other site. Adds single contacts at Chant Sura. Writes
``results.json`` and a figure. The data of Authume state no licence: no coordinates are written.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from field_cases import tables
from field_cases.contact_scores import contacts, grazing
from field_cases.figures import field_figure
from field_cases.held_out import by_group, held_out, ranges, with_class_of
from field_cases.scores import design, score, tried, widths
from field_cases.sites import (
    TOLERANCE_M,
    Simulated,
    Site,
    authume,
    run_out,
    simulated,
    table_of,
    tschamut,
)
from field_cases.study import write_json

import sassgis
from sassgis.model.errors import SassgisError
from sassgis.model.settings import EngineSettings
from sassgis.report.figures import save


def published(data: Path) -> list[dict[str, str]]:
    """Scores of other open codes on the same data."""
    rows = pd.read_csv(tables.field_file(data, ".", "published_field_numbers.csv"), dtype=str)
    own = rows[rows["quantity"].str.contains("simulator")]
    return own[["site", "quantity", "value", "unit", "source"]].to_dict("records")


def main(argv: list[str] | None = None) -> None:
    """Score, and write what was found."""
    parser = tables.parser(__doc__)
    parser.add_argument("--sets", type=int, default=256, help="parameter sets that are tried")
    parser.add_argument("--count", type=int, default=16, help="simulations of each rock and set")
    given = parser.parse_args(argv)
    out: Path = tables.fresh(given.output)
    (out / "notes.txt").write_text("Written by field_scores.py\n", encoding="utf-8")
    meadow, quarry = tschamut(given.data), authume(given.data)
    sites = {site.name: site for site in (meadow, quarry)}
    others = {
        meadow.name: with_class_of(meadow, quarry), quarry.name: with_class_of(quarry, meadow)
    }  # fmt: skip
    settings, many = EngineSettings(), 6 * given.count

    def of(some: Mapping[str, Site], readings: str = "hazard") -> dict[str, Simulated]:
        engine = EngineSettings(readings=readings)  # type: ignore[arg-type]
        return {
            n: simulated(s, table_of(s, readings=readings), engine, many) for n, s in some.items()
        }

    now, before, strange = of(sites), of(sites, "1986"), of(others)
    sets = design(given.sets)
    made = {name: tried(site, sets, settings, given.count) for name, site in sites.items()}
    soft = table_of(meadow).classes[0]
    chant_sura = given.data / "chant_sura_2020"
    results = {
        "program": f"sassgis {sassgis.__version__}",
        "side_tilt_deg": settings.side_tilt_deg,
        "drift_deg": settings.drift_deg,
        "segment_tolerance_m": TOLERANCE_M,
        "classes": {name: site.classes for name, site in sites.items()},
        "built_in": {name: score(s, now[name]) for name, s in sites.items()},
        "class_of_the_other_site": {name: score(s, strange[name]) for name, s in others.items()},
        "readings_and_classes_1986": {name: score(s, before[name]) for name, s in sites.items()},
        "by_group": by_group(sites, now),
        "published": published(given.data),
        "held_out": held_out(sites, sets, made),
        "ranges": {s.classes[0]: ranges(s, settings, given.count) for s in sites.values()},
        "widths": widths(sites, 2 * given.count),
        "contacts": contacts(chant_sura, soft),
        "grazing": grazing(chant_sura, soft),
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
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
