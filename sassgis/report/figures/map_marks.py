"""What is drawn on maps beside their values: zones, release, fall lines, control lines, extents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patheffects import withStroke

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.profiles import TraceSet
from sassgis.model.styles import BARRIER_STYLE
from sassgis.report.figures.relief import Extent
from sassgis.report.figures.style import BLUE, INK, SMALL, text_width_pt

#: Name, kind ("station", "wall" or "net") and line on the map, shape (n, 2), of a control line.
MapControlLine = tuple[str, str, FloatArray]

#: Name of an exposed object and its geometry.
MapObject = tuple[str, Any]

#: Names of objects beyond this number hide the map.
MAX_OBJECT_NAMES = 30
_OBJECT = "#5a4632"

#: Fall lines beyond this number hide the layer; an even choice of them is drawn.
MAX_LINES = 120

HALO = [withStroke(linewidth=2.0, foreground="white")]


def all_points(arrays: Sequence[FloatArray]) -> FloatArray:
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
    loose = all_points([a for a in areas if len(a) < 3] + ([] if points is None else [points]))
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


def draw_objects(ax: Axes, objects: Sequence[MapObject], box: Extent) -> None:
    """Draw exposed objects: areas and points filled, roads and lines pale with a dark edge."""
    for name, geometry in objects:
        seen = shapely.clip_by_rect(geometry, *box)
        if seen.is_empty:
            continue
        for part in shapely.get_parts(seen):
            xy = shapely.get_coordinates(part)
            if isinstance(part, shapely.Polygon):
                ax.fill(xy[:, 0], xy[:, 1], fc=_OBJECT, ec="white", lw=0.5, zorder=6)
            elif isinstance(part, shapely.Point):
                ax.plot(*xy.T, "D", ms=3.5, mfc=_OBJECT, mec="white", mew=0.4, zorder=6)
            else:
                ax.plot(*xy.T, color=_OBJECT, lw=2.4, zorder=5.5)
                ax.plot(*xy.T, color="white", lw=1.2, zorder=5.6)
        if len(objects) <= MAX_OBJECT_NAMES:
            _name_object(ax, name, seen, box)


def _name_object(ax: Axes, name: str, seen: Any, box: Extent) -> None:
    """Write a name beside an object, towards the middle of the map."""
    longest = max(shapely.get_parts(seen), key=lambda part: part.length)
    at = (
        longest.interpolate(0.3, normalized=True)
        if shapely.get_dimensions(longest) == 1
        else longest.centroid
    )
    left = at.x > (box[0] + box[2]) / 2.0
    ax.annotate(
        name, (at.x, at.y), xytext=(-4 if left else 4, 0), textcoords="offset points",
        ha="right" if left else "left", va="center", size=SMALL - 1.0, color=_OBJECT,
        path_effects=HALO, zorder=21, clip_on=True, annotation_clip=True, gid="object",
    )  # fmt: skip


def draw_lines(ax: Axes, lines: TraceSet) -> None:
    """Draw an even choice of the fall lines."""
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
        ax.plot(
            xy[:, 0],
            xy[:, 1],
            ls=dashes,
            color=colour,
            lw=width,
            zorder=9,
            gid=f"control_line-{name}",
        )
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
            path_effects=HALO,
            zorder=22,
            clip_on=True,
            annotation_clip=True,
        )


def line_key(
    release: bool,
    lines: bool,
    control_lines: Sequence[MapControlLine],
    zones: bool = False,
    objects: Sequence[MapObject] = (),
) -> str:
    """Say in words what the lines on the map are."""
    kinds = {kind for _, kind, _ in control_lines}
    drawn = {int(shapely.get_dimensions(geometry)) == 1 for _, geometry in objects}
    parts = [
        "black outline or triangle: release area" if release else "",
        "thin black lines: fall lines" if lines else "",
        "thin outlines: zones" if zones else "",
        "blue dashes: station" if "station" in kinds else "",
        "green line: wall" if "wall" in kinds else "",
        "green dots: net" if "net" in kinds else "",
        "brown: buildings and people" if False in drawn else "",
        "white with a brown edge: roads and lines" if True in drawn else "",
    ]
    text = "; ".join(part for part in parts if part)
    return f"{text[:1].upper()}{text[1:]}." if text else ""
