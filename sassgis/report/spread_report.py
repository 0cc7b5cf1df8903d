"""What a report says of the spread of ground classes between sites: lines, table, figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sassgis.hazard.ground_spread import GroundSpread
from sassgis.hazard.sensitivity import FAR, MEDIAN
from sassgis.model.languages import joined, phrase
from sassgis.model.map_run import MapRun
from sassgis.model.results import RasterLayer
from sassgis.report.figures.map_marks import MapObject
from sassgis.report.map_report import map_marks
from sassgis.report.page import ReportFigure, ReportTable, sensible, table_of
from sassgis.report.pictures import map_pictures
from sassgis.report.run_summary import Lines


def spread_lines(spread: GroundSpread) -> Lines:
    """What the spread does to run-out and levels, and how well it is known."""
    median, far = spread.band(MEDIAN), spread.band(FAR)
    parts = [
        phrase(
            "with the spread of the ground classes between sites the 90 % run-out lies between {} "
            "and {} m, the median between {} and {} m (80 % of {} draws; with their own values {} "
            "and {} m)",
            *(f"{value:.0f}" for value in (far.low, far.high, median.low, median.high)),
            spread.draws,
            *(f"{value:.0f}" for value in (far.base, median.base)),
        )
    ]
    if (areas := spread.areas) is not None:
        text = (
            "the level of {} m² ({} %) of the zoned area may be higher, of {} m² lower; {} m² "
            "beyond it may have one"
        )
        share = f"{100.0 * areas.higher / areas.zoned if areas.zoned else 0.0:.0f}"
        higher, *rest = (sensible(round(v)) for v in (areas.higher, areas.lower, areas.beyond))
        parts.append(phrase(text, higher, share, *rest))
    lines = [("Spread of the ground classes", joined("; ", parts))]
    known = []
    if not spread.ranges:
        known.append(phrase("none of the classes that blocks meet has a spread"))
    if spread.assumed or spread.weak:
        text = (
            "weakly supported: the spread of {} of {} drawn values is an assumption, that of {} "
            "rests on fewer than 3 sites"
        )
        known.append(phrase(text, spread.assumed, len(spread.ranges), spread.weak))
    if spread.few_draws:
        known.append(phrase("{} draws are few: 10 or more give a band", spread.draws))
    if known:
        lines.append(("How well the spread is known", joined("; ", known)))
    return tuple(lines)


def spread_table(spread: GroundSpread) -> ReportTable:
    """All measures with their bands."""
    return table_of(
        "Spread of the ground classes",
        "measure; unit; values of the classes; 10 % of the draws below; median; 90 % below",
        ((b.measure, b.unit, b.base, b.low, b.middle, b.high) for b in spread.bands),
        phrase(
            "{} simulations of the same blocks with values of the classes drawn from their spread "
            "between sites (tables/ground_spread.csv). An energy where no block arrives is 0.",
            spread.draws,
        ),
    )


def spread_figures(
    run: MapRun, layers: Sequence[RasterLayer], objects: Sequence[MapObject], folder: Path
) -> tuple[ReportFigure, ...]:
    """The maps, where they hold anything."""
    return map_pictures(folder, run.grid, layers, map_marks(run, objects))
