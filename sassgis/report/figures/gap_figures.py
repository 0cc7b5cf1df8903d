"""Figures of a diagnosis: where simulated and observed rocks part, why, and what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.stats import binom, energy_distance

from sassgis.gap.diagnosis import Comparison, GapFinding, Hypothesis, Rung
from sassgis.gap.words import (
    effect_name,
    place_name,
    place_words,
    quantity_name,
    rung_name,
    significance,
    tested_by,
    with_unit_in_brackets,
)
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.languages import joined, phrase, translated
from sassgis.report.figures.map_figure import (
    MapFrame,
    MapPanel,
    colour_bar,
    draw_maps,
    furniture_within,
    one_map,
)
from sassgis.report.figures.map_marks import (
    MapMarks,
    all_points,
    draw_lines,
    draw_points,
    line_name,
)
from sassgis.report.figures.relief import footprint, taken_by, view_of
from sassgis.report.figures.style import (
    BLUE,
    GAP_COLOURS,
    GREY,
    INK,
    LIGHT,
    SKY,
    SMALL,
    TEXT,
    VERMILION,
    WIDTH_IN,
    Page,
    beside,
    halo,
    house_style,
    lines_in,
    note_height,
    nothing_to_show,
    percent_formatter,
    text_width,
    wrap,
)

#: Rows of one quantity beyond this number are left out, the least certain first.
MAX_ROWS = 14
#: Panels of one figure beyond this number are left out.
MAX_PANELS = 12
#: Up to this many observed values each is marked on the curve.
_MARKED = 60
_ROW_IN = 0.2


# --- where -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GapStretch:
    """A stretch of a fall line, or a station, with the gap there.

    The trace holds coordinates (m) of shape (n, 2), the gap is NaN where nothing was compared. A
    gap that is not sure to differ from chance is drawn thin.
    """

    trace: FloatArray
    gap: float
    sure: bool = True


@house_style()
def gap_map_figure(
    grid: Grid,
    *,
    lines: Sequence[FloatArray],
    stretches: Sequence[GapStretch],
    stations: Mapping[str, GapStretch],
    release: FloatArray,
    stops: FloatArray,
    quantity: str,
    unit: str,
) -> Figure:
    """Draw fall lines and stations over the relief, coloured by the gap of one quantity.

    Fall lines, release points and where observed blocks lie (``stops``) are of shape (n, 2) (m);
    ``stretches`` are the parts of the lines on which the quantity was compared. Quantity and unit
    are empty if no gap is to be shown.
    """
    points = all_points([*lines, *(s.trace for s in stations.values()), release, stops])
    points = points[np.isfinite(points).all(axis=1)]
    view = view_of(grid, footprint(grid, None, points))
    gaps = [s.gap for s in (*stretches, *stations.values()) if math.isfinite(s.gap)]
    largest = max((abs(g) for g in gaps), default=0.0)
    norm = Normalize(-largest or -1.0, largest or 1.0)
    keys = {
        phrase(
            "Colour: {}, observed less predicted; vermilion: more was observed, blue: less; thin: "
            "not distinguished from chance.",
            quantity_name(quantity),
        ): gaps,
        phrase("Thin dark lines: fall lines."): lines,
        phrase("Triangles: release."): len(release),
        phrase("Diamonds: where observed blocks lie."): len(stops),
    }
    text = joined(" ", (part for part, there in keys.items() if there))
    place = one_map(view.aspect, 0.95, 6.5)
    frame = MapFrame(*place, top=0.52, bottom=0.5 + note_height(text))

    def draw(ax: Axes) -> None:
        draw_lines(ax, [c for c in lines if len(c) > 1], 0.5, 0.5)
        _draw_stretches(ax, stretches, norm, 2.4, 6)
        _draw_stretches(ax, list(stations.values()), norm, 3.2, 8)
        for station in stations.values():
            if len(station.trace) > 1 and not math.isfinite(station.gap):
                ax.plot(*station.trace.T, ls="--", color=INK, lw=1.1, zorder=7)
        draw_points(ax, stops, "D", 3.2, "white", INK, 0.7, zorder=11, gid="stops")

    panel = MapPanel(None, GAP_COLOURS, norm, alpha=1.0)
    names = [line_name(n, station.trace) for n, station in stations.items() if len(station.trace)]
    marks = MapMarks(list(release[:, None]), names=names)
    maps = draw_maps(view, [panel], marks, frame, draw)
    maps.page.around("Where the gap lies", text)
    furniture_within(maps, frame, view.box, taken_by(points, view.box))
    if gaps:
        x, top = frame.left + frame.width + 0.14, frame.bottom + frame.height
        tall = min(2.4, 0.8 * frame.height)
        colour_bar(maps.page.axes(x, top - tall - 0.18, 0.14, tall, "legend"), panel)
        maps.page.text(x, top, unit, size=SMALL, va="top")
    return maps.page.figure


def _draw_stretches(
    ax: Axes, stretches: Sequence[GapStretch], norm: Normalize, width: float, zorder: float
) -> None:
    known = [s for s in stretches if math.isfinite(s.gap) and len(s.trace) > 1]
    widths = np.array([width if s.sure else 0.45 * width for s in known])
    traces = [s.trace for s in known]
    colours = GAP_COLOURS(norm([s.gap for s in known])) if known else INK
    edges = LineCollection(traces, colors=INK, linewidths=widths + 0.8, alpha=0.55, zorder=zorder)
    ax.add_collection(edges)
    ax.add_collection(
        LineCollection(traces, colors=colours, linewidths=widths, zorder=zorder + 1, gid="gaps")
    )


def _row_label(finding: GapFinding, rows: Sequence[GapFinding]) -> str:
    """In the language of the figure: labels of an axis are set anew when it is drawn."""
    place = place_name(finding.place.replace("_", " "))
    same = [f for f in rows if (f.place, f.phase) == (finding.place, finding.phase)]
    phase = tested_by(finding.test) if len(same) > 1 else phrase(finding.phase)
    return translated(phrase("{} · {}", place, phase) if phase else place)


def _chosen_rows(findings: Sequence[GapFinding]) -> dict[tuple[str, str], list[GapFinding]]:
    """The most certain rows by quantity and unit, from the release down."""
    groups: dict[tuple[str, str], list[GapFinding]] = {}
    for finding in findings:
        groups.setdefault((finding.quantity, finding.unit), []).append(finding)

    def down_the_slope(finding: GapFinding) -> tuple[float, str, str]:
        middle = 0.5 * (finding.s0_m + finding.s1_m)
        return (middle if math.isfinite(middle) else math.inf, finding.place, finding.phase)

    return {
        key: sorted(
            sorted(rows, key=lambda f: (f.p_adjusted, f.q_value))[:MAX_ROWS], key=down_the_slope
        )
        for key, rows in list(groups.items())[:MAX_PANELS]
    }


@house_style()
def gap_where_figure(findings: Sequence[GapFinding]) -> Figure:
    """Draw every gap as a dot with its interval, a panel for each quantity in its own unit.

    The most certain findings come first. Quantities beyond ``MAX_PANELS`` and rows of one beyond
    ``MAX_ROWS`` are left out, and the figure says so.
    """
    groups = _chosen_rows(findings)
    shown = sum(len(rows) for rows in groups.values())
    note = phrase(
        "Dots: mean over rocks; bars: 95 % intervals, rocks resampled. Filled: significant among "
        "all comparisons (5 %); coloured ring: among those that the map shows (share of false ones "
        "5 %); grey: not distinguished from chance. Right: number of rocks."
    )
    if shown < len(findings):
        more = phrase("{} of {} are shown, the most certain.", shown, len(findings))
        note = joined(" ", (note, more))
    columns = 1 if len(groups) < 2 else 2
    width = WIDTH_IN / columns
    titles = {
        key: wrap(with_unit_in_brackets(quantity_name(key[0]), key[1]), width - 0.3, TEXT + 1.0)
        for key in groups
    }
    heads = {key: 0.06 + 0.15 * lines_in(text) for key, text in titles.items()}
    filled = [0.0] * columns
    places = []
    for key, rows in groups.items():
        column = int(np.argmin(filled))
        places.append((key, column * width, filled[column]))
        filled[column] += heads[key] + _ROW_IN * len(rows) + 0.36
    top, bottom = 0.36, note_height(note) + 0.05
    page = Page(top + max(max(filled), 1.0) + bottom)
    page.around("Observed less predicted, by place and phase", note)
    longest = max(len(_row_label(f, rows)) for rows in groups.values() for f in rows)
    label_w = min(0.45 * width, 0.066 * longest + 0.2)
    for key, x, used in places:
        rows, y = groups[key], page.height - top - used
        page.text(x + 0.1, y, titles[key], size=TEXT, weight="bold", va="top")
        tall = _ROW_IN * len(rows)
        ax = page.axes(x + label_w, y - heads[key] - tall, width - label_w - 0.38, tall, key[0])
        _draw_gaps(ax, rows)
    return page.figure


def _interval(ax: Axes, row: int, ends: tuple[float, float], colour: str) -> None:
    """Draw an interval in a row; nothing where it is not known."""
    if math.isfinite(ends[0]) and math.isfinite(ends[1]):
        ax.plot(ends, [row, row], color=colour, lw=1.5, alpha=0.8, gid="interval")


def _rows_only(ax: Axes, n: int, rest: float) -> None:
    """Give an axis the look of n rows, the first on top."""
    ax.set_ylim(n - 1 + rest, -rest)
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(False)
    ax.tick_params(axis="y", length=0)


def _draw_gaps(ax: Axes, rows: Sequence[GapFinding]) -> None:
    ax.axvline(0.0, color=GREY, lw=0.8, zorder=1)
    for i, finding in enumerate(rows):
        sure = significance(finding)
        colour = GREY if sure == "open" else VERMILION if finding.gap > 0.0 else BLUE
        _interval(ax, i, finding.ci95, colour)
        ax.plot(
            [finding.gap], [i], "o", ms=4.5, mec=colour, mew=1.1,
            mfc=colour if sure == "sure" else "white", zorder=5, gid=f"gap-{sure}",
        )  # fmt: skip
        _beside(ax, i, str(finding.rocks), (1.0, 6.0), color=GREY)
    ax.set_yticks(range(len(rows)), [_row_label(f, rows) for f in rows])
    for label, finding in zip(ax.get_yticklabels(), rows, strict=True):
        label.set_fontweight("bold" if significance(finding) == "sure" else "normal")
    _rows_only(ax, len(rows), 0.6)
    ax.margins(x=0.08)
    ax.locator_params(axis="x", nbins=4)


def _beside(
    ax: Axes, row: int, words: str, at: tuple[float, float], up: float = 0.0, **how: Any
) -> None:
    """Write beside a row: at a share of the width, and so many points from there."""
    how |= {"xycoords": ("axes fraction", "data"), "va": "center", "annotation_clip": False}
    beside(ax, words, (at[0], row), (at[1], up), **how)


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
    """Energy distance, squared as on the page, in standard deviations of the observed."""
    unit = float(np.std(observed, ddof=1)) if observed.size > 1 else 0.0
    return float(energy_distance(observed, model) ** 2) / (unit or 1.0)


@house_style()
def gap_distributions_figure(comparisons: Sequence[Comparison], *, effect: str = "") -> Figure:
    """Draw the distributions of observed rocks and of the models, each as it is: in steps.

    The band is that of the calibrated base model for as many rocks as were observed: a curve within
    it does not differ from that model. Of more than ``MAX_PANELS`` comparisons the figure says so.
    ``effect`` is that of the effect model, empty if none is named.
    """
    chosen = list(comparisons)[:MAX_PANELS]
    after = bool(effect) and any(c.effect for c in chosen)
    parts = [
        phrase(
            "Black: observed, a step for each value. Blue: calibrated base model; pale band: where "
            "95 of 100 samples of as many values lie."
        )
    ]
    text = (
        "D: energy distance to the observed values, in their standard deviations, of the values "
        "that are drawn."
    )
    if after:
        parts.append(phrase("Vermilion: with {}.", effect_name(effect)))
        text = (
            "D: energy distance to the observed values, in their standard deviations, base → with "
            "the effect, of the values that are drawn."
        )
    parts.append(phrase(text))
    if len(chosen) < len(comparisons):
        parts.append(phrase("{} of {} comparisons are drawn.", len(chosen), len(comparisons)))
    note = joined(" ", parts)
    columns = min(len(chosen), 3 if len(chosen) > 4 else 2)
    rows = -(-len(chosen) // columns)
    panel_h, gap_h, top, bottom = 1.45, 0.55, 0.62, note_height(note) + 0.36
    page = Page(top + rows * panel_h + (rows - 1) * gap_h + bottom)
    page.around("Observed and simulated, before and after", note)
    left, right, between = 0.66, 0.12, 0.24
    width = (WIDTH_IN - left - right - (columns - 1) * between) / columns
    for i, comparison in enumerate(chosen):
        row, column = divmod(i, columns)
        x = left + column * (width + between)
        ax = page.axes(x, page.height - top - (row + 1) * panel_h - row * gap_h, width, panel_h)
        _draw_comparison(ax, comparison, width, after)
        if column:
            ax.tick_params(labelleft=False)
        else:
            ax.set_ylabel("share below")
    return page.figure


def _draw_comparison(ax: Axes, comparison: Comparison, width_in: float, after: bool) -> None:
    seen, base = _known(comparison.observed), _known(comparison.base)
    with_effect = _known(comparison.effect) if after else np.empty(0)
    words = with_unit_in_brackets(
        phrase("{} {}", quantity_name(comparison.quantity), place_words(comparison.place)),
        comparison.unit,
    )
    ax.set_title(wrap(words, width_in, SMALL + 0.5), size=SMALL + 0.5, pad=3)
    ax.set_ylim(-0.02, 1.04)
    ax.yaxis.set_major_formatter(percent_formatter(1.0))
    ax.locator_params(axis="x", nbins=5)
    if not seen.size:
        nothing_to_show(ax, "not observed", keep_x=True)
        return
    if base.size:
        x, low, high = _band(base, seen.size)
        ax.fill_between(x, low, high, step="post", color=SKY, alpha=0.25, lw=0, gid="band")
    curves = ((base, BLUE, 1.3, "base"), (with_effect, VERMILION, 1.3, "effect"))
    for values, colour, width, gid in (*curves, (seen, INK, 1.1, "observed")):
        if values.size:
            ax.step(*_steps(values), where="post", color=colour, lw=width, gid=gid)
    if seen.size <= _MARKED:
        x, y = _steps(seen)
        ax.plot(x[1:], y[1:], "o", ms=2.2, color=INK, gid="observed-values")
    distances = [f"{_distance(seen, v):.2g}" for v in (base, with_effect) if v.size]
    compared = "D " + " → ".join(distances) + "\n" if distances else ""
    ax.text(
        0.97, 0.06, f"{compared}n = {seen.size}", transform=ax.transAxes, ha="right", va="bottom",
        size=SMALL, gid="distance", path_effects=halo(), zorder=9,
    )  # fmt: skip


# --- which -----------------------------------------------------------------------------------


@house_style()
def gap_ladder_figure(ladder: Sequence[Rung]) -> Figure:
    """Draw the distance of each model to the observed rocks, and the share of the gap it closes.

    The configured model comes first, what chance leaves last.
    """
    note = (
        "Energy distance to the observed rocks, each compared with a model fitted without it; in "
        "brackets the 95 % interval of the share of the gap (rocks resampled)."
    )
    n = len(ladder)
    top, bottom = 0.62, note_height(note) + 0.5
    page = Page(top + 0.32 * n + bottom)
    page.around("How far the gap shrinks", note)
    ax = page.axes(1.95, bottom, 3.0, 0.32 * n, "ladder")
    for i, rung in enumerate(ladder):
        ends = rung.rung in ("configured", "floor")
        ax.barh(i, rung.distance, 0.6, color=LIGHT if ends else BLUE, gid=f"rung-{rung.rung}")
        if rung.share is not None:
            low, high = (100 * v for v in rung.ci95 or (0.0, 0.0))
            numbers = (f"{v:.0f}".replace("-", "\u2212") for v in (100 * rung.share, low, high))
            text = phrase(" closes {} % ({} to {})", *numbers)
            if rung.ci95 is None:
                text = phrase(" closes {} %", f"{100 * rung.share:.0f}".replace("-", "\u2212"))
            ax.text(max(rung.distance, 0.0), i, text, va="center", size=SMALL)
    ax.axvline(0.0, color=GREY, lw=0.8, zorder=1)
    names = [wrap(rung_name(r.rung), 1.85, TEXT) for r in ladder]
    ax.set_yticks(range(n), names, size=TEXT)
    _rows_only(ax, n, 0.6)
    ax.grid(visible=False)
    ax.set_xlim(min(0.0, *(r.distance for r in ladder)), 1.45 * max(r.distance for r in ladder))
    ax.set_xlabel("energy distance", size=SMALL)
    return page.figure


@house_style()
def gap_hypotheses_figure(
    hypotheses: Sequence[Hypothesis], *, verdict: str, confusion: Sequence[str] = ()
) -> Figure:
    """Draw what each explanation gains, and how probable it is, the most probable first.

    The effect that the diagnosis names is marked, and those that the data do not separate from it.
    """
    n = len(hypotheses)
    others = [e for e in confusion if e != verdict]
    note = phrase(
        "Left: by how much the energy score of held-out rocks falls below that of the calibrated "
        "base model, with 95 % interval (rocks resampled); above zero is better. Right: "
        "probability of being the cause. Vermilion: the answer."
    )
    if others:
        note = joined(" ", (note, phrase("Blue: not separated from it by these data.")))
    top, bottom = 0.62, note_height(note) + 0.42
    page = Page(top + 0.29 * n + bottom)
    page.around("Explanations that were tried", note)
    # Names of two causes take more room.
    widths = [
        max(text_width(effect_name(h.effect), TEXT, bold=True), text_width(h.form, SMALL - 1.0))
        for h in hypotheses
    ]
    left = min(max(1.85, *widths) + 0.1, 3.3)
    gains = page.axes(left, bottom, 4.5 - left, 0.29 * n, "gain")
    shares = page.axes(4.65, bottom, 1.75, 0.29 * n, "share")
    gains.axvline(0.0, color=GREY, lw=0.8, zorder=1)
    for i, hypothesis in enumerate(hypotheses):
        named = hypothesis.effect == verdict
        colour = VERMILION if named else BLUE if hypothesis.effect in others else GREY
        if hypothesis.ci95[0] < hypothesis.ci95[1]:
            _interval(gains, i, hypothesis.ci95, colour)
        if math.isfinite(hypothesis.gain):
            gains.plot([hypothesis.gain], [i], "o", ms=4.5, color=colour, zorder=5, gid="gain")
        share = hypothesis.probability if math.isfinite(hypothesis.probability) else 0.0
        bar = LIGHT if colour == GREY else colour
        shares.barh(i, share, 0.6, color=bar, gid=f"share-{hypothesis.effect}")
        text = f"{100 * share:.0f} %" if share >= 0.005 else "< 1 %"
        shares.text(share + 0.02, i, text, va="center", size=SMALL)
        weight = "bold" if named else "normal"
        up = 3.5 if hypothesis.form else 0.0
        name = effect_name(hypothesis.effect)
        _beside(gains, i, name, (0.0, -6.0), up, ha="right", size=TEXT, weight=weight)
        _beside(gains, i, hypothesis.form, (0.0, -6.0), -5.0, ha="right", size=SMALL - 1.0,
                color=GREY)  # fmt: skip
    for ax, title in ((gains, "gain in score"), (shares, "probability")):
        ax.set_yticks([])
        ax.set_title(title, size=TEXT)
        _rows_only(ax, n, 0.55)
    shares.set(xlim=(0.0, 1.18), xticks=[0.0, 0.5, 1.0])
    shares.xaxis.set_major_formatter(percent_formatter(1.0))
    gains.margins(x=0.08)
    gains.locator_params(axis="x", nbins=5)
    return page.figure
