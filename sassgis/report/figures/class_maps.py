"""Maps of classes: cells in the colours of their class, or striped, and the legend of both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from sassgis.model.grid import FloatArray
from sassgis.model.results import RasterClass
from sassgis.report.figures.relief import Extent
from sassgis.report.figures.style import DPI, GREY, SMALL, lines_in, text_width_pt, wrap

#: Maps let a little of the relief through.
LAYER_ALPHA = 0.8
#: From one stripe to the next, and the part of it that is coloured.
_STRIPE_IN, _STRIPE_SHARE = 0.052, 0.5
#: A sign of a legend (in), and the room from one line of text to the next.
SIGN_IN = (0.26, 0.15)
#: As the stripes' share, of fine lines that fall to the right, over other colours.
OVER_SHARE = 0.2
LINE_IN = 0.135


def class_positions(values: FloatArray, classes: Sequence[RasterClass]) -> FloatArray:
    """Position of each value among the classes, in ascending order; NaN where it is none."""
    ordered = np.array(sorted(entry.value for entry in classes), float)
    known = np.nan_to_num(values, nan=-np.inf)
    place = np.clip(np.searchsorted(ordered, known), 0, ordered.size - 1)
    return np.where(ordered[place] == known, place.astype(float), np.nan)


def draw_classes(
    ax: Axes,
    positions: FloatArray,
    classes: Sequence[RasterClass],
    *,
    extent: Extent,
    metres_per_inch: float,
    alpha: float = LAYER_ALPHA,
) -> None:
    """Draw cells by class; hatched classes as stripes on white.

    Parameters
    ----------
    ax : Axes
    positions : shape (n_rows, n_cols)
        From :func:`class_positions`.
    classes : sequence of RasterClass
    extent : (west, south, east, north)
        Of the cells (m).
    metres_per_inch : float
        Of the drawn map.
    alpha : float
    """
    ordered = sorted(classes, key=lambda entry: entry.value)
    west, south, east, north = extent
    ax.imshow(
        np.ma.masked_invalid(positions),
        cmap=ListedColormap(["#ffffff" if c.hatched else c.colour for c in ordered]),
        norm=BoundaryNorm(np.arange(len(ordered) + 1) - 0.5, len(ordered)),
        extent=(west, east, south, north),
        interpolation="nearest",
        alpha=alpha,
        zorder=2,
        gid="layer",
    )
    for place, entry in enumerate(ordered):
        if entry.hatched:
            draw_stripes(
                ax,
                positions == place,
                entry.colour,
                extent=extent,
                metres_per_inch=metres_per_inch,
                alpha=alpha,
            )


def draw_stripes(
    ax: Axes,
    cells: NDArray[np.bool_],
    colour: str,
    *,
    extent: Extent,
    metres_per_inch: float,
    alpha: float = LAYER_ALPHA,
    falling: bool = False,
    share: float = _STRIPE_SHARE,
) -> None:
    """Draw stripes over the cells that are true; matplotlib can hatch polygons alone."""
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
    along = np.arange(col.size)[None, :] + (-down if falling else down)
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


def _sign(
    figure: Figure,
    x: float,
    y: float,
    entry: RasterClass,
    size: tuple[float, float] = SIGN_IN,
    *,
    over: bool = False,
) -> None:
    """Draw the sign of a class, its lower left corner at x, y (in)."""
    width, height = figure.get_size_inches()
    box = (x / width, y / height, size[0] / width, size[1] / height)
    ax = figure.add_axes(box, label="sign")
    ax.set_axis_off()
    ax.set_xlim(0.0, size[0])
    ax.set_ylim(0.0, size[1])
    if entry.hatched or over:
        cells = np.ones((round(100.0 * size[1]), round(100.0 * size[0])), bool)
        draw_stripes(
            ax, cells, entry.colour, extent=(0.0, 0.0, *size), metres_per_inch=1.0,
            falling=over, share=OVER_SHARE if over else _STRIPE_SHARE,
        )  # fmt: skip
        ax.set_aspect("auto")
        ax.set_xlim(0.0, size[0])
        ax.set_ylim(0.0, size[1])
    else:
        ax.add_patch(
            Rectangle((0.0, 0.0), *size, fc=entry.colour, ec="none", alpha=LAYER_ALPHA, lw=0.0)
        )
    ax.add_patch(Rectangle((0.0, 0.0), *size, fc="none", ec=GREY, lw=0.8, zorder=5))


def _label(entry: RasterClass, width_in: float) -> str:
    return wrap(entry.label, width_in - SIGN_IN[0] - 0.1)


def _row_height(entry: RasterClass, width_in: float) -> float:
    return max(SIGN_IN[1], LINE_IN * lines_in(_label(entry, width_in))) + 0.07


def draw_class_legend(
    figure: Figure, classes: Sequence[RasterClass], x: float, top: float, width_in: float
) -> float:
    """Draw the signs and names of classes one below the other, the highest value first.

    Parameters
    ----------
    figure : Figure
    classes : sequence of RasterClass
    x, top : float
        Upper left corner (in, from the lower left corner of the figure).
    width_in : float

    Returns
    -------
    float
        Where the legend ends (in).
    """
    width, height = figure.get_size_inches()
    for entry in sorted(classes, key=lambda entry: -entry.value):
        tall = _row_height(entry, width_in)
        _sign(figure, x, top - SIGN_IN[1], entry)
        text = _label(entry, width_in)
        lines = lines_in(text)
        figure.text(
            (x + SIGN_IN[0] + 0.08) / width,
            (top - SIGN_IN[1] / 2.0 + (lines > 1) * LINE_IN / 2.0) / height,
            text,
            size=SMALL,
            va="center" if lines == 1 else "top",
            gid="class",
        )
        top -= tall
    return top


def draw_class_row(
    figure: Figure,
    heading: str,
    classes: Sequence[RasterClass],
    x: float,
    top: float,
    width_in: float,
    *,
    over: RasterClass | None = None,
    measure: bool = False,
) -> float:
    """Draw the signs and names of classes side by side, the highest value first.

    Parameters
    ----------
    figure : Figure
    heading : str
        Stands before the first; empty for none.
    classes : sequence of RasterClass
    x, top : float
        Upper left corner (in, from the lower left corner of the figure).
    width_in : float
        Beyond it a new line begins.
    over : RasterClass, optional
        A last sign: fine lines that fall to the right.
    measure : bool
        Draw nothing.

    Returns
    -------
    float
        Where the legend ends (in).
    """
    width, height = figure.get_size_inches()
    start = x
    if heading:
        if not measure:
            figure.text(
                x / width, (top - SIGN_IN[1] / 2.0) / height, heading, size=SMALL, weight="bold",
                va="center", gid="legend-heading",
            )  # fmt: skip
        start = x + text_width_pt(heading) * 1.1 / 72.0 + 0.1
    at = start
    for entry in [*sorted(classes, key=lambda entry: -entry.value), *([over] if over else [])]:
        room = SIGN_IN[0] + 0.08 + text_width_pt(entry.label) / 72.0 + 0.12
        if at + room > x + width_in and at > start:
            at, top = start, top - SIGN_IN[1] - 0.08
        if not measure:
            _sign(figure, at, top - SIGN_IN[1], entry, over=entry is over)
            figure.text(
                (at + SIGN_IN[0] + 0.08) / width, (top - SIGN_IN[1] / 2.0) / height, entry.label,
                size=SMALL, va="center", gid="class",
            )  # fmt: skip
        at += room
    return top - SIGN_IN[1] - 0.1
