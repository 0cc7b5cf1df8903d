"""The ground of a map: the part of the terrain that it shows, its relief, scale and coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.offsetbox import AnchoredOffsetbox, AuxTransformBox, HPacker, TextArea, VPacker
from matplotlib.patches import Rectangle
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import offset_copy
from numpy.typing import NDArray

from sassgis.grid import Bounds, FloatArray, Grid
from sassgis.report.figures.style import INK, SMALL, round_step, thousands_formatter
from sassgis.settings.languages import phrase
from sassgis.settings.results import thousands

T = TypeVar("T", bound=np.generic)

#: Room of the coordinates below a map (points).
_BELOW_PT = 19.0
#: Longest side of a drawn raster in cells: more than the printed map has dots for.
MAX_CELLS = 900


def footprint(grid: Grid, values: FloatArray | None, others: FloatArray) -> Bounds:
    """Return the extent of what is shown, with a margin, cut to the grid; all of it without any.

    Shown are cells of ``values`` that are not NaN, and the ``others`` (n, 2) that lie within the
    grid.
    """
    west, south, east, north = grid.bounds
    x, y = others[:, 0], others[:, 1]
    inside = (x >= west) & (x <= east) & (y >= south) & (y <= north)
    x, y = x[inside], y[inside]
    rows, cols = np.nonzero(np.isfinite(np.empty((0, 0)) if values is None else values))
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
    x0, y0 = np.maximum(box[:2], (west, south)).tolist()
    x1, y1 = np.minimum(box[2:], (east, north)).tolist()
    return x0, y0, x1, y1


@dataclass(frozen=True, slots=True)
class MapView:
    """The part of a grid that a map shows: its limits, and the whole cells that cover them."""

    box: Bounds
    rows: slice
    cols: slice
    grid: Grid

    @property
    def factor(self) -> int:
        """Cells per drawn cell and side (1: every cell is drawn)."""
        return -(-max(self.grid.shape) // MAX_CELLS)

    @property
    def width_m(self) -> float:
        """Width of the map."""
        return self.box[2] - self.box[0]

    @property
    def aspect(self) -> float:
        """Height by width of the map."""
        return (self.box[3] - self.box[1]) / self.width_m

    def cut(self, values: NDArray[T]) -> NDArray[T]:
        """Cut the part out of an array of the grid's shape."""
        return values[self.rows, self.cols]

    def coarse(self, values: FloatArray, how: str) -> tuple[FloatArray, Bounds]:
        """Return values of the part as drawn, and their extent, which may reach beyond it."""
        drawn = coarsen(values, self.factor, how)
        step = self.grid.cell_size * self.factor
        west, north = self.grid.west, self.grid.north
        return drawn, (west, north - len(drawn) * step, west + drawn.shape[1] * step, north)


def view_of(grid: Grid, box: Bounds) -> MapView:
    """Return the smallest part of a grid, in whole cells, that covers a box."""
    west, south, east, north = box
    n_rows, n_cols = grid.shape
    col_0 = int(np.clip(np.floor((west - grid.west) / grid.cell_size), 0, n_cols - 1))
    col_1 = int(np.clip(np.ceil((east - grid.west) / grid.cell_size), col_0 + 1, n_cols))
    row_0 = int(np.clip(np.floor((grid.north - north) / grid.cell_size), 0, n_rows - 1))
    row_1 = int(np.clip(np.ceil((grid.north - south) / grid.cell_size), row_0 + 1, n_rows))
    rows, cols = slice(row_0, row_1), slice(col_0, col_1)
    return MapView(box, rows, cols, grid.part(rows, cols))


def coarsen(values: FloatArray, factor: int, how: str) -> FloatArray:
    """Bring blocks of cells together by their "mean" or "max"; NaN only where all cells are."""
    if factor <= 1:
        return np.asarray(values, float)
    # Takes its time, and most maps have all of their cells.
    import xarray as xr

    blocks = xr.DataArray(np.asarray(values, float), dims=("y", "x"))
    coarser = blocks.coarsen(y=factor, x=factor, boundary="pad")
    return np.asarray(coarser.max() if how == "max" else coarser.mean())


def _slope(z: FloatArray, axis: int, cell_size: float) -> FloatArray:
    """Return rise per metre along an axis: central, or one-sided where a neighbour is missing."""
    step = np.diff(z, axis=axis) / cell_size
    edge = np.full_like(np.take(z, [0], axis=axis), np.nan)
    before = np.concatenate([edge, step], axis=axis)
    after = np.concatenate([step, edge], axis=axis)
    number = np.isfinite(before).astype(float) + np.isfinite(after)
    total = np.nan_to_num(before) + np.nan_to_num(after)
    return np.asarray(np.where(number > 0, total / np.maximum(number, 1.0), 0.0))


def hillshade(grid: Grid) -> FloatArray:
    """Return relief lit from four sides at once, so that no slope is lost in its shadow.

    Each light counts more on ground that it strikes from the side (Mark, R. K., 1992,
    Multidirectional, oblique-weighted, shaded-relief image of the Island of Hawaii, USGS Open-File
    Report 92-422). From 0 (dark) to 1 (bright); NaN where the height is unknown.
    """
    z = np.asarray(grid.values, float)
    if min(z.shape) < 2:
        return np.where(np.isfinite(z), 0.7, np.nan)
    east, north = _slope(z, 1, grid.cell_size), -_slope(z, 0, grid.cell_size)
    gradient = np.hypot(east, north)
    upwards = 1.0 / np.hypot(gradient, 1.0)  # component of the unit normal
    level = np.maximum(gradient, 1e-300)
    altitude = np.radians(45.0)
    total, weights = np.zeros_like(z), np.zeros_like(z)
    for azimuth in np.radians([225.0, 270.0, 315.0, 360.0]):
        towards = -(np.sin(azimuth) * east + np.cos(azimuth) * north)
        # The small constant keeps weights above 0 where rounding exceeds 1.
        weight = 1.0 - (towards / level) ** 2 + 1e-3
        light = (np.sin(altitude) + np.cos(altitude) * towards) * upwards
        total += weight * np.clip(light, 0.0, 1.0)
        weights += weight
    return np.where(np.isfinite(z), total / weights, np.nan)


def draw_relief(view: MapView, *axes: Axes) -> None:
    """Draw the hillshade of what maps of the same part show; nodata stays white."""
    heights, (west, south, east, north) = view.coarse(view.grid.values, "mean")
    shade = hillshade(
        replace(view.grid, values=heights, cell_size=view.grid.cell_size * view.factor)
    )
    for ax in axes:
        ax.imshow(
            shade,
            # Never quite black: the layer and the labels above must stay readable.
            cmap="gray",
            vmin=-0.35,
            vmax=0.95,
            extent=(west, east, south, north),
            interpolation="nearest" if view.factor == 1 else "auto",
            zorder=0,
            gid="relief",
        )


def map_axes(ax: Axes, extent: Bounds, parts: int = 5) -> None:
    """Set limits, about ``parts`` ticks on the longer side, and labels of a map in m or km."""
    west, south, east, north = extent
    ax.set(xlim=(west, east), ylim=(south, north), aspect="equal")
    ax.grid(False)
    ax.spines[["top", "right"]].set_visible(True)
    step = round_step(max(east - west, north - south), parts)
    in_km = step >= 1000.0
    scale, decimals = (1000.0, 0) if in_km else (1.0, max(0, int(-np.floor(np.log10(step)))))
    # Labels that would reach beyond the map meet those of the next one.
    for axis, begin, end in ((ax.xaxis, west, east), (ax.yaxis, south, north)):
        edge = 0.05 * (end - begin)
        axis.set_major_locator(MultipleLocator(step))
        axis.set_major_formatter(thousands_formatter(decimals, scale, (begin + edge, end - edge)))
    unit = "km" if in_km else "m"
    ax.set_xlabel(phrase("{} ({})", phrase("east"), unit), size=SMALL)
    ax.set_ylabel(phrase("{} ({})", phrase("north"), unit), size=SMALL)
    for label in ax.get_yticklabels():
        label.set_rotation(90)
        label.set_verticalalignment("center")


def scale_bar(ax: Axes, box: Bounds) -> None:
    """Draw scale bar and north arrow below a map on the left, where they hide nothing of it.

    There they are also in sight where a narrow screen shows only a part of the map.
    """
    width = box[2] - box[0]
    power = 10.0 ** np.floor(np.log10(0.25 * width))
    metres = max(m * power for m in (1.0, 2.0, 5.0) if m * power <= 0.25 * width)
    bar = AuxTransformBox(ax.transData)
    for k, colour in enumerate((INK, "white")):
        half: dict[str, Any] = {"fc": colour, "ec": INK, "lw": 0.6, "gid": "scale-bar"}
        bar.add_artist(Rectangle((k * metres / 2.0, 0.0), metres / 2.0, 0.012 * width, **half))
    label = f"{thousands(metres / 1000.0)} km" if metres >= 1000.0 else f"{metres:g} m"
    words = TextArea(label, textprops={"size": SMALL, "gid": "scale"})
    north = TextArea("N\n▲", textprops={"size": SMALL, "ha": "center", "linespacing": 0.9})
    parts = VPacker(children=[words, bar], align="center", pad=0.0, sep=2.0)
    sign = AnchoredOffsetbox(
        "upper left", child=HPacker(children=[parts, north], align="center", pad=0.0, sep=8.0),
        bbox_to_anchor=(0.0, 0.0), bbox_transform=offset_copy(
            ax.transAxes, ax.get_figure(root=True), x=0.0, y=-_BELOW_PT, units="points"
        ),
        borderpad=0.0, pad=0.0, frameon=False, prop=FontProperties(size=SMALL),
    )  # fmt: skip
    sign.set_clip_on(False)
    ax.add_artist(sign)
