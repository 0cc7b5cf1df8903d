"""The figure of a line of protection: what reaches it along the slope, and what goes on behind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from sassgis.hazard.design import Arrivals
from sassgis.model.languages import phrase
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    LIGHT,
    SMALL,
    VERMILION,
    WIDTH_IN,
    beside,
    halo,
    house_style,
    new_figure,
)

#: Frequencies this much rarer than the longest return period are not drawn.
_RARER = 5.0


@house_style()
def protection_figure(
    places: pd.DataFrame,
    before: Arrivals,
    behind: Arrivals | None,
    return_periods_years: Sequence[float],
    *,
    capacity_kj: float,
    confidence: float,
) -> Figure:
    """Draw energies before and behind a line by frequency, and what reaches copies of the line.

    Parameters
    ----------
    places : DataFrame
        Rows of places_table of this line; with a single row the second part is left out.
    before, behind : Arrivals
        Energies without walls and nets, and with them behind the line; None: no barrier.
    capacity_kj : float
        Drawn where it is finite.
    confidence : float
        Of the bands.
    """
    along = len(places) > 1
    figure = new_figure(WIDTH_IN, 2.7)
    grid = figure.add_gridspec(2, 2 if along else 1, height_ratios=(2.2, 1.0))
    ax = figure.add_subplot(grid[:, 0])
    least = 1.0 / max(return_periods_years) / _RARER
    for curve, colour, name in (
        (before, BLUE, "arriving, without walls and nets"),
        (behind, VERMILION, "going on behind it"),
    ):
        if curve is None:
            continue
        # The first bin holds blocks that a barrier takes.
        known = slice(1, None)
        low, high = (end.rate[known] for end in curve.limits(confidence))
        energy, rate = curve.edges[known], curve.rate[known]
        ax.fill_between(energy, low, high, where=high > 0, color=colour, alpha=0.18, lw=0.0)
        ax.plot(energy[rate > 0.0], rate[rate > 0.0], color=colour, lw=1.3, label=name)
    most = float(before.rate[1])
    shown = before.edges[1:][before.rate[1:] >= min(0.9 * most, least)]
    ends = (before.largest, capacity_kj)
    right = max([10.0, *(e for e in ends if np.isfinite(e))])
    ax.set(
        xscale="log", xlim=(max(1.0, shown.min(initial=1.0)), 1.6 * right),
        xlabel="energy at least (kJ)",
        yscale="log", ylim=(least, max(2.0 * most, 10.0 * least)), ylabel="blocks a year",
    )  # fmt: skip
    for years in return_periods_years:
        ax.axhline(1.0 / years, color=LIGHT, lw=0.8, zorder=0.5)
        beside(
            ax, phrase("{} years", f"{years:g}"), (ax.get_xlim()[1], 1.0 / years), (-3, 2),
            ha="right", color=GREY, path_effects=halo(),
        )  # fmt: skip
    if np.isfinite(capacity_kj):
        ax.axvline(capacity_kj, color=INK, lw=0.9, ls="--", label=phrase("capacity of the net"))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_locator(NullLocator())
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=SMALL, loc="lower left")
    if along:
        upper = figure.add_subplot(grid[0, 1])
        _draw_along(upper, figure.add_subplot(grid[1, 1], sharex=upper), places)
    return figure


def _draw_along(upper: Axes, lower: Axes, places: pd.DataFrame) -> None:
    """95 % energy and passing height, and the share of the blocks that comes so far."""
    moved = places["moved_m"].to_numpy(float)
    other = upper.twinx()
    for ax, key, colour, name, style in (
        (upper, "energy_q95_kj", BLUE, "energy, 95 % (kJ)", "o-"),
        (other, "height_q95_m", VERMILION, "passing height, 95 % (m)", "s--"),
    ):
        value, low, high = (places[key + end].to_numpy(float) for end in ("", "_low", "_high"))
        ax.fill_between(moved, low, high, color=colour, alpha=0.15, lw=0.0)
        ax.plot(moved, value, style, color=colour, ms=3.0, lw=1.1)
        ax.set_ylabel(name, color=colour, size=SMALL)
        ax.set_ylim(0.0, 1.15 * float(np.nanmax([*value, *high, 1e-9])))
    other.spines["right"].set_visible(True)
    upper.tick_params(labelbottom=False)
    lower.bar(moved, 100.0 * places["share"].to_numpy(float), 7.0, color=GREY)
    lower.set_ylabel("blocks (%)", size=SMALL)
    lower.set_xlabel("line moved: upslope (−), downslope (+) (m)")
    lower.set_xticks(moved)
    for ax in (upper, lower):
        ax.axvline(0.0, color=INK, lw=0.7, zorder=0.4)
