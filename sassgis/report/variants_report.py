"""Report on other values of the ground classes: a sensitivity, and their spread."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sassgis.report.figures import MapMarks
from sassgis.report.map_report import release_outlines
from sassgis.report.page import ReportContext, ReportTable, sensible, table_of
from sassgis.report.pictures import map_pictures
from sassgis.report.run_summary import Lines
from sassgis.settings.labels import ground_name
from sassgis.settings.languages import joined, phrase
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import RasterLayer
from sassgis.studies import variants


def sensitivity_report(
    title: str,
    run: MapRun,
    effects: Sequence[variants.RangeEffect],
    maps: variants.CellMaps,
    layers: Sequence[RasterLayer],
    samples: int,
    blocks: int,
    levels: bool,
    folder: Path,
) -> ReportContext:
    """Draw the figures into ``folder`` and put the report together."""
    runout = sorted((e for e in effects if e.measure == variants.FARTHER), key=_rank)
    return ReportContext(
        title=title,
        subtitle="How results change within the ranges of the ground classes",
        what_was_run=(
            ("Ranges", len(runout)),
            ("Simulations of all ranges at once", samples),
            ("Blocks in each simulation", blocks),
            ("Reference width of the hazard", f"{run.ref_width_m:.4g} m" if levels else "–"),
        ),
        verdict=_verdict(runout, maps, levels),
        key_results=_key_table(
            runout, {e.range: e for e in effects if e.measure == variants.ENERGY_RATIO}
        ),
        figures=map_pictures(folder, run.grid, layers, MapMarks(release_outlines(run))),
        tables=(
            _effect_table(
                [e for e in effects if e.measure not in (variants.FARTHER, variants.ENERGY_RATIO)]
            ),
        ),
    )


def _rank(effect: variants.RangeEffect) -> float:
    return -float(np.nan_to_num(effect.largest_change, nan=-1.0))


def _verdict(runout: Sequence[variants.RangeEffect], maps: variants.CellMaps, levels: bool) -> str:
    strong = [e.range.label for e in runout if e.beyond_chance]
    sentences = [phrase("No single range changes the run-out (95 %) beyond chance.")]
    if strong:
        sentences = [phrase("Run-out (95 %) answers most to {}.", strong[0])]
    if levels:
        _, bands = maps
        reached = bands["level_could_be"]["base"] > 0
        higher = bands["level_higher"]["higher"][reached] >= 0.1
        text = (
            "On {} % of the cells with a level, it is higher in a tenth of the simulations or more."
        )
        share = float(higher.mean()) if higher.size else 0.0
        sentences.append(phrase(text, f"{100 * share:.0f}"))
    return joined(" ", sentences)


def _key_table(
    runout: Sequence[variants.RangeEffect], energy: dict[object, variants.RangeEffect]
) -> ReportTable:
    note = (
        "Base {} m, with another seed {} m. Energy: median ratio over the cells that 20 or more "
        "blocks reach in both. Each range alone, all other values as in the class. Beyond chance: "
        "more than twice the change by another seed."
    )
    return table_of(
        "Which ranges change run-out and energy",
        "class; parameter; value; range; run-out 95 %, low end | m; run-out 95 %, "
        "high end | m; energy ratio, low end | 1; energy ratio, high end | 1; run-out beyond "
        "chance; range read in its source",
        (
            (
                ground_name(e.range.class_name), e.range.parameter, e.range.value,
                phrase("{} to {}", f"{e.range.low:.3g}", f"{e.range.high:.3g}"), e.low, e.high,
                energy[e.range].low, energy[e.range].high, "yes" if e.beyond_chance else "no",
                "yes" if e.range.verified else "no",
            )
            for e in runout
        ),
        phrase(note, f"{runout[0].base:.4g}", f"{runout[0].chance:.4g}"),
    )  # fmt: skip


def _effect_table(effects: Sequence[variants.RangeEffect]) -> ReportTable:
    """Tabulate the other measures' changes beyond chance, of each the largest first."""
    order = {measure: i for i, measure in enumerate(dict.fromkeys(e.measure for e in effects))}
    return table_of(
        "Sensitivity to the ground",
        "measure; unit; class; parameter; low end; high end; base; another seed; rank correlation",
        (
            (
                e.measure, "" if e.unit == "1" else e.unit,
                ground_name(e.range.class_name), e.range.parameter,
                e.low, e.high, e.base, e.chance, e.correlation,
            )
            for e in sorted(effects, key=lambda e: (order[e.measure], _rank(e)))
            if e.beyond_chance
        ),
        "Each range alone, where it changes more than by chance; all of them are in "
        "tables/effects.csv. Rank correlation: over the simulations of all ranges at once.",
    )  # fmt: skip


def spread_lines(spread: variants.GroundSpread) -> Lines:
    """State what the spread does to run-out and levels, and how well it is known."""
    median, far = spread.band(variants.MEDIAN), spread.band(variants.FAR)
    text = (
        "with the spread of the ground classes between sites, the 90 % run-out lies between {} "
        "and {} m and the median between {} and {} m (80 % of {} draws; with the class values {} "
        "and {} m)"
    )
    bounds = (f"{value:.0f}" for value in (far.low, far.high, median.low, median.high))
    own = (f"{value:.0f}" for value in (far.base, median.base))
    parts = [phrase(text, *bounds, spread.draws, *own)]
    if (areas := spread.areas) is not None:
        text = (
            "within the zoned area, the level may be higher on {} m² ({} %) and lower on {} m²; "
            "outside it, {} m² may have a level"
        )
        share = f"{100.0 * areas['higher'] / areas['zoned'] if areas['zoned'] else 0.0:.0f}"
        higher, *rest = (sensible(round(areas[n])) for n in ("higher", "lower", "beyond"))
        parts.append(phrase(text, higher, share, *rest))
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
    lines = (("Spread of the ground classes", parts), ("How well the spread is known", known))
    return tuple((name, joined("; ", said)) for name, said in lines if said)


def spread_table(spread: variants.GroundSpread) -> ReportTable:
    """Return all measures with their bands."""
    return table_of(
        "Spread of the ground classes",
        "measure; unit; values of the classes; 10 % of the draws below; median; 90 % below",
        ((b.measure, b.unit, b.base, b.low, b.middle, b.high) for b in spread.bands),
        phrase(
            "{} simulations of the same blocks with class values drawn from their spread between "
            "sites (tables/ground_spread.csv). Energy is 0 where no block arrives.",
            spread.draws,
        ),
    )
