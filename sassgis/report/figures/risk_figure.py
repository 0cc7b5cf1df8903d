"""Risk of the exposed objects, the largest first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    SMALL,
    TITLE,
    WIDTH_IN,
    count,
    lines_in,
    new_figure,
    nothing_to_show,
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


def _axis_power(values: FloatArray) -> int:
    """Power of ten, in steps of three, that keeps the numbers along the axis short."""
    if not values.size:
        return 0
    power = 3 * int(np.floor(np.log10(values.max()) / 3.0))
    return power if power < 0 else 0


@styled
def risk_figure(
    names: Sequence[str],
    values: FloatArray,
    standard_errors: FloatArray,
    *,
    quantity: str,
    unit: str,
    top: int = 15,
    title: str = "",
    note: str = "",
) -> Figure:
    """Draw the objects at largest risk as bars with the error of the sample.

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
    title, note : str
        The default title is the quantity.

    Raises
    ------
    InputError
        The arrays do not belong together.
    """
    risk, errors = np.asarray(values, float), np.asarray(standard_errors, float)
    if not len(names) == risk.size == errors.size:
        raise InputError(
            "names, risks and errors of the objects do not belong together",
            found=f"{len(names)}, {risk.size} and {errors.size}",
            expected="one of each per object",
        )
    order = np.argsort(-np.nan_to_num(risk), kind="stable")
    order = order[risk[order] > 0.0]
    chosen, rest = order[:top], order[top:]
    notes = [f"Sum of all {count(risk.size, 'object')}: {amount(float(np.nansum(risk)))} {unit}."]
    if rest.size:
        notes.append(
            f"Not drawn: {count(rest.size, 'object')} of less risk, together "
            f"{amount(float(risk[rest].sum()))} {unit}."
        )
    if chosen.size and np.isfinite(errors[chosen]).any():
        notes.append(
            "Thin lines: 95 % intervals (1.96 standard errors) of the sample of blocks alone."
        )
    notes.append(note)
    heading = wrap(
        title or f"{quantity[:1].upper()}{quantity[1:]} by object", WIDTH_IN - 0.4, TITLE
    )
    below = wrap(" ".join(n for n in notes if n), WIDTH_IN - 0.4)
    labels = [wrap(names[i], _NAME_IN) for i in chosen]
    widths = [text_width_pt(line) for label in labels for line in label.splitlines()]
    left = min(max([*widths, 40.0]) / 72.0, _NAME_IN) + 0.2
    heights = [max(_ROW_IN, 0.13 * lines_in(label) + 0.08) for label in labels]
    plot_h = max(sum(heights), 0.8)
    head = 0.12 + 0.18 * lines_in(heading) + 0.06
    foot = 0.48 + 0.135 * lines_in(below) + 0.08
    height = head + plot_h + foot
    figure = new_figure(WIDTH_IN, height, constrained=False)
    ax = figure.add_axes(
        (left / WIDTH_IN, foot / height, (WIDTH_IN - left - 0.2) / WIDTH_IN, plot_h / height)
    )
    ax.set_label("risk")
    exponent = _axis_power(risk[chosen])
    power = f"{power_of_ten(exponent)} " if exponent else ""
    ax.set_xlabel(f"{quantity} ({power}{unit})")
    ax.xaxis.set_major_formatter(
        FuncFormatter(lambda x, _: thousands(x) if x >= 1e4 else f"{x / 10.0**exponent:g}")
    )
    if not chosen.size:
        nothing_to_show(ax, "no object at risk")
    else:
        _bars(ax, risk[chosen], errors[chosen], labels, np.asarray(heights), plot_h)
    figure.text(
        0.2 / WIDTH_IN, 1.0 - 0.1 / height, heading, size=TITLE, weight="bold", va="top",
        gid="title",
    )  # fmt: skip
    figure.text(
        0.2 / WIDTH_IN, (foot - 0.44) / height, below, size=SMALL, color=GREY, va="top", gid="note"
    )
    return figure


def _bars(
    ax: Axes,
    risk: FloatArray,
    errors: FloatArray,
    labels: Sequence[str],
    heights: FloatArray,
    plot_h: float,
) -> None:
    edges = np.cumsum(np.append(0.0, heights))
    middle = plot_h - (edges[:-1] + edges[1:]) / 2.0
    ax.barh(middle, risk, height=0.62 * _ROW_IN, color=BLUE, alpha=0.75, zorder=2, gid="bars")
    half = _NORMAL_95 * errors
    known = np.isfinite(half)
    low, high = np.maximum(risk - half, 0.0)[known], (risk + half)[known]
    ax.hlines(middle[known], low, high, color=INK, lw=0.9, zorder=3, gid="intervals")
    ends = risk + np.nan_to_num(half)
    furthest = float(ends.max())
    for y, value, end in zip(middle, risk, ends, strict=True):
        ax.annotate(
            amount(float(value)), (float(end), y), xytext=(4, 0), textcoords="offset points",
            size=SMALL, va="center", ha="left", color=INK, gid="value",
        )  # fmt: skip
    ax.set_xlim(0.0, 1.2 * furthest)
    ax.set_ylim(0.0, plot_h)
    ax.set_yticks(middle, labels)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(True)
