"""Distributions at a station (as Bozzolo and Pamini 1986, Fig. 12) and of the run-out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.results import Histogram, StopReason
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    REASON_COLOURS,
    REASON_NAMES,
    SMALL,
    TITLE,
    WIDTH_IN,
    count,
    new_figure,
    nothing_to_show,
    percent_formatter,
    round_step,
    styled,
    thousands_formatter,
    wrap,
)
from sassgis.report.number_text import thousands

#: Ticks at round numbers.
_STEPS = [1, 2, 5, 10]


def _checked(histogram: Histogram, name: str) -> tuple[FloatArray, FloatArray]:
    """Edges and counts of a histogram of one quantity."""
    edges = np.asarray(histogram.edges, float)
    counts: FloatArray = np.asarray(histogram.counts, np.float64)
    if counts.ndim != 1 or edges.size != counts.size + 1:
        raise InputError(
            f"the histogram of {name} cannot be drawn",
            found=f"{edges.size} edges and counts of shape {counts.shape}",
            expected="one count for each bin",
        )
    return edges, counts


def common_bins(
    first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray], name: str
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Bring two histograms to the edges that both have; bars of unequal width mislead.

    What lies beyond the common edges goes to the first and the last bin.

    Raises
    ------
    InputError
        Fewer than two edges are common.
    """
    if first[0].shape == second[0].shape and np.allclose(first[0], second[0]):
        return first, second
    keep = [e for e in first[0] if np.isclose(second[0], e, rtol=1e-9, atol=1e-12).any()]
    edges = np.asarray(keep, float)
    if edges.size < 2:
        raise InputError(
            f"observed and computed {name} have no bins in common",
            found=f"{second[0].size} and {first[0].size} edges",
            expected="two common edges at least",
        )

    def merged(histogram: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
        middle = (histogram[0][:-1] + histogram[0][1:]) / 2.0
        place = np.clip(np.searchsorted(edges, middle, side="right") - 1, 0, edges.size - 2)
        counts: FloatArray = np.bincount(place, histogram[1], edges.size - 1).astype(np.float64)
        return edges, counts

    return merged(first), merged(second)


def _panel(
    ax: Axes,
    name: str,
    computed: Histogram,
    observed: Histogram | None,
    as_share: bool,
) -> None:
    """Draw one quantity: computed dashed, observed solid; computed alone is filled."""
    ax.set_xlabel(f"{name} ({computed.unit})" if computed.unit else name)
    if observed is not None and observed.unit != computed.unit:
        raise InputError(
            f"observed and computed {name} have different units",
            found=observed.unit,
            expected=computed.unit,
        )
    edges, counts = _checked(computed, name)
    sets = [(edges, counts)]
    if observed is not None:
        sets = list(common_bins((edges, counts), _checked(observed, name), name))
        edges, counts = sets[0]
    if not any(c.sum() for _, c in sets):
        nothing_to_show(ax, "no block here")
        return
    scaled = [(e, 100.0 * c / max(c.sum(), 1.0) if as_share else c) for e, c in sets]
    if observed is None:
        ax.stairs(scaled[0][1], edges, fill=True, color=BLUE, alpha=0.18, lw=0)
        ax.stairs(scaled[0][1], edges, color=BLUE, lw=1.3, gid="computed")
    else:
        ax.stairs(scaled[1][1], scaled[1][0], color=INK, lw=1.4, gid="observed")
        ax.stairs(scaled[0][1], edges, color=BLUE, lw=1.4, ls=(0, (3.5, 1.6)), gid="computed")
    # Bins reach further than most runs; show up to the last that holds a block.
    last = max(float(e[np.nonzero(c)[0][-1] + 1]) for e, c in sets if c.any())
    first = min(float(e[np.nonzero(c)[0][0]]) for e, c in sets if c.any())
    first = min(first, max(float(edges[0]), 0.0))
    ax.set_xlim(first, last + 0.04 * (last - first))
    ax.set_ylim(0.0, 1.12 * max(float(c.max()) for _, c in scaled))
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=not as_share, steps=_STEPS))
    ax.xaxis.set_major_locator(MaxNLocator(6, steps=_STEPS))
    ax.yaxis.set_major_formatter(percent_formatter() if as_share else thousands_formatter())
    # No bin's share can be read as more than it is: the last one is open.
    if counts[-1] > 0:
        ax.annotate(
            f"≥ {edges[-2]:g}",
            ((edges[-2] + edges[-1]) / 2.0, float(scaled[0][1][-1])),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            size=SMALL,
            color=BLUE,
            gid="open-bin",
        )


@styled
def station_figure(
    name: str,
    speed: Histogram,
    rotation: Histogram,
    height: Histogram,
    *,
    observed: tuple[Histogram, Histogram, Histogram] | None = None,
    n: int,
    n_observed: int | None = None,
) -> Figure:
    """Draw speed, rotation and passing height at a station.

    Parameters
    ----------
    name : str
        Name of the station.
    speed, rotation, height : Histogram
        Computed; counts of shape (n_bins,).
    observed : three Histogram, optional
        The same three quantities as observed, in the same units. Where the numbers of blocks
        differ, both are drawn as shares of the blocks that pass.
    n : int
        Number of blocks computed, whether they pass the station or not.
    n_observed : int, optional
        Number of blocks observed; default: those in the histogram of speeds.

    Raises
    ------
    InputError
        A histogram is not one of a single quantity, or units differ.
    """
    computed = (speed, rotation, height)
    labels = ("speed", "rotation", "passing height")
    passed = int(np.sum(speed.counts))
    pairs = [(c, None if observed is None else observed[i]) for i, c in enumerate(computed)]
    as_share = any(
        o is not None and int(np.sum(o.counts)) != int(np.sum(c.counts)) for c, o in pairs
    )
    figure = new_figure(WIDTH_IN, 2.55)
    axes: Sequence[Axes] = figure.subplots(1, 3)
    for ax, label, (c, o) in zip(axes, labels, pairs, strict=True):
        _panel(ax, label, c, o, as_share)
    axes[0].set_ylabel("share of the blocks" if as_share else "number of blocks")
    text = f"{thousands(passed)} of {count(n, 'simulated block')} pass"
    if observed is not None:
        seen = int(np.sum(observed[0].counts)) if n_observed is None else n_observed
        text = f"dashed: simulated, {text}; solid: observed, {count(seen, 'block')}"
    figure.suptitle(wrap(name, WIDTH_IN, TITLE), x=0.01, ha="left", size=TITLE, weight="bold")
    # The caption takes the place of a legend: two line styles need no box.
    figure.supxlabel(text, size=SMALL, color=GREY, x=0.01, ha="left")
    return figure


def _share_beyond(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Chainages and the share of blocks that get at least so far."""
    reached = np.sort(values)
    share = 1.0 - np.arange(reached.size) / reached.size
    return reached, share


def _draw_runout(
    edges: FloatArray,
    counts: Mapping[StopReason, FloatArray],
    curve: tuple[FloatArray, FloatArray],
    title: str,
    *,
    exact: bool,
) -> Figure:
    """Draw stacked counts by reason, and the exceedance above them."""
    figure = new_figure(WIDTH_IN, 4.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.15))
    total = {reason: float(c.sum()) for reason, c in counts.items()}
    present = [reason for reason in StopReason if total.get(reason, 0.0) > 0.0]
    n = sum(total.values())
    if title:
        figure.suptitle(wrap(title, WIDTH_IN, TITLE), x=0.01, ha="left", size=TITLE, weight="bold")
    upper.set_ylabel("blocks that get\nat least so far")
    lower.set_ylabel("blocks that stop here")
    lower.set_xlabel("run-out chainage (m)")
    if not present:
        nothing_to_show(upper, "no block")
        nothing_to_show(lower, "no block")
        return figure

    upper.plot(
        np.concatenate([[curve[0][0]], curve[0]]),
        100.0 * np.concatenate([[1.0], curve[1]]),
        # Between the edges of bins the course is unknown; a straight line claims least.
        drawstyle="steps-pre" if exact else "default",
        color=INK,
        lw=1.4,
        gid="exceedance",
    )
    upper.set_ylim(0.0, 104.0)
    upper.yaxis.set_major_formatter(percent_formatter())
    base = np.zeros(edges.size - 1)
    for reason in present:
        values = np.asarray(counts[reason], float)
        lower.stairs(
            base + values,
            edges,
            baseline=base,
            fill=True,
            color=REASON_COLOURS[reason],
            alpha=0.9,
            lw=0,
            label=f"{REASON_NAMES[reason]}: {thousands(total[reason])}",
            gid=f"reason-{reason.name}",
        )
        base = base + values
    lower.set_ylim(0.0, 1.08 * float(base.max()))
    lower.yaxis.set_major_locator(MaxNLocator(5, integer=True, steps=_STEPS))
    lower.yaxis.set_major_formatter(thousands_formatter())
    lower.xaxis.set_major_formatter(thousands_formatter())
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
        upper.set_title(
            f"{count(int(open_end), 'block')} of {thousands(n)} went on where the computation "
            "ended: the true shares lie on or above the line",
            size=SMALL,
            weight="normal",
            color=GREY,
        )
    return figure


@styled
def runout_figure(
    runout_m: FloatArray,
    reasons: IntArray,
    *,
    bin_m: float | None = None,
    title: str = "",
) -> Figure:
    """Draw where blocks end, and the share that gets at least so far.

    Parameters
    ----------
    runout_m : float, shape (n,)
        Chainage where each block ended (m).
    reasons : int, shape (n,)
        Its StopReason.
    bin_m : float, optional
        Width of a bar (m); default: a round width for about 30 bars.
    title : str

    Raises
    ------
    InputError
        The arrays differ in length or hold values that are no numbers.
    """
    values = np.asarray(runout_m, float)
    why = np.asarray(reasons, np.int64)
    if values.ndim != 1 or values.shape != why.shape:
        raise InputError(
            "each run-out needs its reason", found=f"shapes {values.shape} and {why.shape}"
        )
    if not np.isfinite(values).all():
        raise InputError("run-outs must be numbers", found=int((~np.isfinite(values)).sum()))
    if not values.size:
        return _draw_runout(np.array([0.0, 1.0]), {}, (values, values), title, exact=True)
    width = bin_m or round_step(float(np.ptp(values)), 30)
    first = np.floor(values.min() / width) * width
    n_bins = int(np.floor((values.max() - first) / width)) + 1
    edges = first + width * np.arange(n_bins + 1)
    counts = {
        reason: np.histogram(values[why == reason], edges)[0].astype(float) for reason in StopReason
    }
    return _draw_runout(edges, counts, _share_beyond(values), title, exact=True)


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
    title : str

    Raises
    ------
    InputError
        Counts do not fit the edges.
    """
    limits = np.asarray(edges, float)
    bins = {reason: np.asarray(c, float) for reason, c in counts.items()}
    for reason, values in bins.items():
        if values.shape != (limits.size - 1,):
            raise InputError(
                f"run-out counts ({REASON_NAMES[reason]}) do not fit the bins",
                found=f"shape {values.shape}",
                expected=f"({limits.size - 1},)",
            )
    total = np.sum(list(bins.values()), axis=0) if bins else np.zeros(limits.size - 1)
    n = float(total.sum())
    share = 1.0 - np.cumsum(total) / n if n else total
    # At the lower edge of a bin all blocks of the bin and of those beyond are still moving.
    curve = (limits, np.concatenate([[1.0], share]))
    return _draw_runout(limits, bins, curve, title, exact=False)
