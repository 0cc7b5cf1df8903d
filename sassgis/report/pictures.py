"""Figures for a report: saved next to it, and what is seen in them in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, wait
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from sassgis.errors import OutputError
from sassgis.grid import Grid
from sassgis.report.figures.map_figure import (
    class_numbers,
    map_figure,
    shown_part,
    shown_points,
    shown_values,
)
from sassgis.report.figures.map_marks import MapMarks
from sassgis.report.figures.style import to_png
from sassgis.report.page import ReportFigure, sensible
from sassgis.settings.languages import Language, current_language, in_language, joined, phrase
from sassgis.settings.results import RasterLayer, thousands
from sassgis.settings.styles import class_labels
from sassgis.simulation.workers import Processes, Workers

if TYPE_CHECKING:
    from sassgis.simulation.path_sample import LinePaths

#: Set where the figures are drawn next to other work, which may fail or be stopped.
GIVEN_UP: ContextVar[Event | None] = ContextVar("given_up", default=None)
#: Draw the figures in processes next to this one, where a run has more than one core.
DRAWERS: ContextVar[Processes | None] = ContextVar("drawers", default=None)


@contextmanager
def drawn_beside(jobs: int | Workers) -> Iterator[None]:
    """Draw the figures of the ``with`` block in a process next to this one, unless jobs is 1."""
    if jobs == 1:
        yield
        return
    with Processes(1) as drawers:
        # Loading what draws takes the process as long as some figures.
        drawers.submit(_ready)
        before = DRAWERS.set(drawers)
        try:
            yield
        finally:
            DRAWERS.reset(before)


def _ready() -> None:
    """Do nothing, in a process that has loaded this module then."""


def picture(
    folder: Path, name: str, title: str, caption: str, make: Callable[[], Figure], alt: str = ""
) -> ReportFigure:
    """Save a figure as ``<name>.png`` for a report; CancelledError if nobody waits any more.

    ``make`` may be called in another process, and later: a function of a module, with what it
    draws, which must not change any more.
    """
    if (given_up := GIVEN_UP.get()) is not None and given_up.is_set():
        raise CancelledError
    folder.mkdir(parents=True, exist_ok=True)
    draw = partial(_drawn, folder / f"{name}.png", make, current_language())
    if (drawers := DRAWERS.get()) is None:
        return ReportFigure(title, caption, partial(bytes, draw()), alt)
    return ReportFigure(title, caption, partial(_awaited, drawers.submit(draw), draw), alt)


def _awaited(drawn: Future[bytes], draw: Callable[[], bytes]) -> bytes:
    """Wait for a figure; it is drawn here where no other process could be started."""
    while not wait([drawn], 0.1).done:
        if (given_up := GIVEN_UP.get()) is not None and given_up.is_set():
            raise CancelledError
    try:
        return drawn.result()
    except OutputError:
        return draw()


def _drawn(file: Path, make: Callable[[], Figure], language: Language) -> bytes:
    """Make a figure, write it as PNG, and return that."""
    with in_language(language):
        png = to_png(make())
    file.write_bytes(png)
    return png


def map_pictures(
    folder: Path, grid: Grid, layers: Sequence[RasterLayer], marks: MapMarks
) -> tuple[ReportFigure, ...]:
    """Draw layers as maps, those that hold anything."""
    return tuple(
        picture(
            folder, f"map_{layer.stem}", layer.title, layer.note,
            map_drawn(grid, layer, marks), map_alt(grid, layer),
        )
        for layer in layers
        if np.isfinite(layer.bands[0].values).any()
    )  # fmt: skip


def map_drawn(grid: Grid, layer: RasterLayer, marks: MapMarks) -> partial[Figure]:
    """Return what draws the first band of a layer as a map."""
    view, (own,) = shown_part(grid, [layer], shown_points(marks))
    return partial(map_figure, view.grid, own, marks)


def map_alt(grid: Grid, layer: RasterLayer) -> str:
    """List classes of the first band with areas, the highest first, and the largest value."""
    band = layer.bands[0]
    values = shown_values(band)
    if layer.classes:
        ordered = sorted(layer.classes, key=lambda entry: -entry.value)
        areas = [(c.label, int((values == c.value).sum())) for c in ordered]
    else:
        number = class_numbers(values, layer.breaks) if layer.breaks else np.zeros_like(values)
        labels = class_labels(layer.breaks, band.unit) if layer.breaks else ["any value"]
        areas = [(label, int((number == k).sum())) for k, label in enumerate(labels)][::-1]
    shown = classes_alt(layer.title, [(label, n * grid.cell_size**2) for label, n in areas])
    if layer.classes or not np.isfinite(values).any():
        return shown
    return phrase("{} Largest value {}.", shown, sensible(float(np.nanmax(values))))


def classes_alt(title: str, areas: Sequence[tuple[str, float]]) -> str:
    """Return a map of classes, with their names and areas (m²)."""
    parts = [phrase("{} on {} m²", phrase(name), sensible(round(m2))) for name, m2 in areas if m2]
    shown = joined(", ", parts) if parts else phrase("no values")
    return phrase("Map over shaded relief, {}: {}.", phrase(title), shown)


def path_alt(shown: LinePaths) -> str:
    """Return a profile with paths of blocks."""
    end = float(shown.stops.max())
    low = float(np.interp(end, shown.s, shown.z))
    names = ", ".join(line.name for line, chainage in shown.control_lines if chainage <= end)
    section = phrase(
        "Vertical section from {} m down to {} m over {} m in plan. Paths drawn: {}.",
        *(thousands(float(x)) for x in (shown.z[0], low, end)),
        len(shown.paths),
    )
    return joined(" ", (section, phrase("It crosses {}.", names))) if names else section


def station_alt(row: Mapping[str, Any]) -> str:
    """Return histograms at a station or barrier; ``row`` of control_line_rows."""
    keys = ("rocks", "speed_mps_q95", "rotation_hz_q95", "height_m_q95")
    return phrase(
        "Histograms of speed, rotation and passing height of {} blocks: 95 % of them below {} m/s, "
        "{} Hz and {} m.",
        *(sensible(row[key]) for key in keys),
    )
