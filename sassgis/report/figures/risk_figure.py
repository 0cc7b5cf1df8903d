"""Risk of the exposed objects, the largest first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from sassgis.model.grid import FloatArray
from sassgis.report.figures.style import (
    BLUE,
    INK,
    SMALL,
    TITLE,
    WIDTH_IN,
    Page,
    count,
    lines_in,
    styled,
    text_width_pt,
    wrap,
)
from sassgis.report.number_text import power_of_ten, thousands

#: Width of a 95 % interval in standard errors of a normal distribution.
_NORMAL_95 = 1.96
_ROW_IN = 0.23
_NAME_IN = 1.9


def amount(value: float) -> str:
    """Write a risk with three digits: '12 300', '4.56', '1.20 × 10⁻⁵'."""
    if value == 0.0:
        return "0"
    if abs(value) >= 1000.0:
        digits = int(np.floor(np.log10(abs(value)))) - 2
        return thousands(round(value, -digits))
    if abs(value) >= 1e-3:
        return f"{value:.3g}"
    number, exponent = f"{value:.2e}".split("e")
    return f"{number}\u2009×\u2009{power_of_ten(int(exponent))}"


@styled
def risk_figure(
    names: Sequence[str],
    values: FloatArray,
    standard_errors: FloatArray,
    *,
    quantity: str,
    unit: str,
    top: int = 15,
) -> Figure:
    """Draw the objects at largest risk, one at least, as bars with the error of the sample.

    Parameters
    ----------
    names : sequence of str
        Of the objects.
    values, standard_errors : float, shape (n,)
        Risk of each, and the standard error of its sampling; NaN where it is not known.
    quantity, unit : str
        As "deaths" and "1/year".
    top : int
        Objects that are drawn; the others are summed in the note.
    """
    order = np.argsort(-np.nan_to_num(values), kind="stable")
    order = order[values[order] > 0.0]
    chosen, rest = order[:top], order[top:]
    risk, errors = values[chosen], standard_errors[chosen]
    total = amount(float(np.nansum(values)))
    notes = [f"Sum of all {count(values.size, 'object')}: {total} {unit}."]
    if rest.size:
        notes.append(
            f"Not drawn: {count(rest.size, 'object')} of less risk, together "
            f"{amount(float(values[rest].sum()))} {unit}."
        )
    if np.isfinite(errors).any():
        notes.append(
            "Thin lines: 95 % intervals (1.96 standard errors) of the sample of blocks alone."
        )
    heading = wrap(f"{quantity[:1].upper()}{quantity[1:]} by object", WIDTH_IN - 0.4, TITLE)
    below = wrap(" ".join(notes), WIDTH_IN - 0.4)
    labels = [wrap(names[i], _NAME_IN) for i in chosen]
    widths = [text_width_pt(line) for label in labels for line in label.splitlines()]
    left = min(max([*widths, 40.0]) / 72.0, _NAME_IN) + 0.2
    heights = [max(_ROW_IN, 0.13 * lines_in(label) + 0.08) for label in labels]
    plot_h = max(sum(heights), 0.8)
    foot = 0.48 + 0.135 * lines_in(below) + 0.08
    page = Page(0.12 + 0.18 * lines_in(heading) + 0.06 + plot_h + foot)
    ax = page.axes(left, foot, WIDTH_IN - left - 0.2, plot_h, "risk")
    # In steps of three, so that the numbers along the axis are short.
    exponent = min(0, 3 * int(np.floor(np.log10(risk.max()) / 3.0)))
    power = f"{power_of_ten(exponent)} " if exponent else ""
    ax.set_xlabel(f"{quantity} ({power}{unit})")
    ax.xaxis.set_major_formatter(
        FuncFormatter(lambda x, _: thousands(x) if x >= 1e4 else f"{x / 10.0**exponent:g}")
    )
    edges = np.cumsum([0.0, *heights])
    middle = plot_h - (edges[:-1] + edges[1:]) / 2.0
    ax.barh(middle, risk, height=0.62 * _ROW_IN, color=BLUE, alpha=0.75, zorder=2, gid="bars")
    half = _NORMAL_95 * errors
    known = np.isfinite(half)
    low, high = np.maximum(risk - half, 0.0)[known], (risk + half)[known]
    ax.hlines(middle[known], low, high, color=INK, lw=0.9, zorder=3, gid="intervals")
    ends = risk + np.nan_to_num(half)
    for y, value, end in zip(middle, risk, ends, strict=True):
        ax.annotate(
            amount(float(value)), (float(end), y), xytext=(4, 0), textcoords="offset points",
            size=SMALL, va="center", ha="left", color=INK, gid="value",
        )  # fmt: skip
    ax.set_xlim(0.0, 1.2 * float(ends.max()))
    ax.set_ylim(0.0, plot_h)
    ax.set_yticks(middle, labels)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(True)
    page.title(0.2, heading)
    page.note(0.2, foot - 0.44, below)
    return page.figure
