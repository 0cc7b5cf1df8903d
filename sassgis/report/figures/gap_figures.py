"""Figures of a diagnosis and of a calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.stats import binom, energy_distance

from sassgis.gap import words
from sassgis.gap.diagnosis import Comparison, GapFinding, Hypothesis, Rung
from sassgis.gap.fit.parameters import Fitted
from sassgis.grid import FloatArray, Grid
from sassgis.report.figures import map_marks, style
from sassgis.report.figures.map_figure import MapPanel, colour_bar, draw_maps, finish
from sassgis.report.figures.relief import footprint, view_of
from sassgis.settings.languages import joined, phrase, translated

#: Rows of one quantity beyond this number are left out, the least certain first.
MAX_ROWS = 14
#: Panels of one figure beyond this number are left out.
MAX_PANELS = 12
#: Up to this many observed values each is marked on the curve.
_MARKED = 60
#: Height of a row (in); rows that the title and the axis of a panel take.
_ROW_IN, _HEAD_ROWS = 0.2, 2.6


@dataclass(frozen=True, slots=True)
class GapStretch:
    """A stretch of a fall line, or a station, with the gap there.

    The trace holds coordinates (m) of shape (n, 2), the gap is NaN where nothing was compared. A
    gap that is not sure to differ from chance is drawn thin.
    """

    trace: FloatArray
    gap: float
    sure: bool = True


@style.house_style()
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

    Lines, release and ``stops`` are of shape (n, 2) (m). Stretches and stations are trace, gap (NaN
    where nothing was compared), and whether it is sure; the others are drawn thin.
    """
    points = map_marks.all_points([*lines, *(s.trace for s in stations.values()), release, stops])
    points = points[np.isfinite(points).all(axis=1)]
    view = view_of(grid, footprint(grid, None, points))
    gaps = [s.gap for s in (*stretches, *stations.values()) if math.isfinite(s.gap)]
    largest = max((abs(g) for g in gaps), default=0.0)
    norm = Normalize(-largest or -1.0, largest or 1.0)
    keys = {
        phrase(
            "Colour: {}, observed less predicted; vermilion: more was observed, blue: less; thin: "
            "not distinguished from chance.",
            words.quantity_name(quantity),
        ): gaps,
        phrase("Thin dark lines: fall lines."): lines,
        phrase("Triangles: release."): len(release),
        phrase("Diamonds: where observed blocks lie."): len(stops),
    }
    text = joined(" ", (part for part, there in keys.items() if there))

    def draw(ax: Axes) -> None:
        map_marks.draw_lines(ax, [c for c in lines if len(c) > 1], 0.5, 0.5)
        _draw_stretches(ax, stretches, norm, 2.4, 6)
        _draw_stretches(ax, list(stations.values()), norm, 3.2, 8)
        for station in stations.values():
            if len(station.trace) > 1 and not math.isfinite(station.gap):
                ax.plot(*station.trace.T, ls="--", color=style.INK, lw=1.1, zorder=7)
        map_marks.draw_points(
            ax=ax,
            xy=stops,
            mark="D",
            size=3.2,
            fill="white",
            edge=style.INK,
            width=0.7,
            zorder=11,
            gid="stops",
        )

    panel = MapPanel(None, style.GAP_COLOURS, norm, alpha=1.0)
    names = [
        map_marks.line_name(n, station.trace)
        for n, station in stations.items()
        if len(station.trace)
    ]
    marks = map_marks.MapMarks(list(release[:, None]), names=names)
    sheet, axes = draw_maps(
        view, [panel], marks, "Where the gap lies", [text], taken=view.holds(points), more=draw
    )
    if gaps:
        colour_bar(axes, panel, unit)
    return finish(sheet, axes, marks, view)


def _draw_stretches(
    ax: Axes, stretches: Sequence[GapStretch], norm: Normalize, width: float, zorder: float
) -> None:
    known = [s for s in stretches if math.isfinite(s.gap) and len(s.trace) > 1]
    widths = np.array([width if s.sure else 0.45 * width for s in known])
    traces = [s.trace for s in known]
    colours = style.GAP_COLOURS(norm([s.gap for s in known])) if known else style.INK
    edges = LineCollection(
        traces, colors=style.INK, linewidths=widths + 0.8, alpha=0.55, zorder=zorder
    )
    ax.add_collection(edges)
    ax.add_collection(
        LineCollection(traces, colors=colours, linewidths=widths, zorder=zorder + 1, gid="gaps")
    )


def _chosen_rows(findings: Sequence[GapFinding]) -> dict[tuple[str, str], list[GapFinding]]:
    """Return the most certain rows by quantity and unit, from the release down."""
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


@style.house_style()
def gap_where_figure(findings: Sequence[GapFinding]) -> Figure:
    """Draw gaps with their intervals, a panel for each quantity; says what is left out."""
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
    columns: list[list[tuple[str, str]]] = [[] for _ in range(min(len(groups), 2) or 1)]
    filled = [0.0] * len(columns)
    for key, rows in groups.items():
        column = int(np.argmin(filled))
        columns[column].append(key)
        filled[column] += len(rows) + _HEAD_ROWS
    sheet = style.Sheet("Observed less predicted, by place and phase", note, _ROW_IN * max(filled))
    grid = sheet.figure.add_gridspec(1, len(columns))
    for k, keys in enumerate(columns):
        # The room below the shorter column stays empty.
        ratios: list[float] = [len(groups[key]) + _HEAD_ROWS for key in keys]
        rest = [max(filled) - filled[k]] if filled[k] < max(filled) else []
        parts = grid[0, k].subgridspec(len(keys) + len(rest), 1, height_ratios=ratios + rest)
        for i, key in enumerate(keys):
            ax = sheet.figure.add_subplot(parts[i])
            name = words.with_unit_in_brackets(words.quantity_name(key[0]), key[1])
            ax.set_title(style.wrap(name, style.WIDTH_IN / len(columns) - 0.8, style.TEXT))
            _draw_gaps(ax, groups[key])
    return sheet.figure


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
    ax.axvline(0.0, color=style.GREY, lw=0.8, zorder=1)
    for i, finding in enumerate(rows):
        sure = words.significance(finding)
        colour = (
            style.GREY if sure == "open" else style.VERMILION if finding.gap > 0.0 else style.BLUE
        )
        _interval(ax, i, finding.ci95, colour)
        ax.plot(
            [finding.gap], [i], "o", ms=4.5, mec=colour, mew=1.1,
            mfc=colour if sure == "sure" else "white", zorder=5, gid=f"gap-{sure}",
        )  # fmt: skip
        style.beside(
            ax, str(finding.rocks), (1.0, i), (6.0, 0.0), color=style.GREY, va="center",
            xycoords=("axes fraction", "data"), annotation_clip=False,
        )  # fmt: skip
    labels = []
    for finding in rows:
        place = words.place_name(finding.place.replace("_", " "))
        same = [f for f in rows if (f.place, f.phase) == (finding.place, finding.phase)]
        phase = words.tested_by(finding.test) if len(same) > 1 else phrase(finding.phase)
        # In the language of the figure: labels of an axis are set anew when it is drawn.
        labels.append(translated(phrase("{} · {}", place, phase) if phase else place))
    ax.set_yticks(range(len(rows)), labels)
    for label, finding in zip(ax.get_yticklabels(), rows, strict=True):
        label.set_fontweight("bold" if words.significance(finding) == "sure" else "normal")
    _rows_only(ax, len(rows), 0.6)
    ax.margins(x=0.08)
    ax.locator_params(axis="x", nbins=4)


def _known(values: Sequence[float]) -> FloatArray:
    return np.asarray([v for v in values if math.isfinite(v)], float)


def _steps(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    x = np.sort(values)
    return np.concatenate([[x[0]], x]), np.arange(x.size + 1) / x.size


def _band(values: FloatArray, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the shares between which the curve of ``n`` model rocks lies in 95 of 100 samples."""
    x, share = _steps(values)
    return x, binom.ppf(0.025, n, share) / n, binom.ppf(0.975, n, share) / n


def _distance(observed: FloatArray, model: FloatArray) -> float:
    """Return energy distance, squared as on the page, in standard deviations of the observed."""
    unit = float(np.std(observed, ddof=1)) if observed.size > 1 else 0.0
    return float(energy_distance(observed, model) ** 2) / (unit or 1.0)


@style.house_style()
def gap_distributions_figure(comparisons: Sequence[Comparison], *, effect: str = "") -> Figure:
    """Draw the distributions of observed rocks and of the models, each as it is: in steps.

    The band is that of the calibrated base model for as many rocks as were observed. ``effect`` is
    that of the effect model, empty if none is named.
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
        parts.append(phrase("Vermilion: with {}.", words.effect_name(effect)))
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
    sheet = style.Sheet("Observed and simulated, before and after", note, 1.95 * rows)
    axes = sheet.figure.subplots(rows, columns, squeeze=False, sharey=True)
    for ax, comparison in zip(axes.flat, chosen, strict=False):
        _draw_comparison(ax, comparison, style.WIDTH_IN / columns - 0.3, after)
    for ax in axes.flat[len(chosen) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("share below")
    return sheet.figure


def _draw_comparison(ax: Axes, comparison: Comparison, width_in: float, after: bool) -> None:
    seen, base = _known(comparison.observed), _known(comparison.base)
    with_effect = _known(comparison.effect) if after else np.empty(0)
    named = words.with_unit_in_brackets(
        phrase(
            "{} {}", words.quantity_name(comparison.quantity), words.place_words(comparison.place)
        ),
        comparison.unit,
    )
    ax.set_title(style.wrap(named, width_in, style.SMALL + 0.5), size=style.SMALL + 0.5, pad=3)
    ax.set_ylim(-0.02, 1.04)
    ax.yaxis.set_major_formatter(style.percent_formatter(1.0))
    ax.locator_params(axis="x", nbins=5)
    if not seen.size:
        style.nothing_to_show(ax, "not observed", keep_x=True)
        return
    if base.size:
        x, low, high = _band(base, seen.size)
        ax.fill_between(x, low, high, step="post", color=style.SKY, alpha=0.25, lw=0, gid="band")
    curves = ((base, style.BLUE, 1.3, "base"), (with_effect, style.VERMILION, 1.3, "effect"))
    for values, colour, width, gid in (*curves, (seen, style.INK, 1.1, "observed")):
        if values.size:
            ax.step(*_steps(values), where="post", color=colour, lw=width, gid=gid)
    if seen.size <= _MARKED:
        x, y = _steps(seen)
        ax.plot(x[1:], y[1:], "o", ms=2.2, color=style.INK, gid="observed-values")
    distances = [f"{_distance(seen, v):.2g}" for v in (base, with_effect) if v.size]
    compared = "D " + " → ".join(distances) + "\n" if distances else ""
    ax.text(
        0.97, 0.06, f"{compared}n = {seen.size}", transform=ax.transAxes, ha="right", va="bottom",
        size=style.SMALL, gid="distance", path_effects=style.halo(), zorder=9,
    )  # fmt: skip


@style.house_style()
def gap_ladder_figure(ladder: Sequence[Rung]) -> Figure:
    """Draw the distance of each model to the observed rocks, and how much it closes the gap."""
    note = (
        "Energy distance to the observed rocks, each compared with a model fitted without it; in "
        "brackets the 95 % interval of the share of the gap (rocks resampled)."
    )
    n = len(ladder)
    sheet = style.Sheet("How far the gap shrinks", note, 0.32 * n + 0.5)
    ax = sheet.figure.subplots()
    ax.set_label("ladder")
    for i, rung in enumerate(ladder):
        ends = rung.rung in ("configured", "floor")
        ax.barh(
            i,
            rung.distance,
            0.6,
            color=style.LIGHT if ends else style.BLUE,
            gid=f"rung-{rung.rung}",
        )
        if rung.share is not None:
            low, high = (100 * v for v in rung.ci95 or (0.0, 0.0))
            numbers = (f"{v:.0f}".replace("-", "\u2212") for v in (100 * rung.share, low, high))
            text = phrase(" closes {} % ({} to {})", *numbers)
            if rung.ci95 is None:
                text = phrase(" closes {} %", f"{100 * rung.share:.0f}".replace("-", "\u2212"))
            ax.text(max(rung.distance, 0.0), i, text, va="center", size=style.SMALL)
    ax.axvline(0.0, color=style.GREY, lw=0.8, zorder=1)
    names = [style.wrap(words.rung_name(r.rung), 1.85, style.TEXT) for r in ladder]
    ax.set_yticks(range(n), names, size=style.TEXT)
    _rows_only(ax, n, 0.6)
    ax.grid(visible=False)
    ax.set_xlim(min(0.0, *(r.distance for r in ladder)), 1.45 * max(r.distance for r in ladder))
    ax.set_xlabel("energy distance", size=style.SMALL)
    return sheet.figure


@style.house_style()
def gap_hypotheses_figure(
    hypotheses: Sequence[Hypothesis], *, verdict: str, confusion: Sequence[str] = ()
) -> Figure:
    """Draw gain and probability of each explanation; marks the answer and its rivals."""
    n = len(hypotheses)
    others = [e for e in confusion if e != verdict]
    note = phrase(
        "Left: by how much the energy score of held-out rocks falls below that of the calibrated "
        "base model, with 95 % interval (rocks resampled); above zero is better. Right: "
        "probability of being the cause. Vermilion: the answer."
    )
    if others:
        note = joined(" ", (note, phrase("Blue: not separated from it by these data.")))
    sheet = style.Sheet("Explanations that were tried", note, 0.29 * n + 0.6)
    gains, shares = sheet.figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    gains.axvline(0.0, color=style.GREY, lw=0.8, zorder=1)
    for i, hypothesis in enumerate(hypotheses):
        named = hypothesis.effect == verdict
        colour = (
            style.VERMILION if named else style.BLUE if hypothesis.effect in others else style.GREY
        )
        if hypothesis.ci95[0] < hypothesis.ci95[1]:
            _interval(gains, i, hypothesis.ci95, colour)
        if math.isfinite(hypothesis.gain):
            gains.plot([hypothesis.gain], [i], "o", ms=4.5, color=colour, zorder=5, gid="gain")
        share = hypothesis.probability if math.isfinite(hypothesis.probability) else 0.0
        bar = style.LIGHT if colour == style.GREY else colour
        shares.barh(i, share, 0.6, color=bar, gid=f"share-{hypothesis.effect}")
        text = f"{100 * share:.0f} %" if share >= 0.005 else "< 1 %"
        shares.text(share + 0.02, i, text, va="center", size=style.SMALL)
    names = [
        joined("\n", filter(None, (words.effect_name(h.effect), style.wrap(h.form, 2.4))))
        for h in hypotheses
    ]
    gains.set_yticks(range(n), [translated(name) for name in names])
    for label, hypothesis in zip(gains.get_yticklabels(), hypotheses, strict=True):
        label.set_fontweight("bold" if hypothesis.effect == verdict else "normal")
    shares.set_yticks([])
    for ax, title in ((gains, "gain in score"), (shares, "probability")):
        ax.set_title(title, size=style.TEXT)
        _rows_only(ax, n, 0.55)
    shares.set(xlim=(0.0, 1.18), xticks=[0.0, 0.5, 1.0])
    shares.xaxis.set_major_formatter(style.percent_formatter(1.0))
    gains.margins(x=0.08)
    gains.locator_params(axis="x", nbins=5)
    return sheet.figure


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
