"""Design of protection on a page of its own: a sheet of A4 for each wall, net and station."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import shapely

from sassgis.hazard.control_lines import BEHIND
from sassgis.hazard.design import arrivals, net_classes
from sassgis.hazard.measured_motion import words_at_line
from sassgis.hazard.sources import Sampled
from sassgis.model.grid import FloatArray
from sassgis.model.languages import current_language, joined, named, phrase, translated
from sassgis.model.results import ControlLine
from sassgis.report import figures
from sassgis.report.exposed_report import limited
from sassgis.report.page import (
    Cell,
    ReportFigure,
    ReportTable,
    sensible,
    table_of,
    template,
    translated_table,
)
from sassgis.report.pictures import picture

PAGE_NAME = "protection.html"
#: Share of the blocks of a line that a place upslope must see to be compared with it.
_ENOUGH = 0.95


@dataclass(frozen=True, slots=True)
class ProtectionSheet:
    """What the sheet of a line says."""

    title: str
    facts: tuple[tuple[str, str], ...]
    table: ReportTable
    figure: ReportFigure = field(repr=False)
    built: bool = True


def protection_sheets(
    lines: Sequence[tuple[ControlLine, FloatArray]],
    without_barriers: Sequence[Sampled],
    with_barriers: Sequence[Sampled],
    frames: tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame],
    given: tuple[tuple[str, str], ...],
    folder: Path,
    confidence: float,
) -> tuple[ProtectionSheet, ...]:
    """The sheets of all lines; their figures go into a folder.

    The frames are those of ``tables/design.csv``, ``protection.csv`` and ``protection_places.csv``;
    ``given`` is what the values rest on, the same on all sheets.
    """
    design, protection, places = frames
    sheets = []
    for i, (line, trace) in enumerate(lines):
        own = protection[protection["line"] == line.name]
        along = places[places["line"] == line.name].dropna(subset=["energy_q95_kj"])
        built = line.kind != "station"
        drawn = figures.protection_figure(
            along,
            arrivals(without_barriers, i, "energy_kj"),
            arrivals(with_barriers, i, BEHIND) if built else None,
            list(own["return_period_years"]),
            capacity_kj=line.capacity_kj,
            confidence=confidence,
        )
        caption = phrase(
            "Left: energies at the line by frequency, with limits of {} %. Right: the line moved "
            "along the slope; 95 % energy and passing height, and the share of the released "
            "blocks that comes so far.", f"{100 * confidence:g}",
        )  # fmt: skip
        if len(along) < 2:
            text = "Energies at the line by frequency, with limits of {} %."
            caption = phrase(text, f"{100 * confidence:g}")
        title = "What arrives, and what is left" if built else "What arrives"
        sheets.append(
            ProtectionSheet(
                line.described,
                (
                    *_facts(line, trace, design.iloc[i], own, along),
                    *_beyond(words_at_line(without_barriers, i)),
                    *given,
                ),
                _table(design.iloc[i], own, built),
                picture(folder, f"protection_{i + 1}", title, caption, drawn),
                built,
            )
        )
    return tuple(sheets)


def _facts(
    line: ControlLine,
    trace: FloatArray,
    arriving: pd.Series,
    protection: pd.DataFrame,
    along: pd.DataFrame,
) -> tuple[tuple[str, str], ...]:
    """Where it stands, what comes, what is left, where it would stand better."""
    here = along[along["moved_m"] == 0.0]
    length = f"{shapely.LineString(trace).length:.0f}"
    where = phrase("{} m long", length)
    if len(here):
        height = f"{here['ground_m'].iloc[0]:.0f}"
        where = phrase("{} m long, ground at {} m on average", length, height)
    come = phrase(
        "{} a year ({} simulated blocks)",
        sensible(float(arriving["arrivals_per_year"])), sensible(int(arriving["rocks"])),
    )  # fmt: skip
    facts = [("Line", where), ("Blocks that arrive, without walls and nets", come)]
    if line.kind != "station":
        stated = [phrase("{} m high", f"{line.height_m:g}")]
        if np.isfinite(line.capacity_kj):
            stated.append(phrase("{} kJ capacity", f"{line.capacity_kj:g}"))
        facts.append(("As drawn", joined(", ", stated)))
        left = phrase("{} a year", sensible(float(protection["behind_per_year"].iloc[0])))
        facts.append(("Blocks that go on behind it", left))
    best = best_places(along)
    if best is not None:
        least = [
            phrase("{} ({} {})", _moved(row["moved_m"]), sensible(float(row[key])), unit)
            for row, key, unit in zip(
                best, ("energy_q95_kj", "height_q95_m"), ("kJ", "m"), strict=True
            )
        ]
        facts.append(
            ("Best place along the slope", phrase("least energy: {}; least height: {}", *least))
        )
    return tuple(facts)


def _beyond(words: str) -> tuple[tuple[str, str], ...]:
    """The fact that values are beyond what was measured on rocks, if they are."""
    return (("Beyond measurements (95 %)", words),) if words else ()


def best_places(places: pd.DataFrame) -> tuple[pd.Series, pd.Series] | None:
    """Where along the slope the least energy and the least height arrive, of 95 % of the blocks.

    ``places`` as of places_table, for one line. Places upslope that fewer blocks reach than the
    line itself are left out, as the others start below them or pass beside. None if there is
    nothing to compare.
    """
    here = places[places["moved_m"] == 0.0]
    if len(places) < 2 or not len(here):
        return None
    enough = places["arrivals_per_year"] >= _ENOUGH * here["arrivals_per_year"].iloc[0]
    known = places[enough | (places["moved_m"] >= 0.0)]
    energy, height = (known.loc[known[key].idxmin()] for key in ("energy_q95_kj", "height_q95_m"))
    return energy, height


def _moved(metres: float) -> str:
    if metres == 0.0:
        return phrase("where it is drawn")
    text = "{} m downslope" if metres > 0.0 else "{} m upslope"
    return phrase(text, f"{abs(metres):g}")


def _table(arriving: pd.Series, protection: pd.DataFrame, built: bool) -> ReportTable:
    columns = (
        "return period | years; energy | kJ; energy class; passing height | m; block | m; "
        "net height | m"
    )
    rows = []
    for _, row in protection.iterrows():
        years = f"{row['return_period_years']:g}"
        keys = ("energy_kj", "net_height_m", BEHIND)
        energy, height, behind = (limited(row, key) for key in keys)
        passing = limited(arriving, f"height_{years}y_m")
        size = row["block_m"]
        cells: list[Cell] = [
            years, energy, _classes(row["net_class"], row["net_class_high"]), passing,
            None if pd.isna(size) else float(size), height,
        ]  # fmt: skip
        rows.append([*cells, behind] if built else cells)
    return table_of(
        "What is reached or exceeded once in the return period",
        columns + ("; energy behind it | kJ" if built else ""),
        rows,
    )


def _classes(own: str, high: str) -> str | None:
    """The class of the energy, and that of its upper limit where it is another."""
    if not own:
        return None
    return own if high == own else phrase("{} to {}", own, high or "–")


def _notes() -> tuple[str, ...]:
    """What every sheet says below its figures."""
    classes = ", ".join(f"{name}: {most:g}" for name, most in net_classes() if most < np.inf)
    return (
        "Without walls and nets, but for what is behind. Limits are those of the sampling error: "
        "onset frequencies, block sizes and ground classes are not in them.",
        "A dash: blocks come less often, or the sample of blocks has no limit.",
        "Net height: passing height of the centre of the block and the diameter of the block, as a "
        "sphere. Freeboard and partial factors of the guideline come on top.",
        phrase(
            "Energy class: the lowest of ETAG 27 and EAD 340059 whose maximum energy level is not "
            "below the energy. These are, in kJ: {}. The classes are not checked against the text.",
            classes,
        ),
        "A place upslope that fewer blocks reach than the line itself is not taken as better: the "
        "others start below it or pass beside it. What is to be protected must lie below the "
        "place.",
    )


def write_protection_page(
    folder: Path,
    title: str,
    byline: Sequence[str],
    sheets: Sequence[ProtectionSheet],
    change: ReportFigure | None,
    warnings: int,
) -> None:
    """Write the sheets into one HTML file that prints a page of A4 for each.

    ``change`` shows the hazard levels without and with walls and nets, ``warnings`` is how many
    the report has.
    """
    notes = [translated(note) for note in _notes()]
    if warnings:
        text = "Warnings of the run that bear on these values: {}, in report.html."
        notes.insert(0, translated(phrase(text, warnings)))
    shown = [
        {
            "title": translated(sheet.title),
            "facts": [(translated(key), translated(value)) for key, value in sheet.facts],
            "table": translated_table(sheet.table),
            "pictures": [
                (figure, translated(figure.title), translated(figure.caption))
                for figure in (sheet.figure, change if sheet.built else None)
                if figure is not None
            ],
        }
        for sheet in sheets
    ]
    text = template("protection.html.j2").render(
        title=named(title), byline=byline, sheets=shown, notes=notes, language=current_language()
    )
    (folder / PAGE_NAME).write_text(text, encoding="utf-8", newline="\n")
