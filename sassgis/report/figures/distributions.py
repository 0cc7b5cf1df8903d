"""Distributions along a profile, at a station (Bozzolo and Pamini 1986, Fig. 12), of run-outs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sassgis.grid import FloatArray, IntArray
from sassgis.report.figures import style
from sassgis.settings.languages import counted, phrase
from sassgis.settings.results import (
    STILL_MOVING,
    ControlLine,
    Histogram,
    StopReason,
    thousands,
)

#: Name and unit of what can be drawn, and title of the figure.
QUANTITIES = {
    "energy": ("kinetic energy", "kJ", "Kinetic energy along the profile"),
    "speed": ("speed", "m/s", "Speed along the profile"),
    "height": ("passing height", "m", "Passing height along the profile"),
}


@style.house_style()
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

    ``s_bins`` of shape (n + 1,) are the edges of the chainage bins (m), the quantiles those of the
    passing blocks by share, of shape (n,), NaN where none passes; energy has a logarithmic axis.
    """
    name, unit, title = QUANTITIES[quantity]
    figure = style.Sheet(title, "", 4.0).figure
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1.0))
    upper.set_ylabel(phrase("{} ({})", phrase(name), unit))
    lower.plot(s, z, color=style.INK, lw=1.2, gid="slope")
    lower.fill_between(s, z, np.min(z), color="#ece9e4", lw=0)
    lower.set(
        xlabel="chainage (m)", xlim=(np.min(s), np.max(s)),
        ylabel="height (m)", ylim=(np.min(z), np.max(z) + 0.06 * np.ptp(z) + 1e-9),
    )  # fmt: skip
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_formatter(style.thousands_formatter())
    _draw_control_lines(upper, lower, control_lines)

    log = quantity == "energy"
    # A log axis cannot show a block that stands still; a gap there is what is known.
    curves = {q: np.where(v > 0.0, v, np.nan) if log else v for q, v in sorted(quantiles.items())}
    known = np.concatenate([v[np.isfinite(v)] for v in curves.values()] or [np.empty(0)])
    if not known.size:
        style.nothing_to_show(upper, "no block passes", keep_x=True)
        return figure
    if log:
        high = np.log10(known.max())
        # Blocks about to stop draw a long tail to nothing: five decades show all that matters.
        low = max(np.log10(known.min()), high - 5.0)
        ends = 10.0 ** (low - 0.08), 10.0 ** (high + 0.12 * (high - low) + 0.1)
        upper.set(yscale="log", ylim=ends)
        style.log_ticks(upper.yaxis, high - low)
    else:
        upper.set_ylim(min(0.0, float(known.min())), 1.1 * max(float(known.max()), 1e-9))
    for i, (share, values) in enumerate(curves.items()):
        tone = 0.35 + 0.65 * (i + 1) / len(curves)
        shade = to_hex((1.0 - tone, 1.0 - 0.72 * tone, 1.0 - 0.5 * tone))
        width = 0.9 + 0.35 * i
        name = phrase("median") if share == 0.5 else f"{100.0 * share:.4g} %"
        look = {"color": shade, "lw": width, "label": name, "gid": f"q{share:g}"}
        upper.stairs(values, s_bins, baseline=None, **look)
    upper.legend(reverse=True, loc="best", handlelength=1.4)
    return figure


def _draw_control_lines(
    upper: Axes, lower: Axes, control_lines: Sequence[tuple[ControlLine, float]]
) -> None:
    x0, x1 = lower.get_xlim()
    # The panels are about 5.6 inches wide.
    room = np.array([style.text_width_pt(line.name) for line, _ in control_lines])
    placed = style.spread([at for _, at in control_lines], room * (x1 - x0) / (72.0 * 5.6))
    for (line, at), label in zip(control_lines, placed, strict=True):
        colour = style.BLUE if line.kind == "station" else style.VERMILION
        for ax in (upper, lower):
            ax.axvline(at, color=colour, lw=0.8, ls=(0, (4, 2)), zorder=1)
        upper.annotate(
            line.name, (at, 1.0), xycoords=("data", "axes fraction"), xytext=(label, 1.015),
            textcoords=("data", "axes fraction"), ha="center", va="bottom", size=style.SMALL,
            weight="bold", color=colour,
        )  # fmt: skip


#: Ticks at round numbers.
_STEPS = [1, 2, 5, 10]
_REASONS = {
    StopReason.REST: ("at rest", style.BLUE),
    StopReason.BARRIER: ("stopped by a barrier", style.VERMILION),
    StopReason.LEFT_PROFILE: ("left the profile", style.ORANGE),
    StopReason.STEP_LIMIT: ("aborted", style.PURPLE),
    StopReason.NEVER_STARTED: ("never started", "#8c8c8c"),
    StopReason.BROKEN: ("broke into fragments", "#3d3d3d"),
}


def _panel(ax: Axes, name: str, histogram: Histogram, log: bool) -> None:
    ax.set_xlabel(phrase("{} ({})", phrase(name), histogram.unit))
    edges, counts = histogram.edges, histogram.counts
    used = np.nonzero(counts)[0]
    if not used.size:
        style.nothing_to_show(ax, "no block here")
        return
    ax.stairs(counts, edges, fill=True, color=style.BLUE, alpha=0.18, lw=0)
    ax.stairs(counts, edges, color=style.BLUE, lw=1.3, gid="computed")
    # Bins reach further than most runs; show up to the last that holds a block.
    first, last = float(edges[used[0]]), float(edges[used[-1] + 1])
    if log:
        ax.set(xscale="log", xlim=(first / 1.1, 1.1 * last))
        style.log_ticks(ax.xaxis, np.log10(last / first))
    else:
        first = min(first, max(float(edges[0]), 0.0))
        ax.set_xlim(first, last + 0.04 * (last - first))
        ax.xaxis.set_major_locator(MaxNLocator(6, steps=_STEPS))
    ax.set_ylim(0.0, 1.12 * float(counts.max()))
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=True, steps=_STEPS))
    ax.yaxis.set_major_formatter(style.thousands_formatter())
    # No bin's share can be read as more than it is: the last one is open.
    if counts[-1] > 0:
        at = ((edges[-2] + edges[-1]) / 2.0, float(counts[-1]))
        look = {"ha": "center", "va": "bottom", "color": style.BLUE, "gid": "open-bin"}
        style.beside(ax, f"≥ {edges[-2]:.3g}", at, (0, 2), **look)


@style.house_style()
def station_figure(name: str, *histograms: Histogram, n: int, pieces: bool = False) -> Figure:
    """Draw speed, rotation, height and energy of the blocks that arrive at a station or barrier.

    They are of n released blocks; with ``pieces`` also fragments and entrained blocks.
    """
    arrived = thousands(int(np.sum(histograms[0].counts)))
    words = phrase("{} of {} simulated blocks arrive", arrived, thousands(n))
    if pieces:
        words = phrase("{} blocks, fragments and entrained blocks arrive", arrived)
    figure = style.Sheet(name, words, 4.1).figure
    axes = figure.subplots(2, 2)
    quantities = ("speed", "rotation", "passing height", "kinetic energy")
    for ax, quantity, histogram in zip(axes.flat, quantities, histograms, strict=True):
        _panel(ax, quantity, histogram, log=quantity == "kinetic energy")
    for ax in axes[:, 0]:
        ax.set_ylabel("number of blocks")
    return figure


@style.house_style()
def runout_figure(
    edges: FloatArray, counts: Mapping[StopReason, IntArray], *, title: str = ""
) -> Figure:
    """Draw where blocks end by StopReason, and the share that gets at least so far.

    ``edges`` are evenly spaced chainages (m); their bins are drawn as about 30 wider ones.
    """
    total = np.sum(list(counts.values()), axis=0, dtype=float)
    kinds = {reason: int(np.sum(n)) for reason, n in counts.items() if np.any(n)}
    # As in the run-out in words; where none started, all are drawn.
    started = total - counts.get(StopReason.NEVER_STARTED, 0)
    started = started if started.any() else total
    open_end = sum(kinds.get(reason, 0) for reason in STILL_MOVING)
    note = ""
    if open_end:
        one = (
            "{} block of {} was still moving at the end of the computation; the true shares lie "
            "on or above the line"
        )
        more = (
            "{} blocks of {} were still moving at the end of the computation; the true shares lie "
            "on or above the line"
        )
        note = counted(open_end, one, more, thousands(open_end), thousands(started.sum()))
    sheet = style.Sheet(title, note, 3.6)
    upper, lower = sheet.figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.15))
    # At the lower edge of a bin all blocks of the bin and of those beyond are still moving;
    # between the edges a straight line claims least.
    beyond = 100.0 * (1.0 - np.append(0.0, np.cumsum(started)) / started.sum())
    upper.plot(edges, beyond, color=style.INK, lw=1.4, gid="exceedance")
    upper.set(ylabel="started blocks that\nget at least so far", ylim=(0.0, 104.0))
    upper.yaxis.set_major_formatter(style.percent_formatter())
    used = np.flatnonzero(total)
    width, first, last = edges[1] - edges[0], used[0], used[-1] + 1
    step = max(1, round(style.round_step(width * (last - first), 30) / width))
    starts = np.arange(first - first % step, last, step)
    drawn = edges[0] + width * np.append(starts, starts[-1] + step)
    base = np.zeros(starts.size)
    for reason, number in kinds.items():
        name, colour = _REASONS[reason]
        above = base + np.add.reduceat(counts[reason], starts)
        lower.stairs(
            above, drawn, baseline=base, fill=True, color=colour, alpha=0.9, lw=0.0,
            label=phrase("{}: {}", phrase(name), thousands(number)), gid=f"reason-{reason.name}",
        )  # fmt: skip
        base = above
    span = 0.02 * (drawn[-1] - drawn[0])
    lower.set(
        xlabel="run-out chainage (m)", xlim=(drawn[0] - span, drawn[-1] + span),
        ylabel="blocks that stop here", ylim=(0.0, 1.08 * float(base.max())),
    )  # fmt: skip
    lower.yaxis.set_major_locator(MaxNLocator(5, integer=True, steps=_STEPS))
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_formatter(style.thousands_formatter())
    sheet.legend(lower.get_legend_handles_labels()[0])
    return sheet.figure
