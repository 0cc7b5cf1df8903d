"""Maps of hazard side by side: intensities, uncertain levels, what barriers change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sassgis.hazard.zone_styles import LEVEL_CHANGES
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.results import RasterClass, RasterLayer
from sassgis.report.figures import relief
from sassgis.report.figures.class_maps import (
    OVER_SHARE,
    class_positions,
    draw_class_row,
    draw_classes,
    draw_stripes,
)
from sassgis.report.figures.map_marks import (
    MapControlLine,
    MapObject,
    cut_extent,
    draw_map_control_lines,
    draw_objects,
    draw_release,
    draw_zones,
    footprint,
    line_key,
)
from sassgis.report.figures.relief import Extent
from sassgis.report.figures.style import (
    GREY,
    INK,
    SMALL,
    TEXT,
    TITLE,
    WIDTH_IN,
    lines_in,
    new_figure,
    styled,
    wrap,
)
from sassgis.report.number_text import thousands

_MAX_HEIGHT_IN = 8.0
_LEFT_IN, _RIGHT_IN, _GAP_IN, _HEAD_IN = 0.5, 0.26, 0.14, 0.22
_PALE = 0.65


@dataclass(frozen=True, slots=True)
class _Panel:
    """One map: positions among its classes, and cells with fine lines over them."""

    title: str
    positions: FloatArray
    classes: Sequence[RasterClass]
    over: NDArray[np.bool_] | None = None
    alpha: float = 0.8


@dataclass(frozen=True, slots=True)
class _Legend:
    """One line of the legend."""

    heading: str
    classes: Sequence[RasterClass]
    over: RasterClass | None = None


def _class_layer(grid: Grid, layer: RasterLayer) -> FloatArray:
    """Positions of the cells of a layer among its classes."""
    if not layer.classes:
        raise InputError(
            f"layer {layer.stem!r} is no map of classes", found="no classes", expected="classes"
        )
    _check_shape(grid, layer.stem, layer.bands[0].values.shape)
    return class_positions(np.asarray(layer.bands[0].values, float), layer.classes)


def _check_shape(grid: Grid, name: str, shape: tuple[int, ...]) -> None:
    if shape != grid.shape:
        raise InputError(
            f"layer {name!r} does not lie on the cells of the terrain",
            found=" x ".join(map(str, shape)) + " cells",
            expected=f"{grid.shape[0]} x {grid.shape[1]}",
        )


def columns_of(panels: int, aspect: float, width_in: float, height_in: float) -> int:
    """Number of columns that makes equal panels largest.

    Parameters
    ----------
    panels : int
    aspect : float
        Height by width of a panel.
    width_in, height_in : float
        Room for all.

    Returns
    -------
    int
        The fewest columns among those that are equally good.
    """

    def panel_width(columns: int) -> float:
        rows = -(-panels // columns)
        wide = (width_in - (columns - 1) * _GAP_IN) / columns
        tall = (height_in - rows * _HEAD_IN) / rows
        return min(wide, tall / aspect)

    return max(range(1, panels + 1), key=lambda columns: (panel_width(columns), -columns))


def _maps(
    grid: Grid,
    panels: Sequence[_Panel],
    legends: Sequence[_Legend],
    *,
    title: str,
    note: str,
    release: Sequence[FloatArray],
    zones: Sequence[FloatArray],
    control_lines: Sequence[MapControlLine],
    objects: Sequence[MapObject],
    extent: Extent | None,
) -> Figure:
    """Lay panels of one extent side by side, with one legend below."""
    seen = np.where(np.any([np.isfinite(panel.positions) for panel in panels], axis=0), 1.0, np.nan)
    marks = [np.asarray(r, float).reshape(-1, 2) for r in release]
    others = np.concatenate(marks) if marks else np.empty((0, 2))
    box = footprint(grid, seen, others) if extent is None else cut_extent(extent, grid)
    window = relief.window_of(grid, box)
    part = window.grid(grid)
    factor = -(-max(part.shape) // relief.MAX_CELLS)
    aspect = (box[3] - box[1]) / (box[2] - box[0])

    room = WIDTH_IN - _LEFT_IN - _RIGHT_IN
    columns = columns_of(len(panels), aspect, room, _MAX_HEIGHT_IN)
    rows = -(-len(panels) // columns)
    map_w = min(
        (room - (columns - 1) * _GAP_IN) / columns,
        (_MAX_HEIGHT_IN - rows * _HEAD_IN) / rows / aspect,
    )
    map_h = map_w * aspect
    notes = [note, line_key(bool(release), False, control_lines, bool(zones), objects)]
    if factor > 1:
        notes.append(
            f"Drawn with one dot for {factor} × {factor} cells; each shows the highest class in it."
        )
    heading = wrap(title, WIDTH_IN - 0.4, TITLE)
    below = wrap("\n".join(n for n in notes if n), WIDTH_IN - _LEFT_IN - 0.2)
    blank = new_figure(WIDTH_IN, 10.0, constrained=False)
    legend_w = room - relief.FURNITURE_IN[0] - 0.2
    legend_h = sum(
        -draw_class_row(blank, g.heading, g.classes, 0.0, 0.0, legend_w, over=g.over, measure=True)
        for g in legends
    )
    legend_h = max(legend_h, relief.FURNITURE_IN[1])
    top = 0.12 + 0.18 * lines_in(heading) + 0.04
    bottom = 0.46 + legend_h + 0.06 + 0.135 * lines_in(below) + 0.1
    height = top + rows * (map_h + _HEAD_IN) + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    used = columns * map_w + (columns - 1) * _GAP_IN
    left = _LEFT_IN + (room - used) / 2.0
    for number, panel in enumerate(panels):
        row, column = divmod(number, columns)
        y = height - top - (row + 1) * (map_h + _HEAD_IN)
        x = left + column * (map_w + _GAP_IN)
        ax = figure.add_axes((x / WIDTH_IN, y / height, map_w / WIDTH_IN, map_h / height))
        ax.set_label("map")
        relief.draw_relief(ax, part)
        _draw_panel(ax, panel, window, part, factor, (box[2] - box[0]) / map_w)
        draw_zones(ax, zones)
        draw_objects(ax, objects, box)
        draw_release(ax, release)
        draw_map_control_lines(ax, control_lines, box, 72.0 * map_w / (box[2] - box[0]))
        relief.map_axes(ax, box, parts=5 if map_w > 4.0 else 3)
        _outer_labels(ax, first=column == 0, last=number + columns >= len(panels))
        ax.set_title(panel.title, size=TEXT, pad=3.0)
    at = bottom - 0.46
    for legend in legends:
        at = draw_class_row(
            figure, legend.heading, legend.classes, _LEFT_IN, at, legend_w, over=legend.over
        )
    at = min(at, bottom - 0.46 - relief.FURNITURE_IN[1])
    _furniture(
        figure, WIDTH_IN - _RIGHT_IN - relief.FURNITURE_IN[0] - 0.1, bottom - 0.36,
        (box[2] - box[0]) / map_w,
    )  # fmt: skip
    figure.text(
        _LEFT_IN / WIDTH_IN, (at - 0.02) / height, below, size=SMALL, color=GREY, va="top",
        gid="note",
    )  # fmt: skip
    figure.text(
        _LEFT_IN / WIDTH_IN, 1.0 - 0.1 / height, heading, size=TITLE, weight="bold", va="top",
        gid="title",
    )  # fmt: skip
    return figure


def _furniture(figure: Figure, x: float, top: float, metres_per_inch: float) -> None:
    """Draw scale bar and north arrow beside the legend, where they hide nothing."""
    width, height = figure.get_size_inches()
    size = (relief.FURNITURE_IN[0] + 0.1, relief.FURNITURE_IN[1] + 0.1)
    box = (x / width, (top - size[1]) / height, size[0] / width, size[1] / height)
    ax = figure.add_axes(box, label="scale")
    ax.set_axis_off()
    east, north = size[0] * metres_per_inch, size[1] * metres_per_inch
    ax.set_xlim(0.0, east)
    ax.set_ylim(0.0, north)
    relief.draw_furniture(ax, (0.0, 0.0, east, north), size[0], right=True, top=True)


def _outer_labels(ax: Axes, *, first: bool, last: bool) -> None:
    """Coordinates only left of the first column and below the last map of each."""
    if not first:
        ax.set_ylabel("")
        ax.tick_params(labelleft=False)
    if not last:
        ax.set_xlabel("")
        ax.tick_params(labelbottom=False)


def _draw_panel(
    ax: Axes,
    panel: _Panel,
    window: relief.GridWindow,
    part: Grid,
    factor: int,
    metres_per_inch: float,
) -> None:
    step = part.cell_size * factor
    positions = relief.coarsen(window.cut(panel.positions), factor, "max")
    cells = (
        part.west,
        part.north - positions.shape[0] * step,
        part.west + positions.shape[1] * step,
        part.north,
    )
    draw_classes(
        ax, positions, panel.classes, extent=cells, metres_per_inch=metres_per_inch,
        alpha=panel.alpha,
    )  # fmt: skip
    if panel.over is not None:
        over = relief.coarsen(window.cut(panel.over.astype(float)), factor, "max")
        draw_stripes(
            ax, over > 0.0, INK, extent=cells, metres_per_inch=metres_per_inch, alpha=0.9,
            falling=True, share=OVER_SHARE,
        )  # fmt: skip


@styled
def intensity_figure(
    grid: Grid,
    layers: Sequence[RasterLayer],
    *,
    release: Sequence[FloatArray] = (),
    zones: Sequence[FloatArray] = (),
    control_lines: Sequence[MapControlLine] = (),
    objects: Sequence[MapObject] = (),
    extent: Extent | None = None,
    title: str = "Intensity by return period",
    note: str = "",
) -> Figure:
    """Draw maps of the same classes side by side, as the intensities of several return periods.

    Parameters
    ----------
    grid : Grid
        Terrain; the layers lie on the same cells.
    layers : sequence of RasterLayer
        Maps of classes, at least one; the title of each stands over its map, and the classes of
        the first are the legend.
    release : float, each of shape (n, 2)
        Outlines of the release areas (m).
    zones : float, each of shape (n, 2)
        Outlines of zones (m).
    control_lines : (name, kind, coordinates of shape (n, 2))
    objects : (name, geometry)
        Exposed objects.
    extent : (west, south, east, north), optional
        Default: all that any of the maps shows.
    title, note : str

    Raises
    ------
    InputError
        There is no layer, one has no classes, other classes than the first, or other cells than
        the terrain.
    """
    if not layers:
        raise InputError("no map to draw", found="no layers", expected="one or more")
    for layer in layers:
        if layer.classes != layers[0].classes:
            raise InputError(
                f"layer {layer.stem!r} has other classes than {layers[0].stem!r}",
                found=[c.label for c in layer.classes],
                expected=str([c.label for c in layers[0].classes]),
            )
    panels = [_Panel(layer.title, _class_layer(grid, layer), layer.classes) for layer in layers]
    return _maps(
        grid, panels, [_Legend("", layers[0].classes)], title=title, note=note, release=release,
        zones=zones, control_lines=control_lines, objects=objects, extent=extent,
    )  # fmt: skip


@styled
def confidence_figure(
    grid: Grid,
    level: RasterLayer,
    uncertain: NDArray[np.bool_],
    *,
    release: Sequence[FloatArray] = (),
    zones: Sequence[FloatArray] = (),
    control_lines: Sequence[MapControlLine] = (),
    objects: Sequence[MapObject] = (),
    extent: Extent | None = None,
    title: str = "Where the sample of blocks leaves the level open",
    note: str = "",
) -> Figure:
    """Draw the hazard level, with fine black lines over the cells whose level is uncertain.

    Parameters
    ----------
    grid, level, release, zones, control_lines, objects, extent, title, note
        As in :func:`intensity_figure`.
    uncertain : bool, shape of the grid

    Raises
    ------
    InputError
        The layer has no classes, or the cells are not those of the terrain.
    """
    positions = _class_layer(grid, level)
    open_ = np.asarray(uncertain, bool)
    _check_shape(grid, "uncertain", open_.shape)
    reached = np.isfinite(positions)
    share = int((open_ & reached).sum()) / max(int(reached.sum()), 1)
    words = f"Statistically uncertain: {100.0 * share:.1f} % of the cells that have a level."
    return _maps(
        grid,
        [_Panel(level.title, positions, level.classes, open_, _PALE)],
        [_Legend("", level.classes, RasterClass(0, "statistically uncertain", INK))],
        title=title,
        note=f"{words} {note}".strip(),
        release=release,
        zones=zones,
        control_lines=control_lines,
        objects=objects,
        extent=extent,
    )


def level_changes(before: FloatArray, after: FloatArray) -> FloatArray:
    """What becomes of each cell's class: -1 lower, 0 the same, 1 higher; NaN without any.

    Parameters
    ----------
    before, after : same shape
        Positions among the classes; NaN where there is none, which is below the lowest.
    """
    old, new = np.nan_to_num(before, nan=-1.0), np.nan_to_num(after, nan=-1.0)
    return np.where((old < 0.0) & (new < 0.0), np.nan, np.sign(new - old))


@styled
def change_figure(
    grid: Grid,
    before: RasterLayer,
    after: RasterLayer,
    *,
    names: tuple[str, str] = ("Without barriers", "With barriers"),
    release: Sequence[FloatArray] = (),
    zones: Sequence[FloatArray] = (),
    control_lines: Sequence[MapControlLine] = (),
    objects: Sequence[MapObject] = (),
    extent: Extent | None = None,
    title: str = "What the barriers make of the hazard level",
    note: str = "",
) -> Figure:
    """Draw the hazard level before and after, and where it became lower or higher.

    Parameters
    ----------
    grid, release, zones, control_lines, objects, extent, title, note
        As in :func:`intensity_figure`.
    before, after : RasterLayer
        Maps of the same classes.
    names : (str, str)
        Over the first two maps.

    Raises
    ------
    InputError
        A layer has no classes, the two have others, or other cells than the terrain.
    """
    if before.classes != after.classes:
        raise InputError(
            "the level before and after has other classes",
            found=[c.label for c in after.classes],
            expected=str([c.label for c in before.classes]),
        )
    old, new = _class_layer(grid, before), _class_layer(grid, after)
    change = level_changes(old, new)
    kinds = tuple(
        RasterClass(number, *LEVEL_CHANGES[code])
        for number, code in ((-1, "lower"), (0, "same"), (1, "higher"))
    )
    area = grid.cell_size**2
    changes = "; ".join(
        f"{kind.label.lower()}: {thousands(np.count_nonzero(change == kind.value) * area)} m²"
        for kind in kinds
    )
    return _maps(
        grid,
        [
            _Panel(names[0], old, before.classes),
            _Panel(names[1], new, after.classes),
            _Panel("Change", class_positions(change, kinds), kinds),
        ],
        [_Legend("Level", before.classes), _Legend("Change", kinds)],
        title=title,
        note=f"{changes[:1].upper()}{changes[1:]}. {note}".strip(),
        release=release, zones=zones, control_lines=control_lines, objects=objects, extent=extent,
    )  # fmt: skip
