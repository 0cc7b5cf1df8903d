"""Figures of a diagnosis: where simulated and observed rocks part, why, and what is left."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import PercentFormatter
from scipy.stats import binom

from sassgis.gap.diagnosis import Comparison, GapFinding, Hypothesis, Rung
from sassgis.gap.inference.distances import energy_distance, observed_scale
from sassgis.gap.words import (
    RUNG_NAMES,
    effect_name,
    place_words,
    quantity_name,
    significance,
    tested_by,
    with_unit_in_brackets,
)
from sassgis.model.grid import FloatArray
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    LIGHT,
    SKY,
    SMALL,
    TEXT,
    TITLE,
    VERMILION,
    WIDTH_IN,
    lines_in,
    new_figure,
    nothing_to_show,
    percent_formatter,
    styled,
    wrap,
)

#: Rows of one quantity beyond this number are left out, the least certain first.
MAX_ROWS = 14
#: Panels of one figure beyond this number are left out.
MAX_PANELS = 12
#: Up to this many observed values each is marked on the curve.
_MARKED = 60

#: Less observed than predicted is blue, more vermilion, in all figures and layers of a diagnosis.
GAP_COLOURS = LinearSegmentedColormap.from_list(
    "gap", [BLUE, "#9ecae1", "#f2f2f2", "#f5b38c", VERMILION]
)
_ROW_IN = 0.2
_HALO = [withStroke(linewidth=2.0, foreground="white")]


def _heading(figure: Figure, title: str, note: str, room: float = WIDTH_IN) -> None:
    """Write the title above and the note below, the note within a width (in)."""
    width, height = figure.get_size_inches()
    figure.text(
        0.1 / width, 1.0 - 0.08 / height, wrap(title, width, TITLE), size=TITLE, weight="bold",
        va="top", gid="title",
    )  # fmt: skip
    figure.text(
        0.1 / width, 0.07 / height, wrap(note, room - 0.2), size=SMALL, color=GREY, va="bottom",
        gid="note",
    )  # fmt: skip


def _note_height(note: str, width: float = WIDTH_IN) -> float:
    return 0.14 * lines_in(wrap(note, width - 0.2)) + 0.12 if note else 0.1


# --- where -----------------------------------------------------------------------------------


def _by_quantity(findings: Sequence[GapFinding]) -> dict[tuple[str, str], list[GapFinding]]:
    groups: dict[tuple[str, str], list[GapFinding]] = {}
    for finding in findings:
        groups.setdefault((finding.quantity, finding.unit), []).append(finding)
    return groups


def _order(finding: GapFinding) -> tuple[float, str, str]:
    middle = 0.5 * (finding.s0_m + finding.s1_m)
    return (middle if math.isfinite(middle) else math.inf, finding.place, finding.phase)


def _row_label(finding: GapFinding, rows: Sequence[GapFinding]) -> str:
    place = finding.place.removeprefix("ground:").replace("_", " ")
    same = [f for f in rows if (f.place, f.phase) == (finding.place, finding.phase)]
    phase = tested_by(finding.test) if len(same) > 1 else finding.phase
    return f"{place} · {phase}" if phase else place


@styled
def gap_where_figure(
    findings: Sequence[GapFinding], *, title: str = "Observed less predicted, by place and phase"
) -> Figure:
    """Draw every gap as a dot with its interval, a panel for each quantity in its own unit.

    Parameters
    ----------
    findings : sequence of GapFinding
        The most certain first. Quantities beyond ``MAX_PANELS`` and rows of one beyond ``MAX_ROWS``
        are left out, and the figure says so.
    title : str
    """
    groups = {
        key: sorted(sorted(rows, key=lambda f: (f.p_adjusted, f.q_value))[:MAX_ROWS], key=_order)
        for key, rows in list(_by_quantity(findings).items())[:MAX_PANELS]
    }
    shown = sum(len(rows) for rows in groups.values())
    note = (
        "Dots: mean over rocks; bars: 95 % intervals, rocks resampled. Filled: significant among "
        "all comparisons (5 %); coloured ring: among those that the map shows (share of false ones "
        "5 %); grey: not distinguished from chance. Right: number of rocks."
    )
    if shown < len(findings):
        note += f" {shown} of {len(findings)} are shown, the most certain."
    columns = 1 if len(groups) < 2 else 2
    width = WIDTH_IN / columns
    titles = {
        key: wrap(with_unit_in_brackets(quantity_name(key[0]), key[1]), width - 0.3, TEXT + 1.0)
        for key in groups
    }
    heads, gaps = {key: 0.06 + 0.15 * lines_in(text) for key, text in titles.items()}, 0.36
    heights = {key: heads[key] + _ROW_IN * len(rows) + gaps for key, rows in groups.items()}
    filled = [0.0] * columns
    places: list[tuple[tuple[str, str], int, float]] = []
    for key in groups:
        column = int(np.argmin(filled))
        places.append((key, column, filled[column]))
        filled[column] += heights[key]
    top, bottom = 0.36, _note_height(note) + 0.05
    height = top + max(max(filled), 1.0) + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, note)
    if not groups:
        nothing_to_show(
            figure.add_axes((0.05, bottom / height, 0.9, 1.0 / height)), "nothing was compared"
        )
        return figure
    longest = max(len(_row_label(f, rows)) for rows in groups.values() for f in rows)
    label_w = min(0.45 * width, 0.066 * longest + 0.2)
    for key, column, used in places:
        rows = groups[key]
        y = height - top - used - heads[key] - _ROW_IN * len(rows)
        figure.text(
            (column * width + 0.1) / WIDTH_IN, (height - top - used) / height, titles[key],
            size=TEXT, weight="bold", va="top",
        )  # fmt: skip
        ax = figure.add_axes(
            (
                (column * width + label_w) / WIDTH_IN,
                y / height,
                (width - label_w - 0.38) / WIDTH_IN,
                _ROW_IN * len(rows) / height,
            ),
            label=key[0],
        )
        _draw_gaps(ax, rows)
    return figure


def _draw_gaps(ax: Axes, rows: Sequence[GapFinding]) -> None:
    ax.axvline(0.0, color=GREY, lw=0.8, zorder=1)
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(False)
    for i, finding in enumerate(rows):
        sure = significance(finding)
        colour = GREY if sure == "open" else VERMILION if finding.gap > 0.0 else BLUE
        low, high = finding.ci95
        if math.isfinite(low) and math.isfinite(high):
            ax.plot([low, high], [i, i], color=colour, lw=1.5, alpha=0.8, gid="interval")
        ax.plot(
            [finding.gap], [i], "o", ms=4.5, mec=colour, mew=1.1,
            mfc=colour if sure == "sure" else "white", zorder=5, gid=f"gap-{sure}",
        )  # fmt: skip
        ax.annotate(
            str(finding.rocks), (1.0, i), xycoords=("axes fraction", "data"), xytext=(6, 0),
            textcoords="offset points", size=SMALL, color=GREY, va="center", annotation_clip=False,
        )  # fmt: skip
    ax.set_yticks(range(len(rows)), [_row_label(f, rows) for f in rows])
    for label, finding in zip(ax.get_yticklabels(), rows, strict=True):
        label.set_fontweight("bold" if significance(finding) == "sure" else "normal")
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.margins(x=0.08)
    ax.locator_params(axis="x", nbins=4)


# --- before and after ------------------------------------------------------------------------


def _known(values: Sequence[float]) -> FloatArray:
    array = np.asarray(values, float)
    return np.asarray(array[np.isfinite(array)])


def _steps(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    x = np.sort(values)
    return np.concatenate([[x[0]], x]), np.arange(x.size + 1) / x.size


def _band(values: FloatArray, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Between which shares the curve of ``n`` rocks of a model lies in 95 of 100 samples."""
    x, share = _steps(values)
    return x, binom.ppf(0.025, n, share) / n, binom.ppf(0.975, n, share) / n


def _distance(observed: FloatArray, model: FloatArray) -> float:
    seen = observed[:, None]
    return energy_distance(seen, model[:, None], scale=observed_scale(seen))


@styled
def gap_distributions_figure(
    comparisons: Sequence[Comparison],
    *,
    effect: str = "",
    title: str = "Observed and simulated, before and after",
) -> Figure:
    """Draw the distributions of observed rocks and of the models, each as it is: in steps.

    The band is that of the calibrated base model for as many rocks as were observed: a curve within
    it does not differ from that model.

    Parameters
    ----------
    comparisons : sequence of Comparison
        More than ``MAX_PANELS`` are not drawn, and the figure says so.
    effect : str
        Of the effect model; empty if none is named.
    title : str
    """
    chosen = list(comparisons)[:MAX_PANELS]
    after = bool(effect) and any(c.effect for c in chosen)
    note = (
        "Black: observed, a step for each value. Blue: calibrated base model; pale band: where 95 "
        "of 100 samples of as many values lie. "
        + (f"Vermilion: with {effect_name(effect)}. " if after else "")
        + "D: energy distance to the observed values, in their standard deviations"
        + (", base → with the effect" if after else "")
        + ", of the values that are drawn."
    )
    if len(chosen) < len(comparisons):
        note += f" {len(chosen)} of {len(comparisons)} comparisons are drawn."
    columns = min(max(len(chosen), 1), 3 if len(chosen) > 4 else 2)
    rows = max(1, -(-len(chosen) // columns))
    panel_h, gap_h, top, bottom = 1.45, 0.55, 0.62, _note_height(note) + 0.36
    height = top + rows * panel_h + (rows - 1) * gap_h + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, note)
    left, right, between = 0.66, 0.12, 0.24
    width = (WIDTH_IN - left - right - (columns - 1) * between) / columns
    if not chosen:
        ax = figure.add_axes((0.05, bottom / height, 0.9, panel_h / height))
        nothing_to_show(ax, "nothing to compare")
    for i, comparison in enumerate(chosen):
        row, column = divmod(i, columns)
        ax = figure.add_axes(
            (
                (left + column * (width + between)) / WIDTH_IN,
                (height - top - (row + 1) * panel_h - row * gap_h) / height,
                width / WIDTH_IN,
                panel_h / height,
            )
        )
        _draw_comparison(ax, comparison, width, after)
        if column:
            ax.tick_params(labelleft=False)
        else:
            ax.set_ylabel("share below")
    return figure


def _draw_comparison(ax: Axes, comparison: Comparison, width_in: float, after: bool) -> None:
    seen, base = _known(comparison.observed), _known(comparison.base)
    with_effect = _known(comparison.effect) if after else np.empty(0)
    words = f"{quantity_name(comparison.quantity)} {place_words(comparison.place)}"
    words = with_unit_in_brackets(words, comparison.unit)
    ax.set_title(wrap(words, width_in, SMALL + 0.5), size=SMALL + 0.5, pad=3)
    ax.set_ylim(-0.02, 1.04)
    ax.yaxis.set_major_formatter(_share_formatter())
    ax.locator_params(axis="x", nbins=5)
    if not seen.size:
        nothing_to_show(ax, "not observed", keep_x=True)
        return
    for values, colour, gid in ((base, BLUE, "base"), (with_effect, VERMILION, "effect")):
        if not values.size:
            continue
        if gid == "base":
            x, low, high = _band(values, seen.size)
            ax.fill_between(x, low, high, step="post", color=SKY, alpha=0.25, lw=0, gid="band")
        x, y = _steps(values)
        ax.step(x, y, where="post", color=colour, lw=1.3, gid=gid)
    x, y = _steps(seen)
    ax.step(x, y, where="post", color=INK, lw=1.1, gid="observed")
    if seen.size <= _MARKED:
        ax.plot(np.sort(seen), y[1:], "o", ms=2.2, color=INK, gid="observed-values")
    distances = [f"{_distance(seen, v):.2g}" for v in (base, with_effect) if v.size]
    compared = "D " + " → ".join(distances) + "\n" if distances else ""
    ax.text(
        0.97, 0.06, f"{compared}n = {seen.size}",
        transform=ax.transAxes, ha="right", va="bottom", size=SMALL, gid="distance",
        path_effects=_HALO, zorder=9,
    )  # fmt: skip


def _share_formatter() -> PercentFormatter:
    """Tick labels of shares from 0 to 1 in per cent."""
    formatter = percent_formatter()
    formatter.xmax = 1.0
    return formatter


# --- which -----------------------------------------------------------------------------------


@styled
def gap_ladder_figure(ladder: Sequence[Rung], *, title: str = "How far the gap shrinks") -> Figure:
    """Draw the distance of each model to the observed rocks, and the share of the gap it closes.

    Parameters
    ----------
    ladder : sequence of Rung
        The configured model first, what chance leaves last.
    title : str
    """
    note = (
        "Energy distance to the observed rocks, each compared with a model fitted without it; in "
        "brackets the 95 % interval of the share of the gap (rocks resampled)."
    )
    n = max(len(ladder), 1)
    top, bottom = 0.62, _note_height(note) + 0.5
    height = top + 0.32 * n + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, note)
    ax = figure.add_axes(
        (1.95 / WIDTH_IN, bottom / height, 3.0 / WIDTH_IN, 0.32 * n / height), label="ladder"
    )
    if not ladder:
        nothing_to_show(ax)
        return figure
    for i, rung in enumerate(ladder):
        ends = rung.rung in ("configured", "floor")
        ax.barh(i, rung.distance, 0.6, color=LIGHT if ends else BLUE, gid=f"rung-{rung.rung}")
        if rung.share is not None:
            span = (
                ""
                if rung.ci95 is None
                else f" ({100 * rung.ci95[0]:.0f} to {100 * rung.ci95[1]:.0f})"
            )
            text = f" closes {100 * rung.share:.0f} %{span}".replace("-", "\u2212")
            ax.text(max(rung.distance, 0.0), i, text, va="center", size=SMALL)
    ax.grid(visible=False)
    ax.axvline(0.0, color=GREY, lw=0.8, zorder=1)
    ax.set_yticks(
        range(len(ladder)),
        [RUNG_NAMES.get(r.rung) or effect_name(r.rung) for r in ladder],
        size=TEXT,
    )
    ax.set_ylim(n - 0.4, -0.6)
    ax.set_xlim(min(0.0, *(r.distance for r in ladder)), 1.45 * max(r.distance for r in ladder))
    ax.set_xlabel("energy distance", size=SMALL)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.tick_params(axis="y", length=0)
    return figure


def gap_hypotheses_figure(
    hypotheses: Sequence[Hypothesis],
    *,
    verdict: str,
    confusion: Sequence[str] = (),
    title: str = "Explanations that were tried",
) -> Figure:
    """Draw what each explanation gains, and how probable it is; those confused are marked.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        The most probable first.
    verdict : str
        The effect that the diagnosis names.
    confusion : sequence of str
        Effects that the data do not separate.
    title : str
    """
    n = max(len(hypotheses), 1)
    others = [e for e in confusion if e != verdict]
    note = (
        "Left: by how much the energy score of held-out rocks falls below that of the calibrated "
        "base model, with 95 % interval (rocks resampled); above zero is better. Right: "
        "probability of being the cause. Vermilion: the answer"
        + ("; blue: not separated from it by these data." if others else ".")
    )
    top, bottom = 0.62, _note_height(note) + 0.42
    height = top + 0.29 * n + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, note)
    labels, middle, right = 1.95, 2.55, 1.75

    def place(x: float, w: float, label: str) -> Axes:
        return figure.add_axes(
            (x / WIDTH_IN, bottom / height, w / WIDTH_IN, 0.29 * n / height), label=label
        )

    gains, shares = place(labels, middle, "gain"), place(labels + middle + 0.15, right, "share")
    if not hypotheses:
        nothing_to_show(gains)
        nothing_to_show(shares)
        return figure
    gains.axvline(0.0, color=GREY, lw=0.8, zorder=1)
    for i, hypothesis in enumerate(hypotheses):
        named = hypothesis.effect == verdict
        colour = VERMILION if named else BLUE if hypothesis.effect in others else GREY
        low, high = hypothesis.ci95
        if math.isfinite(low) and math.isfinite(high) and low < high:
            gains.plot([low, high], [i, i], color=colour, lw=1.5, alpha=0.8, gid="interval")
        if math.isfinite(hypothesis.gain):
            gains.plot([hypothesis.gain], [i], "o", ms=4.5, color=colour, zorder=5, gid="gain")
        share = hypothesis.probability if math.isfinite(hypothesis.probability) else 0.0
        shares.barh(
            i,
            share,
            0.6,
            color=LIGHT if colour == GREY else colour,
            gid=f"share-{hypothesis.effect}",
        )
        shares.text(
            share + 0.02, i, f"{100 * share:.0f} %" if share >= 0.005 else "< 1 %", va="center",
            size=SMALL,
        )  # fmt: skip
        gains.annotate(
            effect_name(hypothesis.effect), (0.0, i), xycoords=("axes fraction", "data"),
            xytext=(-6, 3.5 if hypothesis.form else 0.0), textcoords="offset points", ha="right",
            va="center", size=TEXT, weight="bold" if named else "normal", annotation_clip=False,
        )  # fmt: skip
        if hypothesis.form:
            gains.annotate(
                hypothesis.form, (0.0, i), xycoords=("axes fraction", "data"), xytext=(-6, -5.0),
                textcoords="offset points", ha="right", va="center", size=SMALL - 1.0, color=GREY,
                annotation_clip=False,
            )  # fmt: skip
    for ax in (gains, shares):
        ax.set_ylim(n - 0.45, -0.55)
        ax.set_yticks([])
        ax.grid(axis="y", visible=False)
        ax.spines["left"].set_visible(False)
    gains.set_title("gain in score", size=TEXT)
    shares.set_title("probability", size=TEXT)
    shares.set_xlim(0.0, 1.18)
    shares.set_xticks([0.0, 0.5, 1.0])
    shares.xaxis.set_major_formatter(_share_formatter())
    gains.margins(x=0.08)
    gains.locator_params(axis="x", nbins=5)
    return figure
