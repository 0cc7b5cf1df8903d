"""Relief shading, and the furniture of a map: scale bar, north arrow, coordinates."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import FuncFormatter, MultipleLocator
from numpy.typing import NDArray

from sassgis.model.grid import FloatArray, Grid
from sassgis.report.figures.style import GREY, INK, SMALL, round_step
from sassgis.report.number_text import thousands

Extent = tuple[float, float, float, float]

#: Longest side of a drawn raster in cells: more than the printed map has dots for.
MAX_CELLS = 900


@dataclass(frozen=True, slots=True)
class GridWindow:
    """A part of a grid by rows and columns: ``[row_0, row_1)``, ``[col_0, col_1)``."""

    row_0: int
    row_1: int
    col_0: int
    col_1: int

    def cut(self, values: FloatArray) -> FloatArray:
        """Cut the window out of an array of the grid's shape."""
        return values[self.row_0 : self.row_1, self.col_0 : self.col_1]

    def grid(self, grid: Grid) -> Grid:
        """Cut the window out of a grid."""
        return replace(
            grid,
            values=self.cut(grid.values),
            west=grid.west + self.col_0 * grid.cell_size,
            north=grid.north - self.row_0 * grid.cell_size,
        )


def window_of(grid: Grid, extent: Extent) -> GridWindow:
    """Smallest window of whole cells that covers (west, south, east, north), cut to the grid."""
    west, south, east, north = extent
    n_rows, n_cols = grid.shape
    col_0 = int(np.clip(np.floor((west - grid.west) / grid.cell_size), 0, n_cols - 1))
    col_1 = int(np.clip(np.ceil((east - grid.west) / grid.cell_size), col_0 + 1, n_cols))
    row_0 = int(np.clip(np.floor((grid.north - north) / grid.cell_size), 0, n_rows - 1))
    row_1 = int(np.clip(np.ceil((grid.north - south) / grid.cell_size), row_0 + 1, n_rows))
    return GridWindow(row_0, row_1, col_0, col_1)


def coarsen(values: FloatArray, factor: int, how: str) -> FloatArray:
    """Bring blocks of cells together.

    Parameters
    ----------
    values : shape (n_rows, n_cols)
    factor : int
        Side of a block in cells.
    how : {"mean", "max"}
        NaN cells are left out; a block without any value is NaN.

    Returns
    -------
    float64, shape (ceil(n_rows / factor), ceil(n_cols / factor))
    """
    values = np.asarray(values, float)
    if factor <= 1:
        return values
    rows = -(-values.shape[0] // factor)
    cols = -(-values.shape[1] // factor)
    padded = np.full((rows * factor, cols * factor), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(rows, factor, cols, factor).swapaxes(1, 2).reshape(rows, cols, -1)
    with warnings.catch_warnings():
        # A block without any value is what nodata is; numpy warns about it.
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmax(blocks, -1) if how == "max" else np.nanmean(blocks, -1))


def _slope(z: FloatArray, axis: int, cell_size: float) -> FloatArray:
    """Rise per metre along an axis: central, or one-sided where a neighbour is missing."""
    step = np.diff(z, axis=axis) / cell_size
    edge = np.full_like(np.take(z, [0], axis=axis), np.nan)
    before = np.concatenate([edge, step], axis=axis)
    after = np.concatenate([step, edge], axis=axis)
    number = np.isfinite(before).astype(float) + np.isfinite(after)
    total = np.nan_to_num(before) + np.nan_to_num(after)
    return np.asarray(np.where(number > 0, total / np.maximum(number, 1.0), 0.0))


def hillshade(grid: Grid, *, altitude_deg: float = 45.0) -> FloatArray:
    """Relief lit from four sides at once, so that no slope is lost in its own shadow.

    Each light counts more on ground that it strikes from the side (Mark, R. K., 1992,
    Multidirectional, oblique-weighted, shaded-relief image of the Island of Hawaii, USGS Open-File
    Report 92-422).

    Parameters
    ----------
    grid : Grid
    altitude_deg : float
        Height of the lights above the horizon.

    Returns
    -------
    float64, shape (n_rows, n_cols)
        0 (dark) to 1 (bright); NaN where the height is unknown.
    """
    z = np.asarray(grid.values, float)
    if min(z.shape) < 2:
        return np.where(np.isfinite(z), 0.7, np.nan)
    east = _slope(z, 1, grid.cell_size)
    north = -_slope(z, 0, grid.cell_size)
    steepness = np.arctan(np.hypot(east, north))
    aspect = np.arctan2(-east, -north)
    altitude = np.radians(altitude_deg)
    total = np.zeros_like(z)
    weights = np.zeros_like(z)
    for azimuth in np.radians([225.0, 270.0, 315.0, 360.0]):
        # The small constant keeps flat ground, which has no side, evenly lit.
        weight = np.sin(aspect - azimuth) ** 2 + 1e-3
        light = np.sin(altitude) * np.cos(steepness) + np.cos(altitude) * np.sin(
            steepness
        ) * np.cos(aspect - azimuth)
        total += weight * np.clip(light, 0.0, 1.0)
        weights += weight
    return np.where(np.isfinite(z), total / weights, np.nan)


def draw_relief(ax: Axes, grid: Grid) -> int:
    """Draw the hillshade of a grid; nodata stays white.

    Returns
    -------
    int
        Cells per drawn cell and side (1: every cell is drawn).
    """
    factor = -(-max(grid.shape) // MAX_CELLS)
    coarse = replace(
        grid, values=coarsen(grid.values, factor, "mean"), cell_size=grid.cell_size * factor
    )
    west, south, east, north = coarse.bounds
    ax.imshow(
        hillshade(coarse),
        # Never quite black: the layer and the labels above must stay readable.
        cmap="gray",
        vmin=-0.35,
        vmax=0.95,
        extent=(west, east, south, north),
        interpolation="nearest" if factor == 1 else "auto",
        zorder=0,
        gid="relief",
    )
    return factor


def map_axes(ax: Axes, extent: Extent, parts: int = 5) -> None:
    """Set limits, ticks and labels of a map; coordinates in m, in km where the map is large.

    ``parts`` is about the number of ticks along the longer side.
    """
    west, south, east, north = extent
    ax.set_xlim(west, east)
    ax.set_ylim(south, north)
    ax.set_aspect("equal")
    ax.grid(False)
    for side in ("top", "right"):
        ax.spines[side].set_visible(True)
    step = round_step(max(east - west, north - south), parts)
    in_km = step >= 1000.0
    scale, decimals = (1000.0, 0) if in_km else (1.0, max(0, int(-np.floor(np.log10(step)))))
    text = FuncFormatter(lambda value, _: thousands(value / scale, decimals))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MultipleLocator(step))
        axis.set_major_formatter(text)
    unit = "km" if in_km else "m"
    ax.set_xlabel(f"east ({unit})", size=SMALL)
    ax.set_ylabel(f"north ({unit})", size=SMALL)
    for label in ax.get_yticklabels():
        label.set_rotation(90)
        label.set_verticalalignment("center")


def emptiest_corner(occupied: NDArray[np.bool_], width: float, height: float) -> tuple[bool, bool]:
    """Find the corner of a raster that hides least.

    Parameters
    ----------
    occupied : shape (n_rows, n_cols)
        True where something is drawn; row 0 in the north.
    width, height : float
        Size of the box to place, as a share of the raster.

    Returns
    -------
    (right, top) : bool
    """
    rows = max(1, int(np.ceil(occupied.shape[0] * height)))
    cols = max(1, int(np.ceil(occupied.shape[1] * width)))
    # Lower left first: where all corners are alike, that is where a reader looks for it.
    corners = ((False, False), (True, False), (False, True), (True, True))
    hidden = [
        np.count_nonzero(
            occupied[
                slice(0, rows) if top else slice(-rows, None),
                slice(-cols, None) if right else slice(0, cols),
            ]
        )
        for right, top in corners
    ]
    return corners[int(np.argmin(hidden))]


#: Size of the box with scale bar and north arrow (in).
FURNITURE_IN = (1.55, 0.42)


def draw_furniture(ax: Axes, extent: Extent, width_in: float, *, right: bool, top: bool) -> None:
    """Draw a scale bar and a north arrow in a corner.

    Parameters
    ----------
    extent : (west, south, east, north)
    width_in : float
        Drawn width of the map (in).
    right, top : bool
        Which corner.
    """
    west, south, east, north = extent
    inch = (east - west) / width_in
    box_w, box_h = (side * inch for side in FURNITURE_IN)
    pad = 0.07 * inch
    x0 = east - pad - box_w if right else west + pad
    y0 = north - pad - box_h if top else south + pad
    ax.add_patch(Rectangle((x0, y0), box_w, box_h, fc="white", ec="none", alpha=0.85, zorder=20))
    longest = 1.05 * inch
    power = 10.0 ** np.floor(np.log10(longest))
    bar = max(m * power for m in (1.0, 2.0, 5.0) if m * power <= longest)
    bx, by = x0 + 0.1 * inch, y0 + 0.1 * inch
    for half, colour in ((0, INK), (1, "white")):
        ax.add_patch(
            Rectangle(
                (bx + half * bar / 2.0, by),
                bar / 2.0,
                0.055 * inch,
                fc=colour,
                ec=INK,
                lw=0.6,
                zorder=21,
            )
        )
    label = f"{thousands(bar / 1000.0)} km" if bar >= 1000.0 else f"{bar:g} m"
    ax.text(
        bx + bar / 2.0,
        by + 0.08 * inch,
        label,
        size=SMALL,
        ha="center",
        va="bottom",
        zorder=21,
        gid="scale-bar",
    )
    nx, ny = x0 + box_w - 0.17 * inch, y0 + 0.06 * inch
    ax.add_patch(
        Polygon(
            [
                (nx, ny + 0.2 * inch),
                (nx - 0.065 * inch, ny),
                (nx, ny + 0.045 * inch),
                (nx + 0.065 * inch, ny),
            ],
            closed=True,
            fc=INK,
            ec=INK,
            lw=0.5,
            zorder=21,
        )
    )
    ax.text(
        nx,
        ny + 0.2 * inch,
        "N",
        size=SMALL,
        ha="center",
        va="bottom",
        color=GREY,
        zorder=21,
        gid="north",
    )
