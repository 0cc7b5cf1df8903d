"""Reports on changes: from one result to another, and with other ground classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

import sassgis
from sassgis.grid import FloatArray
from sassgis.report import figures
from sassgis.report.figures import MapMarks
from sassgis.report.map_report import Lines, release_outlines
from sassgis.report.page import (
    Cell,
    ReportAnswer,
    ReportContext,
    ReportFigure,
    ReportTable,
    sensible,
    table_of,
)
from sassgis.report.pictures import map_pictures, picture
from sassgis.settings.languages import joined, named, phrase, translated
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import RasterLayer, ground_name
from sassgis.studies import result_change, variants
from sassgis.studies.stored_result import StoredResult, is_one_line

_RAMPS = {"reach_probability": "plasma_r", "energy": "YlOrRd", "passing_height": "YlGnBu"}
_NOTHING = "Cells that no block reaches count as zero."
_UNITS = {"m2": "m²"}
#: Plural of the kinds that differ.
_SEVERAL = {
    "program": "version of sassgis",
    "setting": "settings",
    "input": "inputs",
    "library": "versions of libraries",
}


def _lines_of_both(
    before: StoredResult, after: StoredResult
) -> tuple[tuple[str, str, FloatArray], ...]:
    """Return stations and barriers of two results; those at one place once, by the later name."""
    now = [trace for *_, trace in after.traces]
    gone = (own for own in before.traces if not any(is_one_line(own[-1], t) for t in now))
    return (*after.traces, *gone)


def change_figures(
    before: StoredResult, after: StoredResult, folder: Path, *, levels: bool
) -> tuple[ReportFigure, ...]:
    """Draw the maps before and after with their difference; ``levels`` if comparable."""
    grid = after.grid
    out = []
    for compared in (
        *([result_change.LEVEL] if levels else []),
        *result_change.compared_maps(before, after),
    ):
        old, new = (r.band(*compared[:2]) for r in (before, after))
        moved = result_change.difference(old, new)
        if compared is result_change.LEVEL:
            title = "Hazard level before and after"
            caption = (
                "Levels of the cells, before they are drawn as zones. Stations and barriers are "
                "those of both results."
            )
            figure = partial(
                figures.change_figure, grid,
                before.maps[result_change.LEVEL.stem], after.maps[result_change.LEVEL.stem],
                MapMarks(after.release, control_lines=_lines_of_both(before, after)),
                names=("Before", "After"), title=title,
            )  # fmt: skip
        else:
            title = phrase("{}, before and after", phrase(compared.title))
            caption = phrase(_NOTHING)
            figure = partial(
                figures.map_change_figure, grid, old, new, moved, MapMarks(after.release),
                unit="" if compared.unit == "1" else compared.unit, ramp=_RAMPS[compared.stem],
                title=title,
            )  # fmt: skip
        if compared is result_change.REACH:
            width = phrase("Width {} m (one cell).", f"{grid.cell_size:.4g}")
            caption = joined(" ", (caption, width))
        areas = (float((s * moved > 0.0).sum() * grid.cell_size**2) for s in (1.0, -1.0))
        text = "Three maps: before, after, and the change. Higher on {} m², lower on {} m²."
        alt = phrase(text, *map(sensible, areas))
        out.append(picture(folder, f"{compared.stem}_change", title, caption, figure, alt))
    return tuple(out)


def change_report(
    before: StoredResult,
    after: StoredResult,
    change: result_change.ResultChange,
    pictures: Sequence[ReportFigure],
) -> ReportContext:
    """Put the report together."""
    kinds = (("version of sassgis" if d.kind == "program" else d.kind) for d in change.differences)
    values = ((d.name, d.before or "–", d.after or "–") for d in change.differences)
    differ = table_of(
        "Differences in program, settings and inputs",
        "kind; what; before; after",
        ((kind, *map(named, own)) for kind, own in zip(kinds, values, strict=True)),
        "From both manifests. Inputs are compared by content.",
    )
    chance = (
        "Chance explains at most 5 % of this area (false discovery rate for independent samples)."
    )
    sure = (
        change.beyond_sampling,
        *([chance] if change.certain_m2 > 0.0 else []),
        "Results with the same seed and release points share their sample. Smaller changes are "
        "then real as well. Errors of the model, its parameters and the onset frequencies are not "
        "included.",
    )
    found = (r.manifest["settings"].get("project", {}).get("name", "") for r in (before, after))
    names = list(dict.fromkeys(str(n) for n in found if n))
    both = phrase("{} and {}", *names) if len(names) == 2 else "".join(names)
    levels: dict[float, str] = {0.0: "none"}
    if result_change.LEVEL.stem in after.maps:
        levels |= {c.value: c.label for c in after.maps[result_change.LEVEL.stem].classes}
    note = (
        "0: no block arrives. Energies and passing heights with limits of the sampling error: "
        "all blocks that reach the object; on a road, the stretch with the highest energy. Values "
        "without limits: largest over the cells of the object. Deaths and loss: sums over the "
        "object."
    )
    return ReportContext(
        title=translated(phrase("{}: before and after", both)),
        subtitle="Changes between the two results",
        what_was_run=tuple(
            (phrase("{}: {}", phrase(name), phrase(fact)), text)
            for name, result in (("Before", before), ("After", after))
            for fact, text in _facts(result)
        ),
        warnings=change.notes,
        verdict=change.verdict,
        answer=(ReportAnswer("How sure this is", sure), _differ(change)),
        key_results=_key_table(change),
        figures=tuple(pictures),
        tables=(
            _at_places("At stations and barriers", change.of("control line"), levels),
            _at_places("At exposed objects", change.of("object"), levels, note),
            differ,
        ),
        provenance=(
            ("Program", f"sassgis {sassgis.__version__}"),
            ("Settings before (SHA-256)", str(before.manifest.get("settings_sha256", ""))),
            ("Settings after (SHA-256)", str(after.manifest.get("settings_sha256", ""))),
        ),
    )


def _facts(result: StoredResult) -> list[tuple[str, Cell]]:
    manifest = result.manifest
    counts = manifest["counts"]
    facts: list[tuple[str, Cell]] = [
        ("folder", named(result.folder.name)),
        ("program", phrase("sassgis {}, seed {}", manifest["sassgis"], manifest["seed"])),
        # A mosaic of several blocks counts only those of its areas.
        ("simulated blocks", counts.get("rocks_simulated", counts["rocks"])),
    ]
    if manifest["preset"]:
        width = manifest["ref_widths_m"].get("hazard")
        facts.append(("preset, reference width", f"{manifest['preset']}, {width:g} m"))
    return facts


def _differ(change: result_change.ResultChange) -> ReportAnswer:
    heading = "Differences in program, settings and inputs"
    if not change.differences:
        return ReportAnswer(heading, ("Program, settings, inputs and libraries are the same.",))
    kinds: dict[str, list[str]] = {}
    for d in change.differences:
        kinds.setdefault(_SEVERAL.get(d.kind, d.kind), []).append(d.name)
    points = tuple(phrase("{}: {}", phrase(kind), ", ".join(own)) for kind, own in kinds.items())
    return ReportAnswer(heading, ("The table at the end has the values.",), points)


def _key_table(change: result_change.ResultChange) -> ReportTable:
    rows = [r for part in ("map", "zones", "run-out") for r in change.of(part)]
    return table_of(
        "Before and after",
        "quantity; unit; before; after; change",
        (
            (
                phrase("{}: {}", phrase(r.quantity), r.name) if r.name else r.quantity,
                _UNITS.get(r.unit, r.unit), r.before, r.after,
                None if r.quantity == result_change.BY_ONE_ONLY else r.change,
            )
            for r in rows
        ),
        "Areas of cells, and of zones as drawn. Run-out: distances of the stored stops without "
        "fragments and entrained blocks.",
    )  # fmt: skip


def _at_places(
    title: str, rows: Sequence[result_change.ChangeRow], levels: Mapping[float, str], note: str = ""
) -> ReportTable:
    """Return a row for each place, two columns for each quantity; levels by their names."""
    quantities = {r.quantity: _UNITS.get(r.unit, r.unit) for r in rows}
    found = {(r.name, r.quantity): r for r in rows}
    columns: list[tuple[str, str]] = [("name", "")]
    for quantity, unit in quantities.items():
        shown = "" if unit in ("1", "class") else unit
        columns += [(phrase("{}, before", phrase(quantity)), shown), ("after", shown)]

    def cell(name: str, quantity: str, when: int) -> Cell:
        if (row := found.get((name, quantity))) is None:
            return None
        value = (row.before, row.after)[when]
        if quantity == "hazard level":
            return levels[value]
        limits = result_change.limits_text(row.limits[when], sensible)
        return phrase("{}{}", sensible(value), limits) if limits else value

    body = (
        (named(name), *(cell(name, q, when) for q in quantities for when in (0, 1)))
        for name in dict.fromkeys(r.name for r in rows)
    )
    return table_of(title, columns, body, note)


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
            ("Simulations that vary all ranges together", samples),
            ("Blocks in each simulation", blocks),
            ("Reference width of the hazard", f"{run.ref_width_m:.4g} m" if levels else "–"),
        ),
        verdict=_verdict(runout, maps, levels),
        key_results=_table_of_variants(
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
        sentences = [phrase("The run-out (95 %) is most sensitive to {}.", strong[0])]
    if levels:
        _, bands = maps
        reached = bands["level_could_be"]["base"] > 0
        higher = bands["level_higher"]["higher"][reached] >= 0.1
        text = (
            "On {} % of the cells with a level, at least a tenth of the simulations give a "
            "higher one."
        )
        share = float(higher.mean()) if higher.size else 0.0
        sentences.append(phrase(text, f"{100 * share:.0f}"))
    return joined(" ", sentences)


def _table_of_variants(
    runout: Sequence[variants.RangeEffect], energy: dict[object, variants.RangeEffect]
) -> ReportTable:
    note = (
        "Base {} m; with another seed {} m. Each range is varied by itself; all other values are "
        "those of the class. Energy: median ratio over the cells that 20 or more blocks reach in "
        "both runs. Beyond chance: more than twice the change with another seed."
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
        "Ranges varied by themselves that change results more than chance; tables/effects.csv "
        "lists all. Rank correlation: over the simulations that vary all ranges together.",
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
        known.append(phrase("only {} draws: bands need 10 or more", spread.draws))
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
