"""The gap on the map, and what closing it does to the map of the hazard."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from sassgis.gap.words import (
    quantity_name,
)
from sassgis.model.grid import FloatArray, Grid
from sassgis.report.figures import relief
from sassgis.report.figures.gap_figures import GAP_COLOURS, _heading, _note_height
from sassgis.report.figures.map_marks import draw_release, footprint
from sassgis.report.figures.style import (
    INK,
    SMALL,
    TEXT,
    WIDTH_IN,
    new_figure,
    styled,
)

_HALO = [withStroke(linewidth=2.0, foreground="white")]


@dataclass(frozen=True, slots=True)
class GapStretch:
    """A stretch of a fall line, or a station, with the gap there.

    Attributes
    ----------
    trace : float64, shape (n, 2)
        Coordinates (m).
    gap : float
        NaN where nothing was compared.
    sure : bool
        Whether the gap is distinguished from chance; others are drawn thin.
    """

    trace: FloatArray
    gap: float
    sure: bool = True


@styled
def gap_map_figure(
    grid: Grid,
    *,
    lines: Sequence[FloatArray],
    stretches: Sequence[GapStretch],
    stations: Mapping[str, GapStretch],
    release: FloatArray,
    stops: FloatArray,
    quantity: str,
    unit: str,
    title: str = "Where the gap lies",
    note: str = "",
) -> Figure:
    """Draw fall lines and stations over the relief, coloured by the gap of one quantity.

    Parameters
    ----------
    grid : Grid
    lines : float, each of shape (n, 2)
        Fall lines (m).
    stretches : sequence of GapStretch
        Parts of them on which the quantity was compared.
    stations : mapping of name to GapStretch
    release, stops : float, shape (n, 2)
        Release points and where observed blocks lie (m).
    quantity, unit : str
        Empty if no gap is to be shown.
    title, note : str
    """
    traces = [*lines, *(s.trace for s in stations.values()), release, stops]
    filled = [c for c in traces if len(c)]
    marks = np.concatenate(filled) if filled else np.empty((0, 2))
    marks = marks[np.isfinite(marks).all(axis=1)]
    box = footprint(grid, np.full(grid.shape, np.nan), marks)
    aspect = (box[3] - box[1]) / (box[2] - box[0])
    left, right = 0.62, 0.95
    map_w = WIDTH_IN - left - right
    map_h = map_w * aspect
    if map_h > 6.5:
        map_w, map_h = 6.5 / aspect, 6.5
        left = max(left, (WIDTH_IN - map_w - right + left) / 2.0)
    gaps = [s.gap for s in (*stretches, *stations.values()) if math.isfinite(s.gap)]
    largest = max((abs(g) for g in gaps), default=0.0)
    norm = Normalize(-largest or -1.0, largest or 1.0)
    keys = [
        "Thin dark lines: fall lines." if len(lines) else "",
        "Triangles: release." if len(release) else "",
        "Diamonds: where observed blocks lie." if len(stops) else "",
    ]
    if gaps:
        keys.insert(
            0,
            f"Colour: {quantity_name(quantity)}, observed less predicted; vermilion: more was "
            "observed, blue: less; thin: not distinguished from chance.",
        )
    text = " ".join(part for part in (*keys, note) if part)
    top, bottom = 0.52, 0.5 + _note_height(text)
    height = top + map_h + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, text)
    ax = figure.add_axes((left / WIDTH_IN, bottom / height, map_w / WIDTH_IN, map_h / height))
    ax.set_label("map")
    relief.draw_relief(ax, relief.window_of(grid, box).grid(grid))
    ax.add_collection(
        LineCollection(
            [c for c in lines if len(c) > 1], colors=INK, linewidths=0.5, alpha=0.5, zorder=5,
            gid="fall-lines",
        )
    )  # fmt: skip
    for part, width, z in ((stretches, 2.4, 6), (tuple(stations.values()), 3.2, 8)):
        known = [s for s in part if math.isfinite(s.gap) and len(s.trace) > 1]
        widths = np.array([width if s.sure else 0.45 * width for s in known])
        colours = GAP_COLOURS(norm([s.gap for s in known])) if known else INK
        for edge, paint, extra in ((True, INK, 0.8), (False, colours, 0.0)):
            ax.add_collection(
                LineCollection(
                    [s.trace for s in known], colors=paint, linewidths=widths + extra,
                    alpha=0.55 if edge else None, zorder=z if edge else z + 1,
                    gid=None if edge else "gaps",
                )
            )  # fmt: skip
    for name, station in stations.items():
        if len(station.trace) > 1 and not math.isfinite(station.gap):
            ax.plot(station.trace[:, 0], station.trace[:, 1], ls="--", color=INK, lw=1.1, zorder=7)
        if len(station.trace):
            east = station.trace[np.argmax(station.trace[:, 0])]
            ax.annotate(
                name, (float(east[0]), float(east[1])), xytext=(3, 0), va="center",
                textcoords="offset points", size=SMALL, weight="bold", path_effects=_HALO,
                zorder=22, clip_on=True, annotation_clip=True,
            )  # fmt: skip
    if len(release):
        draw_release(ax, (), release)
    ax.plot(
        stops[:, 0], stops[:, 1], "D", ms=3.2, mfc="white", mec=INK, mew=0.7, ls="none", zorder=11,
        gid="stops",
    )  # fmt: skip
    relief.map_axes(ax, box)
    taken = np.zeros((40, 40), bool)
    if marks.size:
        col = np.clip((marks[:, 0] - box[0]) / (box[2] - box[0]) * 40, 0, 39).astype(int)
        row = np.clip((box[3] - marks[:, 1]) / (box[3] - box[1]) * 40, 0, 39).astype(int)
        taken[row, col] = True
    corner = relief.emptiest_corner(
        taken, min(1.0, relief.FURNITURE_IN[0] / map_w), min(1.0, relief.FURNITURE_IN[1] / map_h)
    )
    relief.draw_furniture(ax, box, map_w, right=corner[0], top=corner[1])
    if gaps:
        bar_h = min(2.4, 0.8 * map_h)
        bar = figure.add_axes(
            (
                (left + map_w + 0.14) / WIDTH_IN, (bottom + map_h - bar_h - 0.18) / height,
                0.14 / WIDTH_IN, bar_h / height,
            ),
            label="legend",
        )  # fmt: skip
        figure.colorbar(ScalarMappable(norm, GAP_COLOURS), cax=bar).outline.set_linewidth(0.5)
        bar.tick_params(labelsize=SMALL)
        bar.grid(False)
        figure.text(
            (left + map_w + 0.14) / WIDTH_IN, (bottom + map_h) / height, unit, size=SMALL, va="top"
        )
    return figure


@styled
def map_change_figure(
    grid: Grid,
    before: FloatArray,
    after: FloatArray,
    change: FloatArray,
    *,
    names: tuple[str, str] = ("Before", "After"),
    unit: str,
    ramp: str,
    release: Sequence[FloatArray] = (),
    title: str,
    note: str = "",
) -> Figure:
    """Draw a map before and after, and the difference.

    Parameters
    ----------
    grid : Grid
    before, after, change : shape of the grid
        NaN where no rock comes.
    names : (str, str)
        Over the first two maps.
    unit : str
        Empty for shares, which are drawn in per cent.
    ramp : str
        Name of a matplotlib colour map for the first two.
    release : float, each of shape (n, 2)
        Outlines of the release areas (m).
    title, note : str
    """
    scale = 1.0 if unit else 100.0
    shown_unit = unit or "%"
    marks = [np.asarray(r, float).reshape(-1, 2) for r in release]
    others = np.concatenate(marks) if marks else np.empty((0, 2))
    box = footprint(grid, np.where(np.isfinite(change), change, np.nan), others)
    window = relief.window_of(grid, box)
    part = window.grid(grid)
    factor = -(-max(part.shape) // relief.MAX_CELLS)
    aspect = (box[3] - box[1]) / (box[2] - box[0])
    left, right, between = 0.6, 0.12, 0.1
    map_w = (WIDTH_IN - left - right - 2 * between) / 3.0
    map_h = map_w * aspect
    if map_h > 6.0:
        map_w, map_h = 6.0 / aspect, 6.0
    text = " ".join(p for p in (note, "Black outline: release area." if len(release) else "") if p)
    room = WIDTH_IN - relief.FURNITURE_IN[0] - 0.4
    top, bottom = 0.55, 1.0 + max(_note_height(text, room), relief.FURNITURE_IN[1] + 0.1)
    height = top + map_h + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, text, room)
    known = np.concatenate([scale * m[np.isfinite(m)] for m in (before, after)])
    # One cell must not take all the colour; the bar says that it is cut.
    high = float(np.quantile(known, 0.995)) if known.size else 1.0
    moved = np.abs(scale * change[np.isfinite(change)])
    moved = moved[moved > 0.0]
    most = float(np.quantile(moved, 0.98)) if moved.size else 1.0
    panels: tuple[tuple[str, FloatArray, str | Colormap, Normalize], ...] = (
        (names[0], scale * before, ramp, Normalize(0.0, high)),
        (names[1], scale * after, ramp, Normalize(0.0, high)),
        (
            f"{names[1]} less {names[0].lower()}",
            scale * change,
            GAP_COLOURS,
            Normalize(-most, most),
        ),
    )
    for i, (name, values, colours, norm) in enumerate(panels):
        x = left + i * (map_w + between)
        ax = figure.add_axes((x / WIDTH_IN, bottom / height, map_w / WIDTH_IN, map_h / height))
        ax.set_label("map")
        relief.draw_relief(ax, part)
        coarse = relief.coarsen(window.cut(values), factor, "mean")
        step = part.cell_size * factor
        picture = ax.imshow(
            np.ma.masked_invalid(coarse), cmap=colours, norm=norm, interpolation="nearest",
            extent=(
                part.west, part.west + coarse.shape[1] * step,
                part.north - coarse.shape[0] * step, part.north,
            ),
            alpha=0.9, zorder=2, gid="layer",
        )  # fmt: skip
        draw_release(ax, release)
        relief.map_axes(ax, box, parts=2)
        ax.set_title(name, size=TEXT, pad=3)
        if i:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)
        if i != 1:
            first = i == 0
            bar_w = map_w * (2.0 if first else 1.0) + (between if first else 0.0) - 0.3
            bar = figure.add_axes(
                ((x + 0.15) / WIDTH_IN, (bottom - 0.62) / height, bar_w / WIDTH_IN, 0.09 / height),
                label="legend",
            )
            figure.colorbar(
                picture, cax=bar, orientation="horizontal", extend="max" if first else "both"
            ).outline.set_linewidth(0.5)
            bar.tick_params(labelsize=SMALL)
            bar.set_xlabel(
                shown_unit if first else f"change ({unit or 'percentage points'})", size=SMALL
            )
            bar.grid(False)
    # Below the maps, where it hides nothing.
    size = (relief.FURNITURE_IN[0] + 0.1, relief.FURNITURE_IN[1] + 0.1)
    corner = figure.add_axes(
        (
            (WIDTH_IN - right - size[0]) / WIDTH_IN, 0.04 / height,
            size[0] / WIDTH_IN, size[1] / height,
        ),
        label="scale",
    )  # fmt: skip
    corner.set_axis_off()
    inch = (box[2] - box[0]) / map_w
    corner.set_xlim(0.0, size[0] * inch)
    corner.set_ylim(0.0, size[1] * inch)
    relief.draw_furniture(
        corner, (0.0, 0.0, size[0] * inch, size[1] * inch), size[0], right=True, top=True
    )
    return figure
