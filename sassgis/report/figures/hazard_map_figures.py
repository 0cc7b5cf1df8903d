"""Maps side by side: intensities, uncertain levels, what changes from one result to another."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sassgis.hazard.zone_styles import LEVEL_CHANGES
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.labels import thousands
from sassgis.model.languages import joined, phrase
from sassgis.model.results import RasterClass, RasterLayer
from sassgis.report.figures.map_figure import (
    ClassRow,
    MapFrame,
    MapPanel,
    class_panel,
    class_positions,
    coarse_note,
    colour_bar,
    draw_maps,
)
from sassgis.report.figures.map_marks import MapMarks, all_points
from sassgis.report.figures.relief import FURNITURE_IN, footprint, furniture_beside, view_of
from sassgis.report.figures.style import (
    GAP_COLOURS,
    INK,
    SMALL,
    TITLE,
    WIDTH_IN,
    house_style,
    lines_in,
    note_height,
    wrap,
)

_MAX_HEIGHT_IN = 8.0
_LEFT_IN, _RIGHT_IN, _GAP_IN, _HEAD_IN = 0.5, 0.26, 0.14, 0.22
_ROOM_IN = WIDTH_IN - _LEFT_IN - _RIGHT_IN
_PALE = 0.65


def columns_of(panels: int, aspect: float, width_in: float, height_in: float) -> int:
    """Number of columns that makes equal panels largest; the fewest of those equally good.

    The aspect is height by width of a panel; width and height are the room for all.
    """

    def rank(columns: int) -> tuple[float, int]:
        return _panel_width(panels, columns, aspect, width_in, height_in), -columns

    return max(range(1, panels + 1), key=rank)


def _panel_width(
    panels: int, columns: int, aspect: float, width_in: float, height_in: float
) -> float:
    rows = -(-panels // columns)
    wide = (width_in - (columns - 1) * _GAP_IN) / columns
    tall = (height_in - rows * _HEAD_IN) / rows
    return min(wide, tall / aspect)


def _class_maps(
    grid: Grid,
    panels: Sequence[MapPanel],
    legends: Sequence[ClassRow],
    marks: MapMarks,
    title: str,
    note: str,
) -> Figure:
    """Lay maps of classes side by side, with one legend below."""
    values = [panel.values for panel in panels if panel.values is not None]
    seen = np.where(np.any(np.isfinite(values), axis=0), 1.0, np.nan)
    view = view_of(grid, footprint(grid, seen, all_points(marks.release)))
    notes = [note, marks.key(), coarse_note(view, "highest class")]
    heading = wrap(title, WIDTH_IN - 0.4, TITLE)
    below = wrap(joined("\n", filter(None, notes)), WIDTH_IN - _LEFT_IN - 0.2)
    legend_w = _ROOM_IN - FURNITURE_IN[0] - 0.2
    legend_h = sum(-row.placed(0.0, 0.0, legend_w)[1] for row in legends)
    legend_h = max(legend_h, FURNITURE_IN[1])
    columns = columns_of(len(panels), view.aspect, _ROOM_IN, _MAX_HEIGHT_IN)
    width = _panel_width(len(panels), columns, view.aspect, _ROOM_IN, _MAX_HEIGHT_IN)
    used = columns * width + (columns - 1) * _GAP_IN
    frame = MapFrame(
        left=_LEFT_IN + (_ROOM_IN - used) / 2.0,
        width=width,
        height=width * view.aspect,
        top=0.12 + 0.18 * lines_in(heading) + 0.04,
        bottom=0.46 + legend_h + 0.06 + 0.135 * lines_in(below) + 0.1,
        columns=columns,
        gap=_GAP_IN,
        head=_HEAD_IN,
        ticks=5 if width > 4.0 else 3,
    )
    maps = draw_maps(view, panels, marks, frame)
    at = frame.bottom - 0.46
    for row in legends:
        at = row.draw(maps.page, _LEFT_IN, at, legend_w)
    at = min(at, frame.bottom - 0.46 - FURNITURE_IN[1])
    x, y = WIDTH_IN - _RIGHT_IN - FURNITURE_IN[0] - 0.1, frame.bottom - 0.36
    furniture_beside(maps.page, x, y - (FURNITURE_IN[1] + 0.1), maps.metres_per_inch)
    maps.page.note(_LEFT_IN, at - 0.02, below)
    maps.page.title(_LEFT_IN, heading)
    return maps.page.figure


@house_style()
def intensity_figure(
    grid: Grid, layers: Sequence[RasterLayer], marks: MapMarks, note: str = ""
) -> Figure:
    """Draw maps of the same classes side by side, as the intensities of several return periods.

    The title of each stands over its map; the classes of the first are the legend.
    """
    panels = [class_panel(layer.bands[0].values, layer.classes, layer.title) for layer in layers]
    legend = ClassRow("", layers[0].classes)
    return _class_maps(grid, panels, [legend], marks, "Intensity by return period", note)


@house_style()
def confidence_figure(
    grid: Grid, level: RasterLayer, uncertain: NDArray[np.bool_], marks: MapMarks, note: str = ""
) -> Figure:
    """Draw the hazard level, with fine black lines over the cells whose level is uncertain."""
    panel = class_panel(level.bands[0].values, level.classes, level.title, uncertain, _PALE)
    assert panel.values is not None
    reached = np.isfinite(panel.values)
    share = int((uncertain & reached).sum()) / max(int(reached.sum()), 1)
    text = "Statistically uncertain: {} % of the cells that have a level."
    note = joined(" ", filter(None, (phrase(text, f"{100.0 * share:.1f}"), note)))
    legend = ClassRow("", level.classes, RasterClass(0, "statistically uncertain", INK))
    title = "Levels that another sample of blocks may change"
    return _class_maps(grid, [panel], [legend], marks, title, note)


def level_changes(before: FloatArray, after: FloatArray) -> FloatArray:
    """What becomes of each cell's class: -1 lower, 0 the same, 1 higher; NaN without any.

    Parameters
    ----------
    before, after : same shape
        Positions among the classes; NaN where there is none, which is below the lowest.
    """
    old, new = np.nan_to_num(before, nan=-1.0), np.nan_to_num(after, nan=-1.0)
    return np.where((old < 0.0) & (new < 0.0), np.nan, np.sign(new - old))


@house_style()
def change_figure(
    grid: Grid,
    before: RasterLayer,
    after: RasterLayer,
    marks: MapMarks,
    *,
    names: tuple[str, str] = ("Without barriers", "With barriers"),
    title: str = "Hazard level without and with barriers",
    note: str = "",
) -> Figure:
    """Draw the hazard level before and after, and where it became lower or higher.

    Both layers are maps of the same classes; the names stand over them.
    """
    classes = before.classes
    positions = [class_positions(layer.bands[0].values, classes) for layer in (before, after)]
    change = level_changes(*positions)
    kinds = tuple(
        RasterClass(number, *LEVEL_CHANGES[code])
        for number, code in ((-1, "lower"), (0, "same"), (1, "higher"))
    )
    area = grid.cell_size**2
    changes = [thousands(np.count_nonzero(change == kind.value) * area) for kind in kinds]
    panels = [
        class_panel(before.bands[0].values, classes, names[0]),
        class_panel(after.bands[0].values, classes, names[1]),
        class_panel(change, kinds, "Change"),
    ]
    legends = [ClassRow("Level", classes), ClassRow("Change", kinds)]
    text = "Lower level: {} m²; same level: {} m²; higher level: {} m²."
    note = joined(" ", filter(None, (phrase(text, *changes), note)))
    return _class_maps(grid, panels, legends, marks, title, note)


@house_style()
def map_change_figure(
    grid: Grid,
    before: FloatArray,
    after: FloatArray,
    change: FloatArray,
    marks: MapMarks,
    *,
    unit: str,
    ramp: str,
    title: str,
    note: str = "",
) -> Figure:
    """Draw a map before and after, and the difference.

    Parameters
    ----------
    before, after, change : shape of the grid
        NaN where no rock comes.
    unit : str
        Empty for shares, which are drawn in per cent.
    ramp : str
        Name of a matplotlib colour map for the first two.
    """
    scale = 1.0 if unit else 100.0
    view = view_of(grid, footprint(grid, change, all_points(marks.release)))
    key = "Black outline: release area." if marks.release else ""
    text = joined(" ", (phrase(p) for p in (note, key) if p))
    room = WIDTH_IN - FURNITURE_IN[0] - 0.4
    left, right, gap, tall = 0.6, 0.12, 0.1, 6.0
    width = min((WIDTH_IN - left - right - 2 * gap) / 3.0, tall / view.aspect)
    bottom = 1.0 + max(note_height(text, room), FURNITURE_IN[1] + 0.1)
    frame = MapFrame(left, width, width * view.aspect, 0.55, bottom, columns=3, gap=gap, ticks=2)
    known = np.concatenate([scale * m[np.isfinite(m)] for m in (before, after)])
    # One cell must not take all the colour; the bar says that it is cut.
    high = (float(np.quantile(known, 0.995)) if known.size else 0.0) or 1.0
    moved = np.abs(scale * change[np.isfinite(change)])
    moved = moved[moved > 0.0]
    most = float(np.quantile(moved, 0.98)) if moved.size else 1.0
    amounts = (mpl.colormaps[ramp], Normalize(0.0, high))
    changes = (GAP_COLOURS, Normalize(-most, most))
    panels = [
        MapPanel(scale * values, *colours, name, alpha=0.9, together="mean")
        for name, values, colours in (
            ("Before", before, amounts),
            ("After", after, amounts),
            ("After less before", change, changes),
        )
    ]
    maps = draw_maps(view, panels, marks, frame)
    maps.page.around(title, text, room)
    for k, extend, long, words in (
        (0, "max", 2.0 * width + gap, unit or "%"),
        (2, "both", width, phrase("change ({})", phrase(unit or "percentage points"))),
    ):
        x = left + k * (width + gap) + 0.15
        bar = maps.page.axes(x, frame.bottom - 0.62, long - 0.3, 0.09, "legend")
        colour_bar(bar, panels[k], orientation="horizontal", extend=extend)
        bar.set_xlabel(words, size=SMALL)
    # Below the maps, where it hides nothing.
    furniture_beside(
        maps.page, WIDTH_IN - right - FURNITURE_IN[0] - 0.1, 0.04, maps.metres_per_inch
    )
    return maps.page.figure
