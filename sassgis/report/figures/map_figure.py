"""A map layer over the relief of the terrain."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedFormatter, FuncFormatter, NullLocator

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.profiles import TraceSet
from sassgis.model.results import Band, RasterClass, RasterLayer
from sassgis.model.styles import (
    BARRIER_STYLE,
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
from sassgis.report.figures.relief import Extent
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
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

#: Name, kind ("station", "wall" or "net") and line on the map, shape (n, 2), of a gate.
MapControlLine = tuple[str, str, FloatArray]

#: Fall lines beyond this number hide the layer; an even choice of them is drawn.
MAX_LINES = 120

_HALO = [withStroke(linewidth=2.0, foreground="white")]
_MAX_MAP_HEIGHT_IN = 7.2
#: Ways to say that a number has no unit.
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


def _points(arrays: Sequence[FloatArray]) -> FloatArray:
    """All coordinates of several arrays of shape (n, 2), one below the other."""
    parts = [np.asarray(a, float).reshape(-1, 2) for a in arrays]
    return np.concatenate(parts) if parts else np.empty((0, 2))


def footprint(grid: Grid, values: FloatArray, others: FloatArray) -> Extent:
    """Extent of what is shown, with a margin, cut to the grid.

    Parameters
    ----------
    grid : Grid
    values : shape of the grid
        Cells that are not NaN count.
    others : shape (n, 2)
        Coordinates that must be seen as well (m); those outside the grid are left out.

    Returns
    -------
    (west, south, east, north) : float
        The whole grid where nothing is shown.
    """
    west, south, east, north = grid.bounds
    rows, cols = np.nonzero(np.isfinite(values))
    inside = others[
        (others[:, 0] >= west)
        & (others[:, 0] <= east)
        & (others[:, 1] >= south)
        & (others[:, 1] <= north)
    ]
    x, y = inside[:, 0], inside[:, 1]
    if rows.size:
        cell = grid.cell_size
        x = np.append(x, [west + cols.min() * cell, west + (cols.max() + 1) * cell])
        y = np.append(y, [north - rows.min() * cell, north - (rows.max() + 1) * cell])
    if not x.size:
        return grid.bounds
    margin = max(0.08 * max(np.ptp(x), np.ptp(y)), 4.0 * grid.cell_size)
    box = [x.min() - margin, y.min() - margin, x.max() + margin, y.max() + margin]
    # A map much longer than wide (or the reverse) is hard to read: widen the short side.
    for low, high in ((0, 2), (1, 3)):
        lack = 0.5 * max(box[2] - box[0], box[3] - box[1]) - (box[high] - box[low])
        if lack > 0.0:
            box[low] -= lack / 2.0
            box[high] += lack / 2.0
    return (
        float(max(box[0], west)),
        float(max(box[1], south)),
        float(min(box[2], east)),
        float(min(box[3], north)),
    )


def draw_zones(ax: Axes, zones: Sequence[FloatArray]) -> None:
    """Draw the outlines of zones: thin dark lines with a pale edge."""
    rings = [np.asarray(ring, float) for ring in zones if len(ring) >= 3]
    for colour, width, gid in (("white", 1.5, "zones-edge"), (INK, 0.7, "zones")):
        ax.add_collection(
            PolyCollection(
                rings, closed=True, facecolors="none", edgecolors=colour, linewidths=width,
                alpha=1.0 if gid == "zones" else 0.6, zorder=4, gid=gid,
            )
        )  # fmt: skip


def draw_release(ax: Axes, areas: Sequence[FloatArray], points: FloatArray | None = None) -> None:
    """Draw release areas as outlines and release points as small triangles."""
    rings = [np.asarray(a, float) for a in areas if len(a) >= 3]
    loose = _points([a for a in areas if len(a) < 3] + ([] if points is None else [points]))
    if rings:
        ax.add_collection(
            PolyCollection(
                rings,
                closed=True,
                facecolors="none",
                edgecolors="white",
                linewidths=2.4,
                zorder=6,
            )
        )
        ax.add_collection(
            PolyCollection(
                rings,
                closed=True,
                facecolors="none",
                edgecolors=INK,
                linewidths=1.0,
                zorder=7,
                gid="release-areas",
            )
        )
    if loose.size:
        ax.plot(
            loose[:, 0],
            loose[:, 1],
            "^",
            ms=3.5,
            mfc=INK,
            mec="white",
            mew=0.4,
            zorder=7,
            gid="release-points",
        )


def _draw_lines(ax: Axes, lines: TraceSet) -> int:
    """Draw an even choice of the fall lines; gives back how many."""
    chosen = np.unique(np.linspace(0, len(lines) - 1, min(len(lines), MAX_LINES)).astype(int))
    paths = [
        np.column_stack(
            [
                lines.x[lines.offset[i] : lines.offset[i + 1]],
                lines.y[lines.offset[i] : lines.offset[i + 1]],
            ]
        )
        for i in chosen
    ]
    ax.add_collection(
        LineCollection(paths, colors=INK, linewidths=0.4, alpha=0.45, zorder=5, gid="fall-lines")
    )
    return len(paths)


#: As on the map in QGIS.
_BARRIER = BARRIER_STYLE.symbol.colour
_CONTROL_LINE_LINE = {
    "station": (BLUE, "--", 1.4),
    "wall": (_BARRIER, "-", 2.2),
    "net": (_BARRIER, ":", 2.2),
}


def draw_map_control_lines(
    ax: Axes, control_lines: Sequence[MapControlLine], box: Extent, points_per_metre: float
) -> None:
    """Draw stations, walls and nets with their names, written inside the map."""
    for name, kind, coords in control_lines:
        xy = np.asarray(coords, float).reshape(-1, 2)
        if not xy.size:
            continue
        colour, dashes, width = _CONTROL_LINE_LINE[kind]
        ax.plot(xy[:, 0], xy[:, 1], "-", color="white", lw=width + 1.6, zorder=8)
        ax.plot(xy[:, 0], xy[:, 1], ls=dashes, color=colour, lw=width, zorder=9, gid=f"gate-{name}")
        seen = shapely.get_coordinates(shapely.clip_by_rect(shapely.linestrings(xy), *box))
        if not seen.size:
            continue
        east = seen[np.argmax(seen[:, 0])]
        fits = (box[2] - east[0]) * points_per_metre > text_width_pt(name) + 6.0
        ax.annotate(
            name,
            (float(east[0]), float(east[1])),
            xytext=(3 if fits else -3, 0),
            textcoords="offset points",
            ha="left" if fits else "right",
            size=SMALL,
            color=colour,
            weight="bold",
            va="center",
            path_effects=_HALO,
            zorder=22,
            clip_on=True,
            annotation_clip=True,
        )


def line_key(
    release: bool, lines: bool, control_lines: Sequence[MapControlLine], zones: bool = False
) -> str:
    """Say in words what the lines on the map are."""
    kinds = {kind for _, kind, _ in control_lines}
    parts = [
        "black outline or triangle: release area" if release else "",
        "thin black lines: fall lines" if lines else "",
        "thin outlines: zones" if zones else "",
        "blue dashes: station" if "station" in kinds else "",
        "green line: wall" if "wall" in kinds else "",
        "green dots: net" if "net" in kinds else "",
    ]
    text = "; ".join(part for part in parts if part)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


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
    marks = _points([*release, *([] if release_points is None else [release_points])])
    box = footprint(grid, values, marks) if extent is None else cut_extent(extent, grid)
    window = relief.window_of(grid, box)
    part = window.grid(grid)

    notes = [layer.note if note is None else note]
    if lines is not None and len(lines) > MAX_LINES:
        notes.append(f"{count(MAX_LINES, 'fall line')} of {thousands(len(lines))} are drawn.")
    factor = -(-max(part.shape) // relief.MAX_CELLS)
    largest = "highest class" if classes else "largest value"
    if factor > 1:
        notes.append(
            f"Drawn with one dot for {factor} × {factor} cells; each shows the {largest} in it."
        )
    notes.append(
        line_key(bool(marks.size), lines is not None and len(lines) > 0, control_lines, bool(zones))
    )

    part_values = window.cut(values)
    coarse = relief.coarsen(part_values, factor, "max")
    # Classes and colours are those of the map in QGIS, and do not depend on the data: maps with
    # the same limits can be laid side by side.
    labels = class_labels(layer.breaks, "") if layer.breaks and not classes else []
    if labels:
        coarse = class_numbers(coarse, layer.breaks)
    cmap, norm = _colours(layer, classes, values)

    # Everything is placed in inches: an equal-aspect map leaves gaps in automatic layouts.
    left, legend_gap, bar_w = 0.62, 0.14, 0.14
    longest = max((text_width_pt(label) for label in labels), default=0.0)
    right = max(0.85, legend_gap + bar_w + 0.12 + longest / 72.0)
    if classes:
        longest = max(text_width_pt(entry.label) for entry in classes) / 72.0
        legend_w = min(SIGN_IN[0] + 0.1 + longest, 1.7)
        right = max(0.85, legend_gap + legend_w)
    aspect = (box[3] - box[1]) / (box[2] - box[0])
    map_w = WIDTH_IN - left - right
    map_h = map_w * aspect
    if map_h > _MAX_MAP_HEIGHT_IN:
        map_w, map_h = _MAX_MAP_HEIGHT_IN / aspect, _MAX_MAP_HEIGHT_IN
        left = max(left, (WIDTH_IN - map_w - right + left) / 2.0)
    heading = title or (
        layer.title if band == 0 else f"{layer.title}: {shown.description or shown.name}"
    )
    heading = wrap(heading, WIDTH_IN - 0.4, TITLE)
    below = wrap("\n".join(n for n in notes if n), WIDTH_IN - 0.8)
    unit = wrap("" if shown.unit in _UNITLESS else shown.unit, right + 0.1)
    top = 0.12 + 0.18 * lines_in(heading) + 0.08
    bottom = 0.48 + 0.135 * lines_in(below) + 0.08
    height = map_h + top + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    ax = figure.add_axes((left / WIDTH_IN, bottom / height, map_w / WIDTH_IN, map_h / height))
    ax.set_label("map")

    relief.draw_relief(ax, part)
    step = part.cell_size * factor
    cells = (
        part.west,
        part.north - coarse.shape[0] * step,
        part.west + coarse.shape[1] * step,
        part.north,
    )
    metres_per_inch = (box[2] - box[0]) / map_w
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
    if lines is not None and len(lines):
        _draw_lines(ax, lines)
    draw_release(ax, release, release_points)
    draw_map_control_lines(ax, control_lines, box, 72.0 * map_w / (box[2] - box[0]))
    relief.map_axes(ax, box)
    corner = relief.emptiest_corner(
        np.isfinite(part_values),
        min(1.0, relief.FURNITURE_IN[0] / map_w),
        min(1.0, relief.FURNITURE_IN[1] / map_h),
    )
    relief.draw_furniture(ax, box, map_w, right=corner[0], top=corner[1])
    if not np.isfinite(part_values).any():
        ax.text(
            0.5,
            0.5,
            "no values here",
            transform=ax.transAxes,
            ha="center",
            va="center",
            size=TEXT,
            path_effects=_HALO,
            zorder=23,
        )

    legend_x, legend_top = left + map_w + legend_gap, bottom + map_h
    if classes:
        draw_class_legend(figure, classes, legend_x, legend_top, legend_w)
    else:
        _colour_legend(
            figure, ScalarMappable(norm, cmap), labels, unit, x=legend_x, top=legend_top,
            bar_w=bar_w, map_h=map_h,
        )  # fmt: skip
    figure.text(
        left / WIDTH_IN,
        1.0 - 0.1 / height,
        heading,
        size=TITLE,
        weight="bold",
        va="top",
        gid="title",
    )
    figure.text(
        left / WIDTH_IN,
        (bottom - 0.46) / height,
        below,
        size=SMALL,
        color=GREY,
        va="top",
        gid="note",
    )
    return figure


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


def cut_extent(extent: Extent, grid: Grid) -> Extent:
    """Cut an extent to the grid."""
    west, south, east, north = grid.bounds
    box = (
        max(extent[0], west),
        max(extent[1], south),
        min(extent[2], east),
        min(extent[3], north),
    )
    if box[0] >= box[2] or box[1] >= box[3]:
        raise InputError(
            "the extent of the map lies outside the terrain",
            field="extent",
            found=tuple(extent),
            expected=f"part of {grid.bounds}",
        )
    return box
