"""How far results depend on the cutting of the slope into segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    SMALL,
    TITLE,
    WIDTH_IN,
    new_figure,
    nothing_to_show,
    styled,
    thousands_formatter,
    wrap,
)


@styled
def convergence_figure(
    tolerances: FloatArray,
    series: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]],
    *,
    title: str = "Effect of the cutting of the slope into segments",
) -> Figure:
    """Draw results against the tolerance of the segments, with their statistical range.

    Parameters
    ----------
    tolerances : float, shape (n,)
        Largest distance between terrain and segment (m).
    series : by name with unit, (values, lower, upper) of float, shape (n,)
        One panel each; lower and upper are the limits of the confidence interval.
    title : str

    Raises
    ------
    InputError
        A series does not fit the tolerances, or a tolerance is not above zero.
    """
    x = np.asarray(tolerances, float)
    if np.any(x <= 0.0):
        raise InputError("tolerances must be above zero", field="tolerances", found=float(x.min()))
    order = np.argsort(x)
    n = max(len(series), 1)
    columns = min(n, 3)
    rows = -(-n // columns)
    figure = new_figure(WIDTH_IN, 0.55 + 2.35 * rows)
    axes: Sequence[Axes] = list(figure.subplots(rows, columns, squeeze=False).ravel())
    figure.suptitle(wrap(title, WIDTH_IN, TITLE), x=0.01, ha="left", size=TITLE, weight="bold")
    for ax in axes[len(series) :]:
        ax.set_visible(not series)
    if not series or not x.size:
        for ax in axes:
            nothing_to_show(ax)
        return figure
    for ax, (name, arrays) in zip(axes, series.items(), strict=False):
        values, lower, upper = (np.asarray(a, float) for a in arrays)
        if any(a.shape != x.shape for a in (values, lower, upper)):
            raise InputError(
                f"the series {name!r} does not fit the tolerances",
                found=f"shapes {values.shape}, {lower.shape}, {upper.shape}",
                expected=f"({x.size},)",
            )
        ax.set_title(wrap(name, WIDTH_IN / columns - 0.4, SMALL + 1.0), size=SMALL + 1.0)
        finest = order[0]
        ax.axhspan(
            float(lower[finest]), float(upper[finest]), color=BLUE, alpha=0.1, lw=0, gid="finest"
        )
        gaps = np.vstack([values - lower, upper - values])[:, order]
        ax.errorbar(
            x[order],
            values[order],
            yerr=np.maximum(gaps, 0.0),
            fmt="o-",
            color=BLUE,
            ms=3.5,
            lw=1.2,
            elinewidth=0.9,
            capsize=2.0,
        )
        ax.set_xscale("log")
        ax.set_xticks(x[order])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        ax.yaxis.set_major_formatter(_plain(lower, upper))
        ax.set_xlabel("segment tolerance (m)")
        span = float(np.nanmax(upper) - np.nanmin(lower)) or 1.0
        ax.set_ylim(float(np.nanmin(lower)) - 0.15 * span, float(np.nanmax(upper)) + 0.15 * span)
    figure.supxlabel(
        "band: confidence interval at the finest tolerance",
        size=SMALL,
        color=GREY,
        x=0.01,
        ha="left",
    )
    return figure


def _plain(lower: FloatArray, upper: FloatArray) -> FuncFormatter:
    """Tick labels with as many decimals as the range needs."""
    span = float(np.nanmax(upper) - np.nanmin(lower))
    return thousands_formatter(0 if span >= 5.0 else 1 if span >= 0.5 else 2)
