"""Observed against predicted run-out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sassgis.grid import FloatArray, Grid
from sassgis.report.figures import relief
from sassgis.report.figures.map_marks import all_points, draw_points, draw_release, even_choice
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    SMALL,
    TEXT,
    Sheet,
    house_style,
    nothing_to_show,
    percent_formatter,
    thousands_formatter,
)
from sassgis.settings.results import thousands

#: Shares of the rocks listed beside the curves.
SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)

_MAX_POINTS = 4000


def _number(value: float, decimals: int, signed: bool = False) -> str:
    """Write metres; a dash where there is no number."""
    if not np.isfinite(value):
        return "–"
    text = thousands(value, decimals)
    return f"+{text}" if signed and value > 0.0 else text


def quantile_rows(observed: FloatArray, predicted: FloatArray) -> list[tuple[str, str, str, str]]:
    """Rows of the table: share, observed, predicted, predicted less observed (m)."""
    rows = []
    longest = max((float(np.abs(v).max()) for v in (observed, predicted) if v.size), default=0.0)
    decimals = 1 if longest < 100.0 else 0
    for share in SHARES:
        seen, made = (
            float(np.quantile(v, share)) if v.size else float("nan") for v in (observed, predicted)
        )
        label = "median" if share == 0.5 else f"{100.0 * share:g} %"
        gap = _number(made - seen, decimals, signed=True)
        rows.append((label, _number(seen, decimals), _number(made, decimals), gap))
    return rows


def _known(values: FloatArray) -> FloatArray:
    """Numbers, or rows of numbers, of which none is missing."""
    known: FloatArray = values[np.isfinite(np.atleast_2d(values.T)).all(axis=0)]
    return known


def _draw_curves(ax: Axes, observed: FloatArray, predicted: FloatArray) -> None:
    """Draw the two empirical distributions, named at the curves."""
    ax.set_xlabel("run-out (m)")
    ax.set_ylabel("rocks that stop before")
    if not (observed.size or predicted.size):
        nothing_to_show(ax)
        return
    for name, values, colour, dashes in (
        ("predicted", predicted, BLUE, (0, (4, 1.6))),
        ("observed", observed, INK, "-"),
    ):
        if values.size:
            x = np.sort(values)
            share = np.arange(x.size + 1) / x.size
            ax.step(
                [x[0], *x], 100.0 * share, where="post", color=colour, lw=1.5, ls=dashes, gid=name,
                label=name,
            )  # fmt: skip
    ax.legend(loc="best", handlelength=2.2)
    ax.set_ylim(0.0, 103.0)
    ax.yaxis.set_major_formatter(percent_formatter())
    ax.xaxis.set_major_formatter(thousands_formatter())


def _draw_table(ax: Axes, rows: Sequence[tuple[str, str, str, str]]) -> None:
    """Write the quantiles as plain text columns."""
    ax.axis("off")
    ax.set_xlim(0.0, 1.0)
    ax.set_ylim(0.0, 1.0)
    heads = ("share", "observed\n(m)", "predicted\n(m)", "difference\n(m)")
    right = (0.2, 0.46, 0.73, 1.0)
    step = 1.0 / (len(rows) + 2.0)
    for head, x in zip(heads, right, strict=True):
        ax.text(x, 1.0, head, size=SMALL, color=GREY, ha="right", va="top")
    ax.plot([0.0, 1.0], [1.0 - 1.75 * step] * 2, color=GREY, lw=0.6)
    for i, row in enumerate(rows):
        for text, x in zip(row, right, strict=True):
            ax.text(x, 1.0 - (2.35 + i) * step, text, size=TEXT, ha="right", va="center")


@house_style()
def runout_gap_figure(
    observed_m: FloatArray,
    predicted_m: FloatArray,
    *,
    grid: Grid | None = None,
    observed_xy: FloatArray | None = None,
    predicted_xy: FloatArray | None = None,
    release: Sequence[FloatArray] = (),
    title: str = "Observed and predicted run-out",
) -> Figure:
    """Compare run-outs: distributions, quantiles and, with a terrain, the stops on the map.

    Parameters
    ----------
    observed_m, predicted_m : float, shape (n,), (m,)
        Run-outs (m), measured alike.
    grid : Grid, optional
        Terrain for the map.
    observed_xy, predicted_xy : float, shape (n, 2), (m, 2), optional
        Coordinates of the stops (m).
    release : float, each of shape (n, 2)
        Outlines of the release areas (m).
    """
    seen, made = _known(observed_m), _known(predicted_m)
    stops = [np.empty((0, 2)) if xy is None else _known(xy) for xy in (observed_xy, predicted_xy)]
    note = f"{thousands(len(seen))} observed rocks, {thousands(len(made))} predicted rocks"
    sheet = Sheet(title, note, 2.4 if grid is None else 4.4)
    places = [["curves", "table"]] if grid is None else [["curves", "map"], ["table", "map"]]
    axes = sheet.figure.subplot_mosaic(places, width_ratios=(1.0, 1.1 if grid is None else 1.6))
    _draw_curves(axes["curves"], seen, made)
    _draw_table(axes["table"], quantile_rows(seen, made))
    if grid is None:
        return sheet.figure
    ax = axes["map"]
    marks = all_points([*stops, *release])
    view = relief.view_of(grid, relief.footprint(grid, None, marks))
    relief.draw_relief(view, ax)
    draw_release(ax, release)
    # Beyond a few thousand dots more ink says nothing more.
    made_xy, seen_xy = (xy[even_choice(len(xy), _MAX_POINTS)] for xy in stops[::-1])
    for name, xy, mark, size, fill, edge, width, alpha in (
        ("predicted", made_xy, "o", 2.2, BLUE, "white", 0.25, 0.65),
        ("observed", seen_xy, "D", 3.6, ORANGE, INK, 0.5, 1.0),
    ):
        draw_points(
            ax, xy, mark, size, fill, edge, width, alpha=alpha, label=f"stop, {name}", zorder=10,
            gid=f"stops-{name}",
        )  # fmt: skip
    relief.map_axes(ax, view.box)
    relief.scale_bar(ax, view.box)
    sheet.legend(ax.get_legend_handles_labels()[0])
    return sheet.figure
