"""How good a diagnosis is: what it answered, and how far its confidence can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from sassgis.gap.check.check_scores import ANSWERS, ReliabilityRow
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    LIGHT,
    TEXT,
    VERMILION,
    WIDTH_IN,
    beside,
    count,
    house_style,
    new_figure,
    nothing_to_show,
    percent_formatter,
)

_SHADES = LinearSegmentedColormap.from_list("shares", ["#ffffff", "#d6e7f3", "#7fb6da", BLUE])
_DIAGONAL: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (4, 3))}


@house_style()
def confusion_figure(worlds: NDArray[np.int64]) -> Figure:
    """Draw how many sites of each truth were given which answer.

    Cells hold numbers of sites and are shaded by their share of the row; those of right answers
    are outlined. Rows and columns without a site are left out, but for the diagonal.

    Parameters
    ----------
    worlds : int64, shape (14, 15)
        Truth (``sassgis.gap.check.check_scores.ANSWERS`` without the last) by answer (``ANSWERS``).
    """
    rows = [k for k in range(len(worlds)) if worlds[k].sum()]
    columns = [k for k in range(worlds.shape[1]) if k in rows or worlds[:, k].sum()]
    figure = new_figure(WIDTH_IN, 1.9 + 0.3 * max(len(rows), 2))
    ax = figure.add_subplot()
    ax.set_title("Answers by truth (sites)")
    shown = worlds[np.ix_(rows, columns)]
    totals = shown.sum(axis=1)
    shares = shown / totals[:, None]
    ax.imshow(shares, cmap=_SHADES, vmin=0.0, vmax=1.0, aspect="auto")
    ax.grid(False)
    for (i, j), number in np.ndenumerate(shown):
        right = rows[i] == columns[j]
        if right:
            corner = (j - 0.46, i - 0.44)
            ax.add_patch(Rectangle(corner, 0.92, 0.88, fill=False, ec=INK, lw=1.0, zorder=3))
        text = str(number) if number or right else "·"
        colour = "white" if shares[i, j] > 0.7 else INK if number else GREY
        ax.text(j, i, text, ha="center", va="center", size=TEXT, color=colour)

    def title_of(k: int) -> str:
        name = ANSWERS[k]
        return {"none": "no effect", "pair": "a pair"}.get(name, name.replace("_", " "))

    ax.set_xticks(range(len(columns)), [title_of(k) for k in columns])
    ax.tick_params(axis="x", rotation=45, length=0)
    for label in ax.get_xticklabels():
        label.set_horizontalalignment("right")
        label.set_rotation_mode("anchor")
    names = [f"{title_of(k)} ({n})" for k, n in zip(rows, totals, strict=True)]
    ax.set_yticks(range(len(rows)), names)
    ax.tick_params(axis="y", length=0)
    ax.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    ax.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    ax.grid(True, which="minor", color="white", linewidth=1.0)
    ax.tick_params(which="minor", length=0)
    ax.set(xlabel="answer", ylabel="truth (sites)")
    ax.spines[:].set_visible(False)
    return figure


@house_style()
def reliability_figure(rows: Sequence[ReliabilityRow], limit: float, least: float) -> Figure:
    """Draw the share of right answers against the confidence that was stated.

    Bars are 95 % intervals; on the diagonal, confidence is what it says. Beneath, how many answers
    each bin holds. From the confidence ``limit`` on a share of ``least`` is to be right.
    """
    figure = new_figure(0.72 * WIDTH_IN, 4.6)
    ax, counts = figure.subplots(2, 1, sharex=True, height_ratios=[4.0, 1.0])
    ax.set_title("Right answers by stated confidence")
    ax.plot([0.0, 1.0], [0.0, 1.0], **_DIAGONAL)
    ax.axvline(limit, color=VERMILION, linewidth=0.8)
    wanted = f"required: {100.0 * least:.0f} % right from {limit:g} on"
    beside(ax, wanted, (limit, 0.02), (3, 0), color=VERMILION)
    known = [row for row in rows if row.right.trials]
    if not known:
        nothing_to_show(ax, keep_x=True)
    y = [row.right.value for row in known]
    below = [row.right.value - row.right.low for row in known]
    above = [row.right.high - row.right.value for row in known]
    ax.errorbar(
        [row.confidence for row in known], y, yerr=[below, above], fmt="o", color=BLUE,
        markersize=5, capsize=3, linewidth=1.1,
    )  # fmt: skip
    for row in known:
        left = row.confidence >= 0.85
        beside(
            ax, f"{row.right.hits} of {row.right.trials}", (row.confidence, row.right.value),
            (-7.0 if left else 7.0, 0), ha="right" if left else "left", va="center",
            bbox={"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none"},
        )  # fmt: skip
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), ylabel="answers that were right")
    ax.yaxis.set_major_formatter(percent_formatter(1.0))
    counts.bar(
        [row.low for row in rows], [row.right.trials for row in rows],
        width=[row.high - row.low for row in rows], align="edge", color=LIGHT, edgecolor="white",
    )  # fmt: skip
    sites = count(sum(row.right.trials for row in rows), "site")
    counts.set(xlabel=f"stated confidence, mean of each bin ({sites})", ylabel="sites")
    counts.grid(False, axis="x")
    return figure


@house_style()
def shrinkage_figure(stated: Sequence[float], measured: Sequence[float], near: float) -> Figure:
    """Draw stated shrinkages against those on fresh rocks, one point for each site.

    How far apart they may be, ``near``, is drawn as a band.
    """
    figure = new_figure(0.62 * WIDTH_IN, 0.6 * WIDTH_IN)
    ax = figure.add_subplot()
    ax.set(title="Shrinkage of the gap", xlabel="on fresh rocks", ylabel="stated")
    values = [*stated, *measured, 0.0, 1.0]
    low, high = min(values) - 0.05, max(values) + 0.05
    ends = np.array([low, high])
    label = f"within {near:g}"
    ax.fill_between(ends, ends - near, ends + near, color=LIGHT, linewidth=0.0, label=label)
    ax.plot(ends, ends, **_DIAGONAL)
    ax.plot(measured, stated, "o", color=BLUE, markersize=4, alpha=0.8)
    ax.set(xlim=(low, high), ylim=(low, high), aspect="equal")
    ax.legend(loc="upper left")
    return figure
