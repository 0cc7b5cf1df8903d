"""The one map figure: layers over the relief in panels of one extent, with marks and a legend.

A map is described by its panels (values with their colours) and its marks; :func:`draw_maps` draws
all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import rasterio.features
import shapely
from affine import Affine
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from sassgis.grid import FloatArray, Grid
from sassgis.report.figures import map_marks, relief, style
from sassgis.settings.hazard_rules import HazardLevel
from sassgis.settings.languages import joined, phrase, translated
from sassgis.settings.results import Band, RasterClass, RasterLayer, thousands
from sassgis.settings.styles import class_colours, class_labels, class_limits, zero_is_nothing

if TYPE_CHECKING:
    import geopandas as gpd

#: The tallest maps of a figure together (in).
_MAX_HEIGHT_IN = 7.6
#: Units that mean that a number has no unit.
_UNITLESS = ("", "1", "-", "–", "class")
#: Fine black lines that fall to the right, over other colours.
_FALLING: dict[str, Any] = {"hatch": "\\" * 7, "fc": "none", "lw": 0.0, "hatch_linewidth": 0.5}


def shown_values(band: Band) -> FloatArray:
    """Return values of a band as QGIS shows them too: float64, NaN where the map stays clear."""
    values = np.asarray(band.values, float)
    return np.where(values == 0.0, np.nan, values) if zero_is_nothing(band.unit) else values


def class_numbers(values: FloatArray, breaks: Sequence[float]) -> FloatArray:
    """Return positions among ``class_limits``, a limit in the class above it; NaN outside."""
    lower = np.array([low for low, _ in class_limits(breaks)])
    number = np.searchsorted(lower, values, side="right") - 1.0
    return np.where(np.isfinite(values) & (number >= 0.0), number, np.nan)


def class_positions(values: NDArray[Any], classes: Sequence[RasterClass]) -> FloatArray:
    """Return position of each value among the classes, in ascending order; NaN where it is none."""
    ordered = np.array(sorted(entry.value for entry in classes), float)
    known = np.nan_to_num(np.asarray(values, float), nan=-np.inf)
    place = np.clip(np.searchsorted(ordered, known), 0, ordered.size - 1)
    return np.where(ordered[place] == known, place.astype(float), np.nan)


@dataclass(frozen=True, slots=True)
class MapPanel:
    """One map of a figure."""

    # Of the colours, shape of the grid; NaN where the map stays clear. None: only marks are drawn.
    values: FloatArray | None
    colours: Colormap
    norm: Normalize
    title: str = ""
    classes: Sequence[RasterClass] = ()  # in the order of their positions
    over: NDArray[np.bool_] | None = None  # cells with fine black lines over them
    alpha: float = map_marks.LAYER_ALPHA
    together: str = "max"  # what a dot for several cells shows: "max" or "mean"


def class_panel(
    values: NDArray[Any], classes: Sequence[RasterClass], title: str = "", **more: Any
) -> MapPanel:
    """Return a map of classes; values that are none stay clear."""
    ordered = sorted(classes, key=lambda entry: entry.value)
    colours = ListedColormap([map_marks.fill_of(c) for c in ordered])
    norm = BoundaryNorm(np.arange(len(ordered) + 1) - 0.5, len(ordered))
    return MapPanel(class_positions(values, classes), colours, norm, title, ordered, **more)


def class_signs(classes: Sequence[RasterClass], over: str = "") -> list[Patch]:
    """Return signs of a legend, the highest value first; ``over`` is the name of fine lines."""
    signs = []
    for entry in sorted(classes, key=lambda entry: -entry.value):
        how: dict[str, Any] = {
            "fc": map_marks.fill_of(entry),
            "lw": 0.6,
            "alpha": map_marks.LAYER_ALPHA,
            "ec": style.GREY,
        }
        if entry.hatched:
            how |= {"hatch": "////", "ec": entry.colour}
        signs.append(Patch(label=style.wrap(entry.label, 1.6), **how))
    if over:
        signs.append(Patch(label=style.wrap(over, 1.6), **_FALLING))
    return signs


def columns_of(panels: int, aspect: float, width_in: float, height_in: float) -> int:
    """Return the number of columns that makes equal panels largest in the room for all (in)."""

    def width(columns: int) -> float:
        rows = -(-panels // columns)
        return min((width_in - 0.14 * columns) / columns, (height_in / rows - 0.22) / aspect)

    return max(range(1, panels + 1), key=lambda columns: (width(columns), -columns))


def draw_maps(
    view: relief.MapView,
    panels: Sequence[MapPanel],
    marks: map_marks.MapMarks,
    title: str,
    notes: Sequence[str],
    *,
    columns: int = 0,
    more: Callable[[Axes], None] | None = None,
) -> tuple[style.Sheet, list[Axes]]:
    """Draw maps of one extent side by side; ``more`` draws what is neither value nor mark.

    Maps have as many columns as make them largest.
    """
    n = len(panels)
    columns = columns or columns_of(n, view.aspect, style.WIDTH_IN - 0.8, _MAX_HEIGHT_IN)
    rows = -(-n // columns)
    sheet = style.Sheet(
        title, joined("\n", filter(None, notes)), _MAX_HEIGHT_IN + 0.6, compressed=True
    )
    grid = sheet.figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    axes: list[Axes] = list(grid.flat[:n])
    for ax in grid.flat[n:]:
        ax.remove()
    relief.draw_relief(view, *axes)
    for number, (ax, panel) in enumerate(zip(axes, panels, strict=True)):
        ax.set_label("map")
        _draw_values(ax, panel, view)
        if more is not None:
            more(ax)
        marks.draw(ax, view.box)
        relief.map_axes(ax, view.box, {1: 5, 2: 3}.get(columns, 2))
        # Coordinates only left of the first column and below the last map of each.
        ax.tick_params(labelleft=not number % columns, labelbottom=number + columns >= n)
        if number % columns:
            ax.set_ylabel("")
        if number + columns < n:
            ax.set_xlabel("")
        ax.set_title(panel.title, size=style.TEXT, pad=3.0)
    relief.scale_bar(axes[(rows - 1) * columns], view.box)
    return sheet, axes


def finish(
    sheet: style.Sheet, axes: Sequence[Axes], marks: map_marks.MapMarks, view: relief.MapView
) -> Figure:
    """Make the figure as high as its maps, whose legends are drawn, and write the names.

    Nothing can be added afterwards.
    """
    style.translate_texts(sheet.figure)
    sheet.lay_out(axes)
    dpi = sheet.figure.dpi
    # Labels and signs beyond the edges of the maps.
    rows = {round(ax.get_window_extent().y0): ax for ax in axes}
    bars = [ax for ax in sheet.figure.axes if ax.get_label() == "legend"]
    heights = []
    for y, ax in rows.items():
        # A bar beside several rows belongs to none of them; only the lowest has signs below it.
        signs = bars if y == min(rows) else []
        top, *below = filter(None, (own.get_tightbbox() for own in (ax, *signs)))
        heights.append(float(top.y1 - min(box.y0 for box in (top, *below))))
    sheet.set_height((sum(heights) + 8.0 * len(heights)) / dpi)
    sheet.lay_out(axes)
    for ax in axes:
        width_pt = 72.0 * ax.get_window_extent().width / dpi
        marks.write_names(ax, view.box, width_pt / view.width_m)
    sheet.keep_places()
    return sheet.figure


def _draw_values(ax: Axes, panel: MapPanel, view: relief.MapView) -> None:
    if panel.values is None:
        return
    values, (west, south, east, north) = view.coarse(view.cut(panel.values), panel.together)
    ax.imshow(
        np.ma.masked_invalid(values), cmap=panel.colours, norm=panel.norm,
        extent=(west, east, south, north), interpolation="nearest", alpha=panel.alpha, zorder=2,
        gid="layer",
    )  # fmt: skip
    cell = (east - west) / values.shape[1]
    place = Affine(cell, 0.0, west, 0.0, -cell, north)

    def outline(cells: NDArray[np.bool_], **how: Any) -> None:
        found = rasterio.features.shapes(cells.astype(np.uint8), mask=cells, transform=place)
        map_marks.draw_areas(ax, [shapely.geometry.shape(part) for part, _ in found], **how)

    for k, entry in enumerate(panel.classes):
        if entry.hatched:
            how: dict[str, Any] = {"hatch": "////", "fc": "none", "ec": entry.colour, "lw": 0.0}
            outline(values == k, alpha=panel.alpha, gid="stripes", **how)
    if panel.over is not None:
        over, _ = view.coarse(view.cut(panel.over.astype(float)), "max")
        outline(over > 0.0, gid="uncertain", **_FALLING)


def colour_bar(axes: Sequence[Axes], panel: MapPanel, words: str, **how: Any) -> None:
    """Draw the bar of the colours of some maps next to them."""
    figure = axes[0].get_figure()
    assert isinstance(figure, Figure)
    colours = ScalarMappable(panel.norm, panel.colours)
    look: dict[str, Any] = {"format": FuncFormatter(_value_label), "shrink": 0.6, "aspect": 22.0}
    look |= {"pad": 0.02, "alpha": panel.alpha, **how}
    bar = figure.colorbar(colours, ax=list(axes), **look)
    bar.outline.set_linewidth(0.5)
    bar.ax.set_label("legend")
    bar.ax.tick_params(labelsize=style.SMALL)
    bar.ax.grid(False)
    bar.set_label(words, size=style.SMALL)


def _value_label(value: float, _: object = None) -> str:
    """Write a value of the ramp with as few digits as it needs."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.4g}".replace("-", "\u2212")
    return thousands(value) if abs(value) >= 1e4 else f"{value:.0e}".replace("-", "\u2212")


def shown_points(marks: map_marks.MapMarks) -> FloatArray:
    """Return points that a map of one layer shows in any case, shape (n, 2)."""
    corners = [shapely.get_coordinates(shapely.box(*p.bounds)) for p, _ in marks.zones]
    return map_marks.all_points([*marks.release, *corners])


def shown_part(
    grid: Grid, layers: Sequence[RasterLayer], points: FloatArray
) -> tuple[relief.MapView, list[RasterLayer]]:
    """Return what maps of some layers show, with some points: its view, and the layers cut to it.

    They keep their first bands alone: another process then gets no more than it draws.
    """
    seen = np.full(grid.shape, np.nan)
    for layer in layers:
        band, classes = layer.bands[0], layer.classes
        own = class_positions(band.values, classes) if classes else shown_values(band)
        seen[np.isfinite(own)] = 1.0
    view = relief.view_of(grid, relief.footprint(grid, seen, points))
    cut = (replace(layer.bands[0], values=view.cut(layer.bands[0].values)) for layer in layers)
    return view, [replace(layer, bands=(band,)) for layer, band in zip(layers, cut, strict=True)]


def _layer_panel(layer: RasterLayer) -> tuple[MapPanel, FloatArray]:
    """Return a layer in its classes, those of its breaks, or as a ramp; and what it shows."""
    values = shown_values(layer.bands[0])
    if layer.classes:
        panel = class_panel(layer.bands[0].values, layer.classes)
        assert panel.values is not None
        return panel, panel.values
    # Classes and colours are those of the map in QGIS, and do not depend on the data: maps with
    # the same limits can be laid side by side.
    if layer.breaks:
        named = zip(
            class_labels(layer.breaks, ""), class_colours(layer.breaks, layer.ramp), strict=True
        )
        classes = [RasterClass(k, label, colour) for k, (label, colour) in enumerate(named)]
        return class_panel(class_numbers(values, layer.breaks), classes), values
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    norm = Normalize(low, high if high > low else low + max(1.0, abs(low)))
    return MapPanel(values, mpl.colormaps[layer.ramp or "viridis"], norm), values


def coarse_note(view: relief.MapView, what: str) -> str:
    """Say what a dot of a large map shows; nothing where each cell has its own."""
    if view.factor == 1:
        return ""
    n = view.factor
    return phrase("One dot represents {} × {} cells and shows their {}.", n, n, phrase(what))


def legend_beside(ax: Axes, signs: Sequence[Patch], heading: str) -> None:
    """Draw the signs of classes right of a map."""
    ax.legend(
        handles=signs, loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.6,
        title=heading or None, title_fontsize=style.SMALL, alignment="left", handlelength=2.4,
        handleheight=1.4, labelspacing=0.7,
    )  # fmt: skip


@style.house_style()
def map_figure(
    grid: Grid,
    layer: RasterLayer,
    marks: map_marks.MapMarks | None = None,
) -> Figure:
    """Draw the first band of a layer over the relief; its note is for the caption."""
    marks = marks or map_marks.MapMarks()
    panel, values = _layer_panel(layer)
    view = relief.view_of(grid, relief.footprint(grid, values, shown_points(marks)))
    kind = "highest class" if layer.classes else "largest value"
    notes = [
        marks.left_out(), "" if marks.zones else coarse_note(view, kind), marks.key(view.box),
    ]  # fmt: skip
    known = np.isfinite(view.cut(values))
    shown = replace(panel, values=None) if marks.zones else panel
    sheet, axes = draw_maps(view, [shown], marks, layer.title, notes)
    (ax,) = axes
    if not known.any():
        ax.text(
            0.5, 0.5, "no values here", transform=ax.transAxes, ha="center", va="center",
            size=style.TEXT, path_effects=style.halo(), zorder=23,
        )  # fmt: skip
    unit = layer.bands[0].unit
    unit = "" if layer.classes or unit in _UNITLESS else unit
    if panel.classes:
        legend_beside(ax, class_signs(panel.classes), unit)
    else:
        colour_bar(axes, panel, unit)
    return finish(sheet, axes, marks, view)


def draw_zones(
    zones: gpd.GeoDataFrame, levels: Sequence[HazardLevel], grid: Grid, ax: Axes | None = None
) -> Axes:
    """Draw zones over the relief of the terrain, the lowest level first, with a legend."""
    if ax is None:
        # Only where a notebook or a window shows it.
        import matplotlib.pyplot as plt

        _, ax = plt.subplots(layout="constrained")
    west, south, east, north = grid.bounds
    shade = relief.hillshade(grid)
    ax.imshow(shade, cmap="gray", extent=(west, east, south, north), alpha=0.5, vmin=0.0, vmax=1.0)
    signs = []
    for level in levels:
        # A hatched level is striped on white, as on maps.
        look: dict[str, Any] = {
            "facecolor": "white" if level.hatched else level.colour,
            "edgecolor": level.colour if level.hatched else "#4d4d4d",
            "hatch": "////" if level.hatched else None, "linewidth": 0.5, "alpha": 0.85,
        }  # fmt: skip
        own = zones[zones["hazard_level"] == level.code]
        if len(own):
            own.plot(ax=ax, label=level.code, **look)
            signs.append(Patch(label=translated(level.label), **look))
    ax.legend(handles=signs[::-1], title=translated("Hazard level"))
    ax.set(xlim=(west, east), ylim=(south, north), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    ax.ticklabel_format(useOffset=False, style="plain")
    return ax
