"""The report: one HTML file that can be mailed, printed and read without anything else."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from sassgis.errors import OutputError
from sassgis.settings.languages import current_language, translated, with_translated
from sassgis.settings.results import first_warnings, power_of_ten, thousands

#: What a cell of a table may hold; numbers are written with sensible digits, None as a dash.
Cell = str | int | float | np.integer[Any] | np.floating[Any] | None


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """A picture (PNG) in the report."""

    title: str
    caption: str  # what is to be seen, in a sentence or two
    # Waits where the picture is drawn in another process.
    drawn: Callable[[], bytes] = field(repr=False, compare=False)
    alt: str = ""  # what is seen, for those who cannot see it; default: the title

    @property
    def png(self) -> bytes:
        """Return the PNG file."""
        return self.drawn()

    def finished(self) -> ReportFigure:
        """Return the figure with its file, which waits for nobody."""
        return replace(self, drawn=partial(bytes, self.png))


def heads(columns: str) -> tuple[tuple[str, str], ...]:
    """Return the name and unit of the columns of a table, from "station; speed | m/s"."""
    parts = (column.partition("|") for column in columns.split(";"))
    return tuple((name.strip(), unit.strip()) for name, _, unit in parts)


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table in the report."""

    title: str
    columns: tuple[tuple[str, str], ...]  # name and unit, which is empty for words and counts
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""  # what the numbers mean; stands beneath the table

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise OutputError(
                    f"report table {self.title!r}: a row has {len(row)} cells, "
                    f"the head {len(self.columns)} columns"
                )


def table_of(
    title: str,
    columns: str | Iterable[tuple[str, str]],
    rows: Iterable[Iterable[Cell]],
    note: str = "",
) -> ReportTable:
    """Return a table; its columns as for :func:`heads`, or name and unit of each."""
    named = heads(columns) if isinstance(columns, str) else tuple(columns)
    return ReportTable(title, named, tuple(map(tuple, rows)), note)


@dataclass(frozen=True, slots=True)
class ReportAnswer:
    """A part of the answer in plain words: a paragraph, and a list of points below it."""

    heading: str
    sentences: tuple[str, ...] = ()
    points: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportContext:
    """All that a report says. Sections without content are left out."""

    title: str
    subtitle: str = ""
    byline: tuple[str, ...] = ()  # who made it, when, with which program; below the title
    files_beside: tuple[tuple[str, str], ...] = ()  # pages in the same folder with their names
    summary: tuple[tuple[str, Cell], ...] = ()  # the answer in a box at the top: a line each
    # Terrain, release areas, blocks, number of blocks, settings.
    what_was_run: tuple[tuple[str, Cell], ...] = ()
    # What a reader must know before trusting the numbers; in a report that is written what may
    # make it wrong, and all others among the notes below.
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    verdict: str = ""  # the answer in a sentence, above all but the box and the warnings
    answer: tuple[ReportAnswer, ...] = ()  # what follows from it, in plain words
    key_results: ReportTable | None = None
    figures: tuple[ReportFigure, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    provenance: tuple[tuple[str, Cell], ...] = ()  # version, seed, hash of the inputs, files


def sensible(value: Cell, digits: int = 3) -> str:
    """Write a value as a person would; text as it is, None and NaN as a dash.

    Whole numbers are written out. Others get ``digits`` significant digits, and no digit before
    the point is ever rounded away: 0.0123, 4.57, 0.8, 812, 10 340.
    """
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return translated("yes" if value else "no")
    number = float(value)
    if math.isnan(number):
        return "–"
    if abs(number) < 1e-12:
        number = 0.0
    if math.isinf(number):
        return "∞" if number > 0.0 else "−∞"
    if isinstance(value, int | np.integer) or number == 0.0:
        text = f"{number:,.0f}"
    else:
        mantissa, exponent, decimals = _written(number, digits)
        text = f"{number:,.{decimals}f}"
        if abs(number) < 1e-4:
            text = f"{mantissa} × {power_of_ten(exponent)}"
        elif decimals:
            # A friction of 0.8 is not known to be 0.800.
            text = text.rstrip("0").rstrip(".")
    return text.replace(",", "\u202f").replace("-", "\u2212")


def same_decimals(values: Sequence[float]) -> list[str]:
    """Write values as a person would, all with the decimals of the first: 4.40, 4.36, 4.44."""
    if abs(values[0]) < 1e-4:
        return [sensible(value) for value in values]
    _, _, decimals = _written(values[0], 3)
    return [thousands(value, decimals) for value in values]


def _written(number: float, digits: int) -> tuple[str, int, int]:
    """Return mantissa and exponent of so many digits, and the decimals that these need."""
    # 9.996 is rounded to 10.0 before its decimals are counted.
    mantissa, exponent = f"{number:.{digits - 1}e}".split("e")
    return mantissa, int(exponent), max(0, digits - 1 - int(exponent))


def number_columns(table: ReportTable) -> tuple[bool, ...]:
    """Return whether each column of a table holds numbers only, which are set flush right."""
    return tuple(
        any(cell is not None for cell in column)
        and not any(isinstance(cell, str | bool) for cell in column)
        for column in zip(*table.rows, strict=True)
    )


def data_uri(png: bytes) -> str:
    """Put a picture into the page itself."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


@cache
def template(name: str) -> Template:
    """Read a page once; every value is escaped, and a misspelt name is an error."""
    environment = Environment(
        loader=PackageLoader("sassgis", "data"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {
        "sensible": sensible, "data_uri": data_uri, "number_columns": number_columns,
    }  # fmt: skip
    # A function: jinja computes filters of constants once, whatever the language is then.
    environment.globals["translated"] = translated
    return environment.get_template(name)


def render_report(context: ReportContext) -> str:
    """Give the report as a whole HTML page: styles and pictures inside, no scripts, no network."""
    return template("report.html.j2").render(report=context, language=current_language())


def in_short(report: ReportContext, folder: Path) -> str:
    """Give what a notebook shows of a result: the answer, the warnings, the first figure."""
    page = (folder / "report.html").as_posix()
    return template("notebook.html.j2").render(report=report, page=page)


def translated_report(context: ReportContext) -> ReportContext:
    """Return the report in the language in which the program writes; its title is the user's.

    Of its warnings the first few about what may make the result wrong stay at the top.
    """
    first = first_warnings(context.warnings)
    notes = tuple(text for text in context.warnings if text not in first)
    context = replace(context, warnings=first, notes=(*notes, *context.notes))
    if current_language() == "en":
        return context
    key_results = context.key_results and translated_table(context.key_results)
    return replace(
        with_translated(
            context, "subtitle", "summary", "what_was_run", "warnings", "notes", "verdict"
        ),
        answer=tuple(with_translated(a, "heading", "sentences", "points") for a in context.answer),
        key_results=key_results,
        figures=tuple(with_translated(f, "title", "caption", "alt") for f in context.figures),
        tables=tuple(map(translated_table, context.tables)),
        files_beside=tuple((file, translated(name)) for file, name in context.files_beside),
        provenance=tuple((translated(name), value) for name, value in context.provenance),
    )


#: Columns of sources, and of names that the user gave.
_AS_THEY_ARE = (
    "source", "station", "barrier", "object", "line", "release area", "block scenario", "scenario",
    "site",
)  # fmt: skip


def translated_table(table: ReportTable) -> ReportTable:
    """Return table of a report; sources stay in the words of their publication, names as given."""
    kept = [name in _AS_THEY_ARE for name, _ in table.columns]
    rows = tuple(
        tuple(
            translated(cell) if isinstance(cell, str) and not keep else cell
            for cell, keep in zip(row, kept, strict=True)
        )
        for row in table.rows
    )
    return replace(with_translated(table, "title", "columns", "note"), rows=rows)


def write_report(path: str | PathLike[str], context: ReportContext) -> Path:
    """Write the report as one HTML file into a folder that exists."""
    target = Path(path)
    page = render_report(context)
    try:
        target.write_text(page, encoding="utf-8", newline="\n")
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{target}: the report cannot be written ({reason})") from error
    return target
