"""Distributions at a station (as Bozzolo and Pamini 1986, Fig. 12) and of the run-out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.results import Histogram, StopReason
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SMALL,
    VERMILION,
    WIDTH_IN,
    count,
    head,
    new_figure,
    nothing_to_show,
    percent_formatter,
    round_step,
    styled,
    thousands_formatter,
)
from sassgis.report.number_text import thousands

#: Ticks at round numbers.
_STEPS = [1, 2, 5, 10]
_REASONS = {
    StopReason.REST: ("at rest", BLUE),
    StopReason.BARRIER: ("stopped by a barrier", VERMILION),
    StopReason.LEFT_PROFILE: ("left the profile", ORANGE),
    StopReason.STEP_LIMIT: ("given up (step limit)", PURPLE),
    StopReason.NEVER_STARTED: ("never started", "#8c8c8c"),
    StopReason.BROKEN: ("broke into fragments", "#3d3d3d"),
}


def _panel(ax: Axes, name: str, histogram: Histogram) -> None:
    ax.set_xlabel(f"{name} ({histogram.unit})")
    edges, counts = histogram.edges, histogram.counts
    used = np.nonzero(counts)[0]
    if not used.size:
        nothing_to_show(ax, "no block here")
        return
    ax.stairs(counts, edges, fill=True, color=BLUE, alpha=0.18, lw=0)
    ax.stairs(counts, edges, color=BLUE, lw=1.3, gid="computed")
    # Bins reach further than most runs; show up to the last that holds a block.
    first, last = float(edges[used[0]]), float(edges[used[-1] + 1])
    first = min(first, max(float(edges[0]), 0.0))
    ax.set_xlim(first, last + 0.04 * (last - first))
    ax.set_ylim(0.0, 1.12 * float(counts.max()))
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=True, steps=_STEPS))
    ax.xaxis.set_major_locator(MaxNLocator(6, steps=_STEPS))
    ax.yaxis.set_major_formatter(thousands_formatter())
    # No bin's share can be read as more than it is: the last one is open.
    if counts[-1] > 0:
        ax.annotate(
            f"≥ {edges[-2]:g}", ((edges[-2] + edges[-1]) / 2.0, float(counts[-1])), xytext=(0, 2),
            textcoords="offset points", ha="center", va="bottom", size=SMALL, color=BLUE,
            gid="open-bin",
        )  # fmt: skip


@styled
def station_figure(
    name: str, speed: Histogram, rotation: Histogram, height: Histogram, *, n: int
) -> Figure:
    """Draw speed, rotation and passing height of the blocks that pass a station, of n in all."""
    figure = new_figure(WIDTH_IN, 2.55)
    axes: Sequence[Axes] = figure.subplots(1, 3)
    labels = ("speed", "rotation", "passing height")
    for ax, label, histogram in zip(axes, labels, (speed, rotation, height), strict=True):
        _panel(ax, label, histogram)
    axes[0].set_ylabel("number of blocks")
    head(figure, name)
    text = f"{thousands(int(np.sum(speed.counts)))} of {count(n, 'simulated block')} pass"
    figure.supxlabel(text, size=SMALL, color=GREY, x=0.01, ha="left")
    return figure


def _draw_runout(
    edges: FloatArray,
    counts: Mapping[StopReason, FloatArray],
    curve: tuple[FloatArray, FloatArray],
    title: str,
    drawstyle: str,
) -> Figure:
    """Draw stacked counts by reason, and the exceedance (at least one block) above them."""
    figure = new_figure(WIDTH_IN, 4.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.15))
    total = {reason: float(counts[reason].sum()) for reason in StopReason if reason in counts}
    present = [reason for reason, number in total.items() if number > 0.0]
    if title:
        head(figure, title)
    upper.set_ylabel("blocks that get\nat least so far")
    lower.set_ylabel("blocks that stop here")
    lower.set_xlabel("run-out chainage (m)")
    upper.plot(
        [curve[0][0], *curve[0]], [100.0, *(100.0 * curve[1])], drawstyle=drawstyle, color=INK,
        lw=1.4, gid="exceedance",
    )  # fmt: skip
    upper.set_ylim(0.0, 104.0)
    upper.yaxis.set_major_formatter(percent_formatter())
    base = np.zeros(edges.size - 1)
    for reason in present:
        name, colour = _REASONS[reason]
        above = base + counts[reason]
        lower.stairs(
            above,
            edges,
            baseline=base,
            fill=True,
            color=colour,
            alpha=0.9,
            lw=0,
            label=f"{name}: {thousands(total[reason])}",
            gid=f"reason-{reason.name}",
        )
        base = above
    lower.set_ylim(0.0, 1.08 * float(base.max()))
    lower.yaxis.set_major_locator(MaxNLocator(5, integer=True, steps=_STEPS))
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_formatter(thousands_formatter())
    used = np.nonzero(base)[0]
    span = float(edges[used[-1] + 1] - edges[used[0]])
    lower.set_xlim(float(edges[used[0]]) - 0.02 * span, float(edges[used[-1] + 1]) + 0.02 * span)
    figure.legend(
        *lower.get_legend_handles_labels(),
        loc="outside lower left",
        ncols=min(3, len(present)),
        handlelength=1.0,
        columnspacing=1.6,
    )
    open_end = total.get(StopReason.LEFT_PROFILE, 0.0) + total.get(StopReason.STEP_LIMIT, 0.0)
    if open_end:
        of = f"{count(int(open_end), 'block')} of {thousands(sum(total.values()))}"
        upper.set_title(
            f"{of} went on where the computation ended: the true shares lie on or above the line",
            size=SMALL, weight="normal", color=GREY,
        )  # fmt: skip
    return figure


@styled
def runout_figure(runout_m: FloatArray, reasons: IntArray, *, bin_m: float | None = None) -> Figure:
    """Draw where blocks end, and the share that gets at least so far.

    Parameters
    ----------
    runout_m : float, shape (n,)
        Chainage where each block ended (m).
    reasons : int, shape (n,)
        Its StopReason.
    bin_m : float, optional
        Width of a bar (m); default: a round width for about 30 bars.
    """
    width = bin_m or round_step(float(np.ptp(runout_m)), 30)
    first = np.floor(runout_m.min() / width) * width
    n_bins = int(np.floor((runout_m.max() - first) / width)) + 1
    edges = first + width * np.arange(n_bins + 1)
    counts = {r: np.histogram(runout_m[reasons == r], edges)[0].astype(float) for r in StopReason}
    curve = np.sort(runout_m), 1.0 - np.arange(runout_m.size) / runout_m.size
    return _draw_runout(edges, counts, curve, "", "steps-pre")


@styled
def runout_counts_figure(
    edges: FloatArray, counts: Mapping[StopReason, IntArray], *, title: str = ""
) -> Figure:
    """Draw the run-out of a run that kept counts only.

    Parameters
    ----------
    edges : float, shape (n_bins + 1,)
        Chainages between the bins (m).
    counts : by StopReason, int, shape (n_bins,)
    """
    bins = {reason: np.asarray(c, float) for reason, c in counts.items()}
    total = np.sum(list(bins.values()), axis=0)
    # At the lower edge of a bin all blocks of the bin and of those beyond are still moving.
    curve = edges, np.concatenate([[1.0], 1.0 - np.cumsum(total) / total.sum()])
    # Between the edges of bins the course is unknown; a straight line claims least.
    return _draw_runout(edges, bins, curve, title, "default")
