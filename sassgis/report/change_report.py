"""Report of what changes from one result to another: the change first, then what differs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sassgis.hazard.result_change import (
    LEVEL,
    REACH,
    ChangeRow,
    ResultChange,
    compared_maps,
    difference,
    limits_text,
)
from sassgis.hazard.stored_result import StoredResult
from sassgis.model.grid import FloatArray
from sassgis.model.languages import joined, named, phrase, translated
from sassgis.report import figures
from sassgis.report.page import (
    Cell,
    ReportAnswer,
    ReportContext,
    ReportFigure,
    ReportTable,
    sensible,
    table_of,
)
from sassgis.report.pictures import picture

_RAMPS = {"reach_probability": "plasma_r", "energy": "YlOrRd", "passing_height": "YlGnBu"}
_NOTHING = "Cells that no block reaches count as zero."
_KINDS = {"program": "version of sassgis"}
_UNITS = {"m2": "m²"}
_SEVERAL = {"setting": "settings", "input": "inputs"}
#: What is said of a change by its sign.
_AREA = {
    1: "Blocks reach {} m² more",
    0: "Blocks reach as much ground as before",
    -1: "Blocks reach {} m² less",
}
_RUNOUT = {
    1: "95 % of the blocks stop within a run-out that is {} m longer",
    0: "95 % of the blocks stop within a run-out that is the same",
    -1: "95 % of the blocks stop within a run-out that is {} m shorter",
}


def change_figures(
    before: StoredResult, after: StoredResult, folder: Path, *, levels: bool
) -> tuple[ReportFigure, ...]:
    """Draw the maps before and after, on the same cells, and their difference into a folder.

    ``levels`` says whether the levels can be compared.
    """
    grid = after.grid
    out: list[ReportFigure] = []

    def add(name: str, title: str, caption: str, figure: Figure, moved: FloatArray) -> None:
        higher, lower = ((s * moved > 0.0).sum() * grid.cell_size**2 for s in (1.0, -1.0))
        text = "Three maps: before, after, and the change. Higher on {} m², lower on {} m²."
        alt = phrase(text, sensible(float(higher)), sensible(float(lower)))
        out.append(picture(folder, f"{name}_change", title, caption, figure, alt))

    if levels:
        old_level, new_level = before.maps[LEVEL], after.maps[LEVEL]
        title = "Hazard level before and after"
        figure = figures.change_figure(
            grid, old_level, new_level,
            figures.MapMarks(after.release, control_lines=after.traces),
            names=("Before", "After"), title=title,
        )  # fmt: skip
        moved = difference(before.band(LEVEL, "level"), after.band(LEVEL, "level"))
        caption = "Levels of the cells, before they are drawn as zones."
        add("hazard_level", title, caption, figure, moved)
    for compared in compared_maps(before, after):
        old, new = (r.band(compared.stem, compared.band) for r in (before, after))
        title = phrase("{}, before and after", phrase(compared.title))
        moved = difference(old, new)
        figure = figures.map_change_figure(
            grid, old, new, moved, figures.MapMarks(after.release),
            unit="" if compared.unit == "1" else compared.unit, ramp=_RAMPS[compared.stem],
            title=title, note=_NOTHING,
        )  # fmt: skip
        caption = phrase(_NOTHING)
        if compared is REACH:
            width = phrase("Width {} m (one cell).", f"{grid.cell_size:.4g}")
            caption = joined(" ", (caption, width))
        add(compared.stem, title, caption, figure, moved)
    return tuple(out)


def change_report(
    before: StoredResult,
    after: StoredResult,
    change: ResultChange,
    pictures: Sequence[ReportFigure],
    facts: Mapping[str, Cell],
) -> ReportContext:
    """Put the report together; ``facts`` say where the numbers come from."""
    differ = table_of(
        "What differs between the two",
        "kind; what; before; after",
        (
            (_KINDS.get(d.kind, d.kind), *map(named, (d.name, d.before or "–", d.after or "–")))
            for d in change.differences
        ),
        "From the two manifests. Inputs are compared by their content, not by their name.",
    )
    text = (
        "Nowhere does the reach probability change by more than the sampling of the blocks "
        "explains: another seed changes as much."
    )
    if change.certain_m2 > 0.0:
        text = (
            "On {} m² the reach probability changes by more than the sampling of the blocks "
            "explains; of this area 5 % at most are to be expected by chance (false discovery "
            "rate, the two samples taken as independent)."
        )
    sure = (
        phrase(text, sensible(change.certain_m2)),
        "With the same seed and release points the samples are alike, and smaller changes are "
        "real as well. Errors of the model, its parameters and the onset frequencies are not "
        "included.",
    )
    found = (r.manifest["settings"].get("project", {}).get("name", "") for r in (before, after))
    names = list(dict.fromkeys(str(n) for n in found if n))
    both = phrase("{} and {}", *names) if len(names) == 2 else "".join(names)
    levels: dict[float, str] = {0.0: "none"}
    if LEVEL in after.maps:
        levels |= {c.value: c.label for c in after.maps[LEVEL].classes}
    objects = _at_places(
        "At exposed objects",
        change.of("object"),
        levels,
        "0 where no block arrives. Energy and passing height with limits by the sampling: of all "
        "blocks that reach the object, of a road at the stretch with the largest; the others, and "
        "those without limits, are the largest over the cells of an object, a road as a whole. "
        "Deaths and loss are sums over the object.",
    )
    return ReportContext(
        title=translated(phrase("{}: before and after", both)),
        subtitle="What changes from one result to the other",
        what_was_run=tuple(
            (phrase("{}: {}", phrase(name), phrase(fact)), text)
            for name, result in (("Before", before), ("After", after))
            for fact, text in _facts(result)
        ),
        warnings=change.notes,
        verdict=verdict(change),
        answer=(ReportAnswer("How sure this is", sure), _differ(change)),
        key_results=_key_table(change),
        figures=tuple(pictures),
        tables=(
            _at_places("At stations and barriers", change.of("control line"), levels),
            objects,
            differ,
        ),
        provenance=tuple(facts.items()),
    )


def _facts(result: StoredResult) -> list[tuple[str, Cell]]:
    manifest = result.manifest
    facts: list[tuple[str, Cell]] = [
        ("folder", named(result.folder.name)),
        ("program", phrase("sassgis {}, seed {}", manifest["sassgis"], manifest["seed"])),
        # A mosaic of several blocks counts those of its areas alone.
        (
            "simulated blocks",
            manifest["counts"].get("rocks_simulated", manifest["counts"]["rocks"]),
        ),
    ]
    if manifest["preset"]:
        width = manifest["ref_widths_m"].get("hazard")
        facts.append(("preset, reference width", f"{manifest['preset']}, {width:g} m"))
    return facts


def verdict(change: ResultChange) -> str:
    """What changes, in a few sentences."""
    if all(_same(row) for row in change.rows) and not change.higher_m2 and not change.lower_m2:
        return "Nothing changes: the two results agree in every number that is compared."
    area = change.row("map", "area reached")
    text = _AREA[int(np.sign(area.change))]
    reach = phrase(text, sensible(abs(area.change)))
    if area.before and area.change:
        reach = phrase("{} ({} %)", reach, sensible(100.0 * area.change / area.before, 2))
    sentences = [reach]
    if math.isfinite(change.higher_m2):
        text = "The hazard level is higher on {} m² and lower on {} m²"
        sentences.append(phrase(text, *map(sensible, (change.higher_m2, change.lower_m2))))
    runout = [r for r in change.of("run-out") if r.quantity == "run-out, 95 % quantile"]
    if runout and math.isfinite(runout[0].change):
        text = _RUNOUT[int(np.sign(runout[0].change))]
        sentences.append(phrase(text, sensible(abs(runout[0].change))))
    return phrase("{}.", joined(". ", sentences))


def _same(row: ChangeRow) -> bool:
    # "Reached by one only" counts each by itself.
    if row.quantity == "area reached by one of them only":
        return row.before == row.after == 0.0
    return row.before == row.after or (math.isnan(row.before) and math.isnan(row.after))


def _differ(change: ResultChange) -> ReportAnswer:
    heading = "What differs between the two"
    if not change.differences:
        return ReportAnswer(heading, ("Program, settings, inputs and libraries are the same.",))
    kinds: dict[str, list[str]] = {}
    for d in change.differences:
        kinds.setdefault(_KINDS.get(d.kind, d.kind), []).append(d.name)
    libraries = kinds.pop("library", None)
    points: list[str] = []
    for kind, names in kinds.items():
        word = kind if len(names) == 1 else _SEVERAL.get(kind, kind)
        points.append(phrase("{}: {}", phrase(word), ", ".join(names)))
    if libraries:
        points.append(phrase("versions of libraries: {}", ", ".join(libraries)))
    return ReportAnswer(heading, ("The table at the end has the values.",), tuple(points))


def _key_table(change: ResultChange) -> ReportTable:
    rows = [r for part in ("map", "zones", "run-out") for r in change.of(part)]
    return table_of(
        "Before and after",
        "quantity; unit; before; after; change",
        (
            (
                phrase("{}: {}", phrase(r.quantity), r.name) if r.name else r.quantity,
                _UNITS.get(r.unit, r.unit), r.before, r.after,
                None if r.quantity.endswith("them only") else r.change,
            )
            for r in rows
        ),
        "Areas are those of cells, and of zones as they are drawn. Run-out: chainage of the stops "
        "that the results keep, fragments and entrained blocks left out.",
    )  # fmt: skip


def _at_places(
    title: str, rows: Sequence[ChangeRow], levels: Mapping[float, str], note: str = ""
) -> ReportTable:
    """A row for each place, two columns for each quantity; levels by their names."""
    quantities = {r.quantity: _UNITS.get(r.unit, r.unit) for r in rows}
    found = {(r.name, r.quantity): r for r in rows}
    columns: list[tuple[str, str]] = [("name", "")]
    for quantity, unit in quantities.items():
        shown = "" if unit in ("1", "class") else unit
        columns += [(phrase("{}, before", phrase(quantity)), shown), ("after", shown)]

    def both(row: ChangeRow | None) -> tuple[Cell, Cell]:
        if row is None:
            return None, None
        if row.quantity == "hazard level":
            return levels[row.before], levels[row.after]
        return _with_limits(row.before, row.limits[0]), _with_limits(row.after, row.limits[1])

    body = (
        (named(name), *(cell for q in quantities for cell in both(found.get((name, q)))))
        for name in dict.fromkeys(r.name for r in rows)
    )
    return table_of(title, columns, body, note)


def _with_limits(value: float, limits: tuple[float, ...]) -> Cell:
    """A value with its limits if they are known."""
    text = limits_text(limits, sensible)
    return phrase("{}{}", sensible(value), text) if text else value
