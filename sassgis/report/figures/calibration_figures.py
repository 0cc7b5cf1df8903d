"""Figures of a calibration: parameters with their intervals, observed and simulated rocks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sassgis.gap.fit.identifiability import Fitted
from sassgis.grid import FloatArray
from sassgis.report.figures import style

#: Colours and dashes of the models, in the order in which they are drawn.
_MODELS = {
    "before": (style.ORANGE, (0, (1.5, 1.2))),
    "left out": (style.VERMILION, "--"),
    "after": (style.BLUE, "-"),
}


@style.house_style()
def parameters_figure(fitted: Sequence[Fitted]) -> Figure:
    """Return each parameter on its range: configured, calibrated, 95 % interval."""
    figure = style.new_figure(style.WIDTH_IN, 0.55 + 0.24 * len(fitted))
    ax = figure.subplots()
    for k, f in enumerate(fitted):
        own, ends = f.parameter.limits, np.array([f.low, f.high])
        if own.scale == "log":
            ends = np.log(ends / own.low) / math.log(own.high / own.low)
        else:
            ends = (ends - own.low) / (own.high - own.low)
        colour = style.BLUE if f.identified else style.GREY
        ax.plot([0.0, 1.0], [k, k], color=style.LIGHT, lw=1.0, zorder=1)
        ax.plot(ends, [k, k], color=colour, lw=3.5, solid_capstyle="butt", zorder=2)
        ax.plot(f.share, k, "o", color=colour, ms=5, zorder=4)
        ax.plot(f.parameter.start, k, "|", color=style.INK, ms=10, mew=1.4, zorder=3)
        for at, value, side in ((-0.01, own.low, "right"), (1.01, own.high, "left")):
            ax.text(at, k, f"{value:g}", ha=side, va="center", size=style.SMALL, color=style.GREY)
    ax.set_yticks(range(len(fitted)), [f.parameter.label for f in fitted])
    ax.invert_yaxis()
    ax.set(xlim=(-0.06, 1.06), xticks=[])
    ax.grid(False)
    ax.spines[["left", "bottom"]].set_visible(False)
    ax.tick_params(length=0)
    return figure


@style.house_style()
def quantity_curves_figure(
    panels: Sequence[tuple[str, FloatArray, Mapping[str, FloatArray]]],
) -> Figure:
    """Draw shares of rocks below a value; a panel is label, observed, simulated by model."""
    columns = min(len(panels), 2) or 1
    rows = max(math.ceil(len(panels) / columns), 1)
    figure = style.new_figure(style.WIDTH_IN, 2.4 * rows)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (label, seen, made) in zip(axes, panels, strict=False):
        _curves(ax, label, seen, made)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    if len(panels):
        axes[0].legend(loc="lower right")
    return figure


def _curves(ax: Axes, label: str, seen: FloatArray, made: Mapping[str, FloatArray]) -> None:
    ax.set_xlabel(style.wrap(label, 0.42 * style.WIDTH_IN, style.TEXT))
    known = np.sort(seen[np.isfinite(seen)])
    if not known.size:
        style.nothing_to_show(ax)
        return
    for name, (colour, dash) in _MODELS.items():
        values = np.sort(made[name][np.isfinite(made[name])])
        share = (np.arange(values.size) + 0.5) / max(values.size, 1)
        ax.plot(values, 100.0 * share, color=colour, ls=dash, lw=1.3, label=name)
    share = np.arange(1, known.size + 1) / known.size
    ax.step(known, 100.0 * share, where="post", color=style.INK, lw=1.4, label="observed")
    everything = np.concatenate([known, *(v[np.isfinite(v)] for v in made.values())])
    low, high = np.quantile(everything, [0.002, 0.998])
    low, high = min(low, known[0]), max(high, known[-1])
    # Of numbers of blocks all may be alike: the axis is then as it comes.
    if low < high:
        ax.set_xlim(low, high)
    ax.set_ylim(0.0, 100.0)
    ax.yaxis.set_major_formatter(style.percent_formatter())
