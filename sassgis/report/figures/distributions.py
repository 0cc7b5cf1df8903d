"""Distributions along a profile, at a station (Bozzolo and Pamini 1986, Fig. 12), of run-outs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.labels import thousands
from sassgis.model.languages import phrase
from sassgis.model.results import ControlLine, Histogram, StopReason
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SMALL,
    VERMILION,
    WIDTH_IN,
    beside,
    halo,
    head,
    house_style,
    log_ticks,
    new_figure,
    nothing_to_show,
    percent_formatter,
    round_step,
    spread,
    text_width_pt,
    thousands_formatter,
)

#: Name and unit of what can be drawn, and title of the figure.
QUANTITIES = {
    "energy": ("kinetic energy", "kJ", "Kinetic energy along the profile"),
    "speed": ("speed", "m/s", "Speed along the profile"),
    "height": ("passing height", "m", "Passing height along the profile"),
}


@house_style()
def energy_profile_figure(
    s_bins: FloatArray,
    quantiles: Mapping[float, FloatArray],
    s: FloatArray,
    z: FloatArray,
    *,
    quantity: str = "energy",
    control_lines: Sequence[tuple[ControlLine, float]] = (),
) -> Figure:
    """Draw quantiles of a quantity along the profile, with the slope beneath.

    Parameters
    ----------
    s_bins : float, shape (n + 1,)
        Edges of the chainage bins (m).
    quantiles : by share (0.5, 0.95, ...), float, shape (n,)
        Value that this share of the passing blocks stays below; NaN where no block passes.
    s, z : float, shape (m,)
        Chainage and height of the vertices of the slope (m).
    quantity : {"energy", "speed", "height"}
        Energy (kJ) has a logarithmic axis; speed (m/s) and passing height (m) a plain one.
    control_lines : (ControlLine, chainage)
        Marked in both panels.
    """
    name, unit, title = QUANTITIES[quantity]
    figure = new_figure(WIDTH_IN, 4.3)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1.0))
    head(figure, title)
    upper.set_ylabel(phrase("{} ({})", phrase(name), unit))
    lower.plot(s, z, color=INK, lw=1.2, gid="slope")
    lower.fill_between(s, z, np.min(z), color="#ece9e4", lw=0)
    lower.set(
        xlabel="chainage (m)", xlim=(np.min(s), np.max(s)),
        ylabel="height (m)", ylim=(np.min(z), np.max(z) + 0.06 * np.ptp(z) + 1e-9),
    )  # fmt: skip
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_formatter(thousands_formatter())
    _draw_control_lines(upper, lower, control_lines)

    log = quantity == "energy"
    # A log axis cannot show a block that stands still; a gap there is what is known.
    curves = {q: np.where(v > 0.0, v, np.nan) if log else v for q, v in sorted(quantiles.items())}
    known = np.concatenate([v[np.isfinite(v)] for v in curves.values()] or [np.empty(0)])
    if not known.size:
        nothing_to_show(upper, "no block passes", keep_x=True)
        return figure
    if log:
        high = np.log10(known.max())
        # Blocks about to stop draw a long tail to nothing: five decades show all that matters.
        low = max(np.log10(known.min()), high - 5.0)
        ends = 10.0 ** (low - 0.08), 10.0 ** (high + 0.12 * (high - low) + 0.1)
        upper.set(yscale="log", ylim=ends)
        log_ticks(upper.yaxis, high - low)
    else:
        upper.set_ylim(min(0.0, float(known.min())), 1.1 * max(float(known.max()), 1e-9))
    for i, (share, values) in enumerate(curves.items()):
        tone = 0.35 + 0.65 * (i + 1) / len(curves)
        shade = to_hex((1.0 - tone, 1.0 - 0.72 * tone, 1.0 - 0.5 * tone))
        width = 0.9 + 0.35 * i
        upper.stairs(values, s_bins, baseline=None, color=shade, lw=width, gid=f"q{share:g}")
    _name_curves(upper, (s_bins[:-1] + s_bins[1:]) / 2.0, curves, log)
    return figure


def _draw_control_lines(
    upper: Axes, lower: Axes, control_lines: Sequence[tuple[ControlLine, float]]
) -> None:
    x0, x1 = lower.get_xlim()
    # The panels are about 5.6 inches wide.
    room = np.array([text_width_pt(line.name) for line, _ in control_lines])
    placed = spread([at for _, at in control_lines], room * (x1 - x0) / (72.0 * 5.6))
    for (line, at), label in zip(control_lines, placed, strict=True):
        colour = BLUE if line.kind == "station" else VERMILION
        for ax in (upper, lower):
            ax.axvline(at, color=colour, lw=0.8, ls=(0, (4, 2)), zorder=1)
        upper.annotate(
            line.name, (at, 1.0), xycoords=("data", "axes fraction"), xytext=(label, 1.015),
            textcoords=("data", "axes fraction"), ha="center", va="bottom", size=SMALL,
            weight="bold", color=colour,
        )  # fmt: skip


def _name_curves(
    ax: Axes, middle: FloatArray, curves: Mapping[float, FloatArray], log: bool
) -> None:
    """Write the quantiles on their curves, at the chainage where these lie furthest apart."""
    values = np.stack(list(curves.values()))
    low, high = ax.get_ylim()
    scale = np.log10 if log else np.asarray
    bottom = float(scale(low))
    heights = (scale(np.maximum(values, low)) - bottom) / (float(scale(high)) - bottom)
    x0, x1 = ax.get_xlim()
    # Labels at the very ends would leave the panel.
    inner = (middle >= x0 + 0.06 * (x1 - x0)) & (middle <= x1 - 0.06 * (x1 - x0))
    apart = np.diff(heights, axis=0).min(axis=0) if len(heights) > 1 else heights[0]
    score = np.where(inner & np.isfinite(heights).all(axis=0), apart, -np.inf)
    best = int(np.argmax(score))
    if not np.isfinite(score[best]):
        # No chainage shows all curves: each gets its name at its own middle.
        places = [np.nonzero(np.isfinite(row))[0] for row in heights]
        columns = [int(p[p.size // 2]) if p.size else -1 for p in places]
    else:
        columns = [best] * len(heights)
    wanted = np.array([row[c] if c >= 0 else 0.0 for row, c in zip(heights, columns, strict=True)])
    placed = spread(wanted + 0.035, 0.065)
    for share, column, height in zip(curves, columns, placed, strict=True):
        if column >= 0:
            ax.text(
                float(middle[column]),
                float(height),
                # The median, or the share of blocks that stays below.
                phrase("median") if share == 0.5 else f"{100.0 * share:.4g} %",
                transform=ax.get_xaxis_transform(),
                ha="center",
                va="center",
                size=SMALL,
                path_effects=halo(2.2),
                zorder=8,
            )


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


def _panel(ax: Axes, name: str, histogram: Histogram, log: bool) -> None:
    ax.set_xlabel(phrase("{} ({})", phrase(name), histogram.unit))
    edges, counts = histogram.edges, histogram.counts
    used = np.nonzero(counts)[0]
    if not used.size:
        nothing_to_show(ax, "no block here")
        return
    ax.stairs(counts, edges, fill=True, color=BLUE, alpha=0.18, lw=0)
    ax.stairs(counts, edges, color=BLUE, lw=1.3, gid="computed")
    # Bins reach further than most runs; show up to the last that holds a block.
    first, last = float(edges[used[0]]), float(edges[used[-1] + 1])
    if log:
        ax.set(xscale="log", xlim=(first / 1.1, 1.1 * last))
        log_ticks(ax.xaxis, np.log10(last / first))
    else:
        first = min(first, max(float(edges[0]), 0.0))
        ax.set_xlim(first, last + 0.04 * (last - first))
        ax.xaxis.set_major_locator(MaxNLocator(6, steps=_STEPS))
    ax.set_ylim(0.0, 1.12 * float(counts.max()))
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=True, steps=_STEPS))
    ax.yaxis.set_major_formatter(thousands_formatter())
    # No bin's share can be read as more than it is: the last one is open.
    if counts[-1] > 0:
        at = ((edges[-2] + edges[-1]) / 2.0, float(counts[-1]))
        look = {"ha": "center", "va": "bottom", "color": BLUE, "gid": "open-bin"}
        beside(ax, f"≥ {edges[-2]:.3g}", at, (0, 2), **look)


@house_style()
def station_figure(name: str, *histograms: Histogram, n: int) -> Figure:
    """Draw speed, rotation, height and energy of the blocks that pass a station, of n in all.

    The edges of the energies grow by a factor.
    """
    figure = new_figure(WIDTH_IN, 4.4)
    axes = figure.subplots(2, 2)
    quantities = ("speed", "rotation", "passing height", "kinetic energy")
    for ax, quantity, histogram in zip(axes.flat, quantities, histograms, strict=True):
        _panel(ax, quantity, histogram, log=quantity == "kinetic energy")
    for ax in axes[:, 0]:
        ax.set_ylabel("number of blocks")
    head(figure, name)
    passed = thousands(int(np.sum(histograms[0].counts)))
    text = phrase("{} of {} simulated blocks pass", passed, thousands(n))
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
    lower.set(xlabel="run-out chainage (m)", ylabel="blocks that stop here")
    upper.plot(
        [curve[0][0], *curve[0]], [100.0, *(100.0 * curve[1])], drawstyle=drawstyle, color=INK,
        lw=1.4, gid="exceedance",
    )  # fmt: skip
    upper.set(ylabel="blocks that get\nat least so far", ylim=(0.0, 104.0))
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
            label=phrase("{}: {}", phrase(name), thousands(total[reason])),
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
        text = (
            "{} block of {} went on where the computation ended: the true shares lie on or above "
            "the line"
            if open_end == 1.0
            else "{} blocks of {} went on where the computation ended: the true shares lie on or "
            "above the line"
        )
        words = phrase(text, thousands(open_end), thousands(sum(total.values())))
        upper.set_title(words, size=SMALL, weight="normal", color=GREY)
    return figure


@house_style()
def runout_figure(runout_m: FloatArray, reasons: IntArray) -> Figure:
    """Draw where blocks end (chainage, m) by StopReason, and the share that gets at least so far.

    Bars are of a round width, about 30 of them.
    """
    width = round_step(float(np.ptp(runout_m)), 30)
    first = np.floor(runout_m.min() / width) * width
    n_bins = int(np.floor((runout_m.max() - first) / width)) + 1
    edges = first + width * np.arange(n_bins + 1)
    counts = {r: np.histogram(runout_m[reasons == r], edges)[0].astype(float) for r in StopReason}
    curve = np.sort(runout_m), 1.0 - np.arange(runout_m.size) / runout_m.size
    return _draw_runout(edges, counts, curve, "", "steps-pre")


@house_style()
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
