"""The one map figure: layers over the relief in panels of one extent, with marks and a legend.

A map is described by its panels (values with their colours), its marks, and the room around it;
:func:`draw_maps` draws all of them. What differs between maps is where their legend stands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedFormatter, FuncFormatter, NullLocator
from numpy.typing import NDArray

from sassgis.model.grid import FloatArray, Grid
from sassgis.model.labels import thousands
from sassgis.model.languages import joined, phrase, translated
from sassgis.model.results import Band, RasterClass, RasterLayer
from sassgis.model.styles import class_colours, class_labels, class_limits, zero_is_nothing
from sassgis.report.figures.map_marks import LAYER_ALPHA, MapMarks, all_points
from sassgis.report.figures.relief import (
    FURNITURE_IN,
    Extent,
    MapView,
    draw_furniture,
    draw_relief,
    emptiest_corner,
    footprint,
    map_axes,
    view_of,
)
from sassgis.report.figures.style import (
    DPI,
    GREY,
    INK,
    SMALL,
    TEXT,
    TITLE,
    WIDTH_IN,
    Page,
    halo,
    house_style,
    lines_in,
    text_width_pt,
    wrap,
)

#: From one stripe to the next, and the part of it that is coloured; of fine lines over other
#: colours, which fall to the right.
_STRIPE_IN, _STRIPE_SHARE, _OVER_SHARE = 0.052, 0.5, 0.2
#: A sign of a legend (in), and the room from one line of text to the next.
SIGN_IN = (0.26, 0.15)
_LINE_IN = 0.135
_LEGEND_GAP_IN, _BAR_IN = 0.14, 0.14
#: Units that mean that a number has no unit.
_UNITLESS = ("", "1", "-", "–", "class")


# --- values and colours ----------------------------------------------------------------------


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


def class_positions(values: NDArray[Any], classes: Sequence[RasterClass]) -> FloatArray:
    """Position of each value among the classes, in ascending order; NaN where it is none."""
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
    stripes: Sequence[tuple[int, str]] = ()  # position and colour of classes striped on white
    over: NDArray[np.bool_] | None = None  # cells with fine black lines over them
    alpha: float = LAYER_ALPHA
    together: str = "max"  # what a dot for several cells shows: "max" or "mean"


def coloured_classes(colours: Sequence[str]) -> tuple[Colormap, Normalize]:
    """Colours of the positions among classes."""
    return ListedColormap(colours), BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours))


def class_panel(
    values: NDArray[Any],
    classes: Sequence[RasterClass],
    title: str = "",
    over: NDArray[np.bool_] | None = None,
    alpha: float = LAYER_ALPHA,
) -> MapPanel:
    """A map of classes; values that are none stay clear."""
    ordered = sorted(classes, key=lambda entry: entry.value)
    colours = coloured_classes(["#ffffff" if c.hatched else c.colour for c in ordered])
    stripes = [(k, c.colour) for k, c in enumerate(ordered) if c.hatched]
    return MapPanel(class_positions(values, classes), *colours, title, stripes, over, alpha)


# --- drawing ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class MapFrame:
    """Where the maps of a figure stand: left edge, size of each and room around all (in)."""

    left: float
    width: float
    height: float
    top: float
    bottom: float
    columns: int = 1
    gap: float = 0.0  # between two columns
    head: float = 0.0  # over each map
    ticks: int = 5  # about how many along the longer side of a map


def one_map(aspect: float, right: float, most: float) -> tuple[float, float, float]:
    """Left edge, width and height of a map by itself with so much room at its right (in)."""
    left = 0.62
    width = WIDTH_IN - left - right
    if width * aspect <= most:
        return left, width, width * aspect
    width = most / aspect
    return max(left, (WIDTH_IN - width - right + left) / 2.0), width, most


@dataclass(frozen=True, slots=True)
class DrawnMaps:
    """Maps on their page."""

    page: Page
    axes: Sequence[Axes]
    metres_per_inch: float


def draw_maps(
    view: MapView,
    panels: Sequence[MapPanel],
    marks: MapMarks,
    frame: MapFrame,
    more: Callable[[Axes], None] | None = None,
) -> DrawnMaps:
    """Draw maps of one extent side by side; ``more`` draws what is neither value nor mark."""
    columns, tall = frame.columns, frame.height + frame.head
    rows = -(-len(panels) // columns)
    page = Page(frame.top + rows * tall + frame.bottom)
    metres_per_inch = view.width_m / frame.width
    axes = []
    for number, panel in enumerate(panels):
        row, column = divmod(number, columns)
        x = frame.left + column * (frame.width + frame.gap)
        y = page.height - frame.top - (row + 1) * tall if frame.head else frame.bottom
        ax = page.axes(x, y, frame.width, frame.height, "map")
        draw_relief(ax, view)
        _draw_values(ax, panel, view, metres_per_inch)
        if more is not None:
            more(ax)
        marks.draw(ax, view.box, 72.0 / metres_per_inch)
        map_axes(ax, view.box, frame.ticks)
        # Coordinates only left of the first column and below the last map of each.
        if column:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)
        if number + columns < len(panels):
            ax.set_xlabel("")
            ax.tick_params(labelbottom=False)
        ax.set_title(panel.title, size=TEXT, pad=3.0)
        axes.append(ax)
    return DrawnMaps(page, axes, metres_per_inch)


def _draw_values(ax: Axes, panel: MapPanel, view: MapView, metres_per_inch: float) -> None:
    if panel.values is None:
        return
    values, extent = view.coarse(view.cut(panel.values), panel.together)
    west, south, east, north = extent
    ax.imshow(
        np.ma.masked_invalid(values),
        cmap=panel.colours,
        norm=panel.norm,
        extent=(west, east, south, north),
        interpolation="nearest",
        alpha=panel.alpha,
        zorder=2,
        gid="layer",
    )
    for place, colour in panel.stripes:
        draw_stripes(ax, values == place, colour, extent, metres_per_inch, panel.alpha)
    if panel.over is not None:
        over, _ = view.coarse(view.cut(panel.over.astype(float)), "max")
        draw_stripes(ax, over > 0.0, INK, extent, metres_per_inch, 0.9, fine=True)


def draw_stripes(
    ax: Axes,
    cells: NDArray[np.bool_],
    colour: str,
    extent: Extent,
    metres_per_inch: float,
    alpha: float = LAYER_ALPHA,
    *,
    fine: bool = False,
) -> None:
    """Draw stripes over the cells that are true; matplotlib can hatch polygons alone.

    They rise to the right; fine ones fall.
    """
    rows, cols = np.nonzero(cells)
    if not rows.size:
        return
    west, _, east, north = extent
    cell = (east - west) / cells.shape[1]
    top, left = int(rows.min()), int(cols.min())
    part = cells[top : rows.max() + 1, left : cols.max() + 1]
    # Two dots for each of the printed figure.
    dot = metres_per_inch / (2.0 * DPI)
    row = (np.arange(max(1, round(part.shape[0] * cell / dot))) * dot / cell).astype(int)
    col = (np.arange(max(1, round(part.shape[1] * cell / dot))) * dot / cell).astype(int)
    inside = part[np.minimum(row, part.shape[0] - 1)][:, np.minimum(col, part.shape[1] - 1)]
    step = max(2, round(_STRIPE_IN * 2.0 * DPI))
    down = np.arange(row.size)[:, None]
    along = np.arange(col.size)[None, :] + (-down if fine else down)
    share = _OVER_SHARE if fine else _STRIPE_SHARE
    image = np.zeros((row.size, col.size, 4), np.float32)
    image[..., :3] = to_rgb(colour)
    image[..., 3] = alpha * (inside & (along % step < share * step))
    ax.imshow(
        image,
        extent=(
            west + left * cell,
            west + (left + part.shape[1]) * cell,
            north - (top + part.shape[0]) * cell,
            north - top * cell,
        ),
        zorder=2.5,
        gid="stripes",
    )


def furniture_within(
    maps: DrawnMaps, frame: MapFrame, box: Extent, taken: NDArray[np.bool_]
) -> None:
    """Draw scale bar and north arrow in the corner of the first map that hides least."""
    corner = emptiest_corner(taken, FURNITURE_IN[0] / frame.width, FURNITURE_IN[1] / frame.height)
    draw_furniture(maps.axes[0], box, frame.width, corner)


# --- legends ---------------------------------------------------------------------------------


def _sign(page: Page, x: float, y: float, entry: RasterClass, *, over: bool = False) -> None:
    """Draw the sign of a class, its lower left corner at x, y."""
    ax = page.axes(x, y, *SIGN_IN, "sign")
    ax.set_axis_off()
    if entry.hatched or over:
        cells = np.ones((round(100.0 * SIGN_IN[1]), round(100.0 * SIGN_IN[0])), bool)
        draw_stripes(ax, cells, entry.colour, (0.0, 0.0, *SIGN_IN), 1.0, fine=over)
        ax.set_aspect("auto")
    else:
        ax.add_patch(Rectangle((0.0, 0.0), *SIGN_IN, fc=entry.colour, ec="none", alpha=LAYER_ALPHA))
    ax.set(xlim=(0.0, SIGN_IN[0]), ylim=(0.0, SIGN_IN[1]))
    ax.add_patch(Rectangle((0.0, 0.0), *SIGN_IN, fc="none", ec=GREY, lw=0.8, zorder=5))


def class_list(
    page: Page, classes: Sequence[RasterClass], x: float, top: float, width: float
) -> None:
    """Draw the signs and names of classes one below the other, the highest value first."""
    for entry in sorted(classes, key=lambda entry: -entry.value):
        _sign(page, x, top - SIGN_IN[1], entry)
        text = wrap(entry.label, width - SIGN_IN[0] - 0.1)
        lines = lines_in(text)
        page.text(
            x + SIGN_IN[0] + 0.08, top - SIGN_IN[1] / 2.0 + (lines > 1) * _LINE_IN / 2.0, text,
            size=SMALL, va="center" if lines == 1 else "top", gid="class",
        )  # fmt: skip
        top -= max(SIGN_IN[1], _LINE_IN * lines) + 0.07


@dataclass(frozen=True, slots=True)
class ClassRow:
    """The signs and names of classes side by side, the highest value first.

    A heading stands before the first; ``over`` is a last sign of fine lines that fall to the right.
    """

    heading: str
    classes: Sequence[RasterClass]
    over: RasterClass | None = None

    def placed(
        self, x: float, top: float, width: float
    ) -> tuple[list[tuple[float, float, RasterClass]], float]:
        """Where the upper left corners of the signs stand, and where the row ends (in)."""
        start = x + text_width_pt(self.heading) * 1.1 / 72.0 + 0.1 if self.heading else x
        at, out = start, []
        entries = sorted(self.classes, key=lambda entry: -entry.value)
        for entry in [*entries, *([self.over] if self.over else [])]:
            room = SIGN_IN[0] + 0.08 + text_width_pt(entry.label) / 72.0 + 0.12
            if at + room > x + width and at > start:
                at, top = start, top - SIGN_IN[1] - 0.08
            out.append((at, top, entry))
            at += room
        return out, top - SIGN_IN[1] - 0.1

    def draw(self, page: Page, x: float, top: float, width: float) -> float:
        """Draw the row from its upper left corner, and give where it ends (in)."""
        half = SIGN_IN[1] / 2.0
        if self.heading:
            page.text(
                x, top - half, self.heading, size=SMALL, weight="bold", va="center",
                gid="legend-heading",
            )  # fmt: skip
        placed, end = self.placed(x, top, width)
        for at, y, entry in placed:
            _sign(page, at, y - SIGN_IN[1], entry, over=entry is self.over)
            page.text(
                at + SIGN_IN[0] + 0.08, y - half, entry.label, size=SMALL, va="center", gid="class"
            )
        return end


def colour_bar(ax: Axes, panel: MapPanel, **how: Any) -> None:
    """Draw the bar of the colours of a map."""
    figure = ax.get_figure()
    assert isinstance(figure, Figure)
    bar = figure.colorbar(
        ScalarMappable(panel.norm, panel.colours), cax=ax, alpha=panel.alpha, **how
    )
    bar.outline.set_linewidth(0.5)
    ax.tick_params(labelsize=SMALL)
    ax.grid(False)


# --- a layer ---------------------------------------------------------------------------------


def _value_label(value: float, _: object = None) -> str:
    """Write a value of the ramp with as few digits as it needs."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.4g}".replace("-", "\u2212")
    return thousands(value) if abs(value) >= 1e4 else f"{value:.0e}".replace("-", "\u2212")


def _layer_panel(layer: RasterLayer) -> tuple[MapPanel, FloatArray]:
    """A layer in its classes, those of its breaks, or as a ramp; and the values that it shows."""
    if layer.classes:
        panel = class_panel(layer.bands[0].values, layer.classes)
        assert panel.values is not None
        return panel, panel.values
    values = shown_values(layer.bands[0])
    # Classes and colours are those of the map in QGIS, and do not depend on the data: maps with
    # the same limits can be laid side by side.
    if layer.breaks:
        colours = coloured_classes(class_colours(layer.breaks, layer.ramp))
        return MapPanel(class_numbers(values, layer.breaks), *colours), values
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    norm = Normalize(low, high if high > low else low + max(1.0, abs(low)))
    return MapPanel(values, mpl.colormaps[layer.ramp or "viridis"], norm), values


def coarse_note(view: MapView, what: str) -> str:
    """Say what a dot of a large map shows; nothing where each cell has its own."""
    if view.factor == 1:
        return ""
    n = view.factor
    return phrase(
        "Drawn with one dot for {} × {} cells; each shows the {} in it.", n, n, phrase(what)
    )


@house_style()
def map_figure(
    grid: Grid, layer: RasterLayer, marks: MapMarks | None = None, *, note: str | None = None
) -> Figure:
    """Draw the first band of a layer: in its classes, those of its breaks, or as a ramp.

    The layer lies on the cells of the terrain; below the map stands its note or another.
    """
    marks = marks or MapMarks()
    panel, values = _layer_panel(layer)
    if marks.zones:
        panel = replace(panel, values=None)
    corners = [shapely.get_coordinates(shapely.box(*p.bounds)) for p, _ in marks.zones]
    view = view_of(grid, footprint(grid, values, all_points([*marks.release, *corners])))
    notes = [
        layer.note if note is None else note,
        marks.left_out(),
        ""
        if marks.zones
        else coarse_note(view, "highest class" if layer.classes else "largest value"),
        marks.key(),
    ]
    labels = class_labels(layer.breaks, "") if layer.breaks and not layer.classes else []
    heading = wrap(layer.title, WIDTH_IN - 0.4, TITLE)
    below = wrap(joined("\n", filter(None, notes)), WIDTH_IN - 0.8)
    names = [translated(entry.label) for entry in layer.classes]
    longest = max((text_width_pt(label) for label in names or labels), default=0.0) / 72.0
    legend_w = min(SIGN_IN[0] + 0.1 + longest, 1.7) if names else _BAR_IN + 0.12 + longest
    right = max(0.85, _LEGEND_GAP_IN + legend_w)
    frame = MapFrame(
        *one_map(view.aspect, right, 7.2),
        top=0.12 + 0.18 * lines_in(heading) + 0.08,
        bottom=0.48 + _LINE_IN * lines_in(below) + 0.08,
    )
    maps = draw_maps(view, [panel], marks, frame)
    known = np.isfinite(view.cut(values))
    furniture_within(maps, frame, view.box, known)
    if not known.any():
        maps.axes[0].text(
            0.5, 0.5, "no values here", transform=maps.axes[0].transAxes, ha="center", va="center",
            size=TEXT, path_effects=halo(), zorder=23,
        )  # fmt: skip
    x, top = frame.left + frame.width + _LEGEND_GAP_IN, frame.bottom + frame.height
    if layer.classes:
        class_list(maps.page, layer.classes, x, top, legend_w)
    else:
        unit = "" if layer.bands[0].unit in _UNITLESS else layer.bands[0].unit
        unit = wrap(unit, right + 0.1)
        top -= 0.15 * lines_in(unit)
        tall = min(top - frame.bottom, 0.42 * len(labels) if labels else 3.0)
        bar = maps.page.axes(x, top - tall, _BAR_IN, tall, "legend")
        if labels:
            colour_bar(bar, panel, ticks=list(range(len(labels))), format=FixedFormatter(labels))
            bar.tick_params(length=0)
        else:
            colour_bar(bar, panel, format=FuncFormatter(_value_label))
        bar.yaxis.set_minor_locator(NullLocator())
        maps.page.text(x, top + 0.15 * lines_in(unit), unit, size=SMALL, va="top", gid="unit")
    maps.page.title(frame.left, heading)
    maps.page.note(frame.left, frame.bottom - 0.46, below)
    return maps.page.figure
