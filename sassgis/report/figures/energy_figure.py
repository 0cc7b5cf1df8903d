"""Energy, speed and passing height along a profile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.model.results import ControlLine
from sassgis.report.figures.style import (
    BLUE,
    INK,
    SMALL,
    TITLE,
    VERMILION,
    WIDTH_IN,
    new_figure,
    nothing_to_show,
    spread,
    styled,
    text_width_pt,
    thousands_formatter,
    wrap,
)
from sassgis.report.number_text import thousands

Quantity = Literal["energy", "speed", "height"]

_LABEL = {
    "energy": "kinetic energy (kJ)",
    "speed": "speed (m/s)",
    "height": "passing height (m)",
}
_PLAIN = {"energy": "kinetic energy", "speed": "speed", "height": "passing height"}


def _share_text(share: float) -> str:
    """Name a quantile: the median, or the share of blocks that stays below."""
    return "median" if share == 0.5 else f"{100.0 * share:.4g} %"


@styled
def energy_profile_figure(
    s_bins: FloatArray,
    quantiles: Mapping[float, FloatArray],
    s: FloatArray,
    z: FloatArray,
    *,
    quantity: Quantity = "energy",
    control_lines: Sequence[tuple[ControlLine, float]] = (),
    title: str | None = None,
) -> Figure:
    """Draw quantiles of a quantity along the profile, with the slope beneath.

    Parameters
    ----------
    s_bins : float, shape (n + 1,) or (n,)
        Edges of the chainage bins, or single chainages (m).
    quantiles : by share (0.5, 0.95, ...), float, shape (n,)
        Value that this share of the passing blocks stays below; NaN where no block passes.
    s, z : float, shape (m,)
        Chainage and height of the vertices of the slope (m).
    quantity : {"energy", "speed", "height"}
        Energy (kJ) has a logarithmic axis; speed (m/s) and passing height (m) a plain one.
    control_lines : (ControlLine, chainage)
        Marked in both panels.
    title : str, optional

    Raises
    ------
    InputError
        The arrays do not fit each other.
    """
    bins = np.asarray(s_bins, float)
    curves = {share: np.asarray(quantiles[share], float) for share in sorted(quantiles)}
    first = next(iter(curves.values())).size if curves else 0
    for share, values in curves.items():
        if (
            values.ndim != 1
            or values.size not in (bins.size, bins.size - 1)
            or values.size != first
        ):
            raise InputError(
                f"the quantile {share:g} does not fit the chainage bins",
                found=f"shape {values.shape}",
                expected=f"({bins.size - 1},) or ({bins.size},)",
            )
    figure = new_figure(WIDTH_IN, 4.3)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1.0))
    heading = title if title is not None else f"{_PLAIN[quantity].capitalize()} along the profile"
    figure.suptitle(wrap(heading, WIDTH_IN, TITLE), x=0.01, ha="left", size=TITLE, weight="bold")
    upper.set_ylabel(_LABEL[quantity])
    lower.set_ylabel("height (m)")
    lower.set_xlabel("chainage (m)")
    lower.plot(s, z, color=INK, lw=1.2, gid="slope")
    lower.fill_between(s, z, float(np.min(z)), color="#ece9e4", lw=0)
    lower.set_ylim(float(np.min(z)), float(np.max(z)) + 0.06 * float(np.ptp(z)) + 1e-9)
    lower.set_xlim(float(np.min(s)), float(np.max(s)))
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_formatter(thousands_formatter())

    log = quantity == "energy"
    # A log axis cannot show a block that stands still; a gap there is what is known.
    shown = {q: np.where(v > 0.0, v, np.nan) if log else v for q, v in curves.items()}
    known = np.concatenate([v[np.isfinite(v)] for v in shown.values()] or [np.empty(0)])
    for control_line, where in control_lines:
        colour = BLUE if control_line.kind == "station" else VERMILION
        for ax in (upper, lower):
            ax.axvline(where, color=colour, lw=0.8, ls=(0, (4, 2)), zorder=1)
    if control_lines:
        x0, x1 = lower.get_xlim()
        # The panels are about 5.6 inches wide.
        room = (
            np.array([text_width_pt(control_line.name) for control_line, _ in control_lines])
            * (x1 - x0)
            / (72.0 * 5.6)
        )
        for (control_line, where), label in zip(
            control_lines, spread([g[1] for g in control_lines], room), strict=True
        ):
            upper.annotate(
                control_line.name,
                (where, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(label, 1.015),
                textcoords=("data", "axes fraction"),
                ha="center",
                va="bottom",
                size=SMALL,
                weight="bold",
                color=BLUE if control_line.kind == "station" else VERMILION,
            )
    if not known.size:
        nothing_to_show(upper, "no block passes", keep_x=True)
        return figure

    if log:
        low, high = np.log10(known.min()), np.log10(known.max())
        # Blocks about to stop draw a long tail to nothing: five decades show all that matters.
        low = max(low, high - 5.0)
        upper.set_yscale("log")
        upper.set_ylim(10.0 ** (low - 0.08), 10.0 ** (high + 0.12 * (high - low) + 0.1))
        # Where few powers of ten are in sight, the steps between them are named too.
        steps = (1.0, 2.0, 5.0) if high - low < 2.0 else (1.0,)
        upper.yaxis.set_major_locator(LogLocator(10.0, subs=steps))
        upper.yaxis.set_major_formatter(
            FuncFormatter(lambda v, _: thousands(v) if v >= 1.0 else f"{v:g}")
        )
        upper.yaxis.set_minor_formatter(NullFormatter())
    else:
        upper.set_ylim(min(0.0, float(known.min())), 1.1 * max(float(known.max()), 1e-9))

    for i, (share, values) in enumerate(shown.items()):
        width = 0.9 + 0.35 * i
        tone = 0.35 + 0.65 * (i + 1) / len(shown)
        shade = to_hex((1.0 - tone, 1.0 - 0.72 * tone, 1.0 - 0.5 * tone))
        if values.size == bins.size - 1:
            upper.stairs(values, bins, baseline=None, color=shade, lw=width, gid=f"q{share:g}")
        else:
            upper.plot(bins, values, color=shade, lw=width, gid=f"q{share:g}")
    _name_curves(upper, bins, shown, log)
    return figure


def _name_curves(ax: Axes, bins: FloatArray, curves: Mapping[float, FloatArray], log: bool) -> None:
    """Write the quantiles on their curves, at the chainage where these lie furthest apart."""
    values = np.stack(list(curves.values()))
    middle = bins if values.shape[1] == bins.size else (bins[:-1] + bins[1:]) / 2.0
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
                _share_text(share),
                transform=ax.get_xaxis_transform(),
                ha="center",
                va="center",
                size=SMALL,
                path_effects=[withStroke(linewidth=2.2, foreground="white")],
                zorder=8,
            )
