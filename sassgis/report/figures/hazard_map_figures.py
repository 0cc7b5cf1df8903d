"""Maps side by side: intensities, uncertain levels, what changes from one result to another."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from sassgis.grid import FloatArray, Grid
from sassgis.hazard.zone_styles import LEVEL_CHANGES
from sassgis.report.figures import map_figure
from sassgis.report.figures.map_marks import MapMarks, all_points
from sassgis.report.figures.relief import footprint, view_of
from sassgis.report.figures.style import GAP_COLOURS, house_style
from sassgis.settings.labels import thousands
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import RasterClass, RasterLayer

_PALE = 0.65


def _class_maps(
    grid: Grid,
    panels: Sequence[map_figure.MapPanel],
    legends: Sequence[tuple[str, Sequence[Patch]]],
    marks: MapMarks,
    title: str,
    note: str,
) -> Figure:
    """Draw maps of classes: one with its legend next to it, several with legends below them."""
    values = [panel.values for panel in panels if panel.values is not None]
    seen = np.where(np.any(np.isfinite(values), axis=0), 1.0, np.nan)
    view = view_of(grid, footprint(grid, seen, all_points(marks.release)))
    notes = [note, marks.key(), map_figure.coarse_note(view, "highest class")]
    sheet, axes = map_figure.draw_maps(view, panels, marks, title, notes)
    if len(panels) == 1:
        map_figure.legend_beside(axes[0], legends[0][1], legends[0][0])
    else:
        for heading, signs in reversed(legends):
            sheet.legend(signs, heading)
    return map_figure.finish(sheet, axes, marks, view)


@house_style()
def intensity_figure(
    grid: Grid, layers: Sequence[RasterLayer], marks: MapMarks, note: str = ""
) -> Figure:
    """Draw maps of the classes of the first side by side, each below its title."""
    panels = [
        map_figure.class_panel(layer.bands[0].values, layer.classes, layer.title)
        for layer in layers
    ]
    legend = ("", map_figure.class_signs(layers[0].classes))
    return _class_maps(grid, panels, [legend], marks, "Intensity by return period", note)


@house_style()
def confidence_figure(
    grid: Grid, level: RasterLayer, uncertain: NDArray[np.bool_], marks: MapMarks, note: str = ""
) -> Figure:
    """Draw the hazard level, with fine black lines over the cells whose level is uncertain."""
    values, classes = level.bands[0].values, level.classes
    panel = map_figure.class_panel(values, classes, level.title, over=uncertain, alpha=_PALE)
    assert panel.values is not None
    reached = np.isfinite(panel.values)
    share = int((uncertain & reached).sum()) / max(int(reached.sum()), 1)
    text = "Statistically uncertain: {} % of the cells that have a level."
    note = joined(" ", filter(None, (phrase(text, f"{100.0 * share:.1f}"), note)))
    legend = ("", map_figure.class_signs(classes, "statistically uncertain"))
    title = "Levels that another random seed may change"
    return _class_maps(grid, [panel], [legend], marks, title, note)


def level_changes(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the change of positions among classes (-1, 0, 1); NaN, below all, without any."""
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
    """Draw two maps of the same classes, and where the level became lower or higher."""
    classes = before.classes
    positions = [
        map_figure.class_positions(layer.bands[0].values, classes) for layer in (before, after)
    ]
    change = level_changes(*positions)
    kinds = tuple(
        RasterClass(number, *LEVEL_CHANGES[code])
        for number, code in ((-1, "lower"), (0, "same"), (1, "higher"))
    )
    area = grid.cell_size**2
    changes = [thousands(np.count_nonzero(change == kind.value) * area) for kind in kinds]
    panels = [
        map_figure.class_panel(before.bands[0].values, classes, names[0]),
        map_figure.class_panel(after.bands[0].values, classes, names[1]),
        map_figure.class_panel(change, kinds, "Change"),
    ]
    legends = [
        ("Level", map_figure.class_signs(classes)),
        ("Change", map_figure.class_signs(kinds)),
    ]
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
    """Draw a map before and after, and the difference; NaN where no block comes.

    The unit is empty for shares, which are drawn in per cent; ``ramp`` colours the first two.
    """
    scale = 1.0 if unit else 100.0
    view = view_of(grid, footprint(grid, change, all_points(marks.release)))
    known = np.concatenate([scale * m[np.isfinite(m)] for m in (before, after)])
    # One cell must not take all the colour; the bar says that it is cut.
    high = (float(np.quantile(known, 0.995)) if known.size else 0.0) or 1.0
    moved = np.abs(scale * change[np.isfinite(change)])
    moved = moved[moved > 0.0]
    most = float(np.quantile(moved, 0.98)) if moved.size else 1.0
    amounts = (mpl.colormaps[ramp], Normalize(0.0, high))
    changes = (GAP_COLOURS, Normalize(-most, most))
    panels = [
        map_figure.MapPanel(scale * values, *colours, name, alpha=0.9, together="mean")
        for name, values, colours in (
            ("Before", before, amounts),
            ("After", after, amounts),
            ("After less before", change, changes),
        )
    ]
    sheet, axes = map_figure.draw_maps(view, panels, marks, title, [note, marks.key()], columns=3)
    below = {"location": "bottom", "shrink": 0.9}
    map_figure.colour_bar(axes[:2], panels[0], unit or "%", extend="max", **below)
    words = phrase("change ({})", phrase(unit or "percentage points"))
    map_figure.colour_bar(axes[2:], panels[2], words, extend="both", **below)
    return map_figure.finish(sheet, axes, marks, view)
