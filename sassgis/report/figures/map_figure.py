"""A map layer over the relief of the terrain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FuncFormatter, NullLocator
from numpy.typing import NDArray

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.profiles import TraceSet
from sassgis.model.results import Band, RasterClass, RasterLayer
from sassgis.model.styles import (
    class_colours,
    class_labels,
    class_limits,
    zero_is_nothing,
)
from sassgis.report.figures import relief
from sassgis.report.figures.class_maps import (
    LAYER_ALPHA,
    SIGN_IN,
    class_positions,
    draw_class_legend,
    draw_classes,
)
from sassgis.report.figures.map_marks import (
    HALO,
    MAX_LINES,
    MapControlLine,
    MapObject,
    all_points,
    cut_extent,
    draw_lines,
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
    SMALL,
    TEXT,
    TITLE,
    WIDTH_IN,
    count,
    lines_in,
    new_figure,
    styled,
    text_width_pt,
    wrap,
)
from sassgis.report.number_text import thousands

_MAX_MAP_HEIGHT_IN = 7.2
_LEGEND_GAP_IN, _BAR_IN = 0.14, 0.14
#: Units that mean that a number has no unit.
_UNITLESS = ("", "1", "-", "–", "class")


def shown_values(band: Band) -> FloatArray:
    """Values of a band as the map shows them, float64 with NaN where it stays clear.

    As on the map in QGIS: see :func:`sassgis.model.styles.zero_is_nothing`.
    """
    values = np.asarray(band.values, float)
    return np.where(values == 0.0, np.nan, values) if zero_is_nothing(band.unit) else values


def class_numbers(values: FloatArray, breaks: Sequence[float]) -> FloatArray:
    """Position of each value among the classes of ``class_limits``; NaN where there is none.

    A limit belongs to the class above it.
    """
    lower = np.array([low for low, _ in class_limits(breaks)])
    number = np.searchsorted(lower, values, side="right") - 1.0
    return np.where(np.isfinite(values) & (number >= 0.0), number, np.nan)


def _ramp_norm(values: FloatArray) -> Normalize:
    """Colours from the least to the greatest value."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return Normalize(low, high if high > low else low + max(1.0, abs(low)))


def _colours(
    layer: RasterLayer, classes: Sequence[RasterClass], values: FloatArray
) -> tuple[Colormap, Normalize]:
    """Colours of classes, of those of a layer's breaks, or of the range of its values."""
    if classes:
        colours = [entry.colour for entry in sorted(classes, key=lambda entry: entry.value)]
    elif layer.breaks:
        colours = class_colours(layer.breaks, layer.ramp)
    else:
        return mpl.colormaps[layer.ramp or "viridis"], _ramp_norm(values)
    return ListedColormap(colours), BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours))


def _value_label(value: float, _: object = None) -> str:
    """Write a value of the ramp with as few digits as it needs."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.4g}".replace("-", "\u2212")
    return thousands(value) if abs(value) >= 1e4 else f"{value:.0e}".replace("-", "\u2212")


@styled
def map_figure(
    grid: Grid,
    layer: RasterLayer,
    band: int = 0,
    *,
    release: Sequence[FloatArray] = (),
    release_points: FloatArray | None = None,
    lines: TraceSet | None = None,
    control_lines: Sequence[MapControlLine] = (),
    zones: Sequence[FloatArray] = (),
    objects: Sequence[MapObject] = (),
    extent: Extent | None = None,
    title: str | None = None,
    note: str | None = None,
) -> Figure:
    """Draw a map layer over the relief: in its classes, those of its breaks, or as a ramp.

    Parameters
    ----------
    grid : Grid
        Terrain; the layer lies on the same cells.
    layer : RasterLayer
    band : int
        Band of the layer to show.
    release : float, each of shape (n, 2)
        Outlines of the release areas (m); arrays of one or two rows are drawn as points.
    release_points : float, shape (n, 2), optional
    lines : TraceSet, optional
        Fall lines. Of more than ``MAX_LINES`` an even choice is drawn, and the map says so.
    control_lines : (name, kind, coordinates of shape (n, 2))
        Stations, walls and nets.
    zones : float, each of shape (n, 2)
        Outlines of zones (m).
    objects : (name, geometry)
        Exposed objects.
    extent : (west, south, east, north), optional
        Part of the grid to show (m); default: the layer and the release,
        with a margin.
    title : str, optional
        Default: the title of the layer, with the name of the band if it is not the first.
    note : str, optional
        Below the map; default: that of the layer.

    Raises
    ------
    InputError
        There is no such band, it does not fit the grid, or the extent lies outside the grid.
    """
    shown, classes, values = _values(grid, layer, band)
    marks = all_points([*release, *([] if release_points is None else [release_points])])
    box = footprint(grid, values, marks) if extent is None else cut_extent(extent, grid)
    window = relief.window_of(grid, box)
    part, part_values = window.grid(grid), window.cut(values)
    factor = -(-max(part.shape) // relief.MAX_CELLS)
    key = line_key(
        bool(marks.size),
        lines is not None and len(lines) > 0,
        control_lines,
        bool(zones),
        objects,
    )
    notes = [layer.note if note is None else note, *_reductions(factor, lines, classes), key]
    coarse = relief.coarsen(part_values, factor, "max")
    # Classes and colours are those of the map in QGIS, and do not depend on the data: maps with
    # the same limits can be laid side by side.
    labels = class_labels(layer.breaks, "") if layer.breaks and not classes else []
    if labels:
        coarse = class_numbers(coarse, layer.breaks)
    cmap, norm = _colours(layer, classes, values)
    heading = title or (
        layer.title if band == 0 else f"{layer.title}: {shown.description or shown.name}"
    )
    heading = wrap(heading, WIDTH_IN - 0.4, TITLE)
    below = wrap("\n".join(n for n in notes if n), WIDTH_IN - 0.8)
    page = _placed(box, [entry.label for entry in classes], labels, heading, below)
    figure = new_figure(WIDTH_IN, page.height, constrained=False)
    ax = figure.add_axes(
        (
            page.left / WIDTH_IN,
            page.bottom / page.height,
            page.map_w / WIDTH_IN,
            page.map_h / page.height,
        )
    )
    ax.set_label("map")
    relief.draw_relief(ax, part)
    metres_per_inch = (box[2] - box[0]) / page.map_w
    cells = _extent_of(part, coarse.shape, factor)
    if classes:
        draw_classes(ax, coarse, classes, extent=cells, metres_per_inch=metres_per_inch)
    else:
        ax.imshow(
            np.ma.masked_invalid(coarse),
            cmap=cmap,
            norm=norm,
            extent=(cells[0], cells[2], cells[1], cells[3]),
            interpolation="nearest",
            alpha=LAYER_ALPHA,
            zorder=2,
            gid="layer",
        )
    draw_zones(ax, zones)
    draw_objects(ax, objects, box)
    if lines is not None and len(lines):
        draw_lines(ax, lines)
    draw_release(ax, release, release_points)
    draw_map_control_lines(ax, control_lines, box, 72.0 / metres_per_inch)
    relief.map_axes(ax, box)
    _draw_furniture(ax, box, np.isfinite(part_values), page)
    legend_x, legend_top = page.left + page.map_w + _LEGEND_GAP_IN, page.bottom + page.map_h
    if classes:
        draw_class_legend(figure, classes, legend_x, legend_top, page.legend_w)
    else:
        unit = wrap("" if shown.unit in _UNITLESS else shown.unit, page.right + 0.1)
        _colour_legend(
            figure, ScalarMappable(norm, cmap), labels, unit, x=legend_x, top=legend_top,
            bar_w=_BAR_IN, map_h=page.map_h,
        )  # fmt: skip
    x = page.left / WIDTH_IN
    figure.text(
        x, 1.0 - 0.1 / page.height, heading, size=TITLE, weight="bold", va="top", gid="title"
    )
    figure.text(
        x, (page.bottom - 0.46) / page.height, below, size=SMALL, color=GREY, va="top", gid="note"
    )
    return figure


def _values(
    grid: Grid, layer: RasterLayer, band: int
) -> tuple[Band, Sequence[RasterClass], FloatArray]:
    """A band, its classes (none for a ramp or breaks), and its values or classes' positions."""
    if not 0 <= band < len(layer.bands):
        raise InputError(
            f"layer {layer.stem!r} has no such band",
            found=band,
            expected=f"0 to {len(layer.bands) - 1}",
        )
    shown = layer.bands[band]
    classes = layer.classes if band == 0 else ()
    if classes:
        values = class_positions(np.asarray(shown.values, float), classes)
    else:
        values = shown_values(shown)
    if values.shape != grid.shape:
        raise InputError(
            f"layer {layer.stem!r} does not lie on the cells of the terrain",
            found=f"{values.shape[0]} x {values.shape[1]} cells",
            expected=f"{grid.shape[0]} x {grid.shape[1]}",
        )
    return shown, classes, values


def _reductions(
    factor: int, lines: TraceSet | None, classes: Sequence[RasterClass]
) -> Iterator[str]:
    """What the figure leaves out of a large map."""
    if lines is not None and len(lines) > MAX_LINES:
        yield f"{count(MAX_LINES, 'fall line')} of {thousands(len(lines))} are drawn."
    if factor > 1:
        largest = "highest class" if classes else "largest value"
        yield f"Drawn with one dot for {factor} × {factor} cells; each shows the {largest} in it."


@dataclass(frozen=True, slots=True)
class _Page:
    """Where the parts of the figure stand (in, from the lower left corner)."""

    left: float
    bottom: float
    map_w: float
    map_h: float
    right: float
    legend_w: float
    height: float


def _placed(
    box: Extent, class_names: Sequence[str], labels: Sequence[str], heading: str, below: str
) -> _Page:
    """Place the map and make room for its legend, heading and note.

    Everything is placed in inches: an equal-aspect map leaves gaps in automatic layouts.
    """
    left, legend_w = 0.62, 0.0
    longest = max((text_width_pt(label) for label in labels), default=0.0)
    right = max(0.85, _LEGEND_GAP_IN + _BAR_IN + 0.12 + longest / 72.0)
    if class_names:
        longest = max(text_width_pt(name) for name in class_names) / 72.0
        legend_w = min(SIGN_IN[0] + 0.1 + longest, 1.7)
        right = max(0.85, _LEGEND_GAP_IN + legend_w)
    aspect = (box[3] - box[1]) / (box[2] - box[0])
    map_w = WIDTH_IN - left - right
    map_h = map_w * aspect
    if map_h > _MAX_MAP_HEIGHT_IN:
        map_w, map_h = _MAX_MAP_HEIGHT_IN / aspect, _MAX_MAP_HEIGHT_IN
        left = max(left, (WIDTH_IN - map_w - right + left) / 2.0)
    top = 0.12 + 0.18 * lines_in(heading) + 0.08
    bottom = 0.48 + 0.135 * lines_in(below) + 0.08
    return _Page(left, bottom, map_w, map_h, right, legend_w, map_h + top + bottom)


def _extent_of(part: Grid, shape: tuple[int, ...], factor: int) -> Extent:
    """Extent of coarsened cells, which may reach beyond the part."""
    step = part.cell_size * factor
    return part.west, part.north - shape[0] * step, part.west + shape[1] * step, part.north


def _draw_furniture(ax: Axes, box: Extent, known: NDArray[np.bool_], page: _Page) -> None:
    """Draw scale bar and north arrow where they hide least, and say where the map is empty."""
    corner = relief.emptiest_corner(
        known,
        min(1.0, relief.FURNITURE_IN[0] / page.map_w),
        min(1.0, relief.FURNITURE_IN[1] / page.map_h),
    )
    relief.draw_furniture(ax, box, page.map_w, right=corner[0], top=corner[1])
    if not known.any():
        ax.text(
            0.5, 0.5, "no values here", transform=ax.transAxes, ha="center", va="center",
            size=TEXT, path_effects=HALO, zorder=23,
        )  # fmt: skip


def _colour_legend(
    figure: Figure,
    colours: ScalarMappable,
    labels: Sequence[str],
    unit: str,
    *,
    x: float,
    top: float,
    bar_w: float,
    map_h: float,
) -> None:
    """Draw the bar of colours with its unit above, from its upper left corner (in)."""
    width, height = figure.get_size_inches()
    unit_h = 0.15 * lines_in(unit)
    bar_h = min(map_h - unit_h, 0.42 * len(labels) if labels else 3.0)
    legend = figure.add_axes(
        (x / width, (top - unit_h - bar_h) / height, bar_w / width, bar_h / height),
        label="legend",
    )
    bar = figure.colorbar(
        colours,
        cax=legend,
        ticks=list(range(len(labels))) if labels else None,
        format=FixedFormatter(labels) if labels else FuncFormatter(_value_label),
        alpha=LAYER_ALPHA,
    )
    bar.ax.yaxis.set_minor_locator(NullLocator())
    if labels:
        legend.tick_params(length=0)
    bar.outline.set_linewidth(0.5)
    legend.tick_params(labelsize=SMALL)
    legend.grid(False)
    figure.text(x / width, top / height, unit, size=SMALL, va="top", gid="unit")
