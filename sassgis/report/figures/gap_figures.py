"""Figures of a diagnosis and of a calibration."""

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

from sassgis.gap import words
from sassgis.gap.diagnosis import Comparison, GapFinding, Hypothesis, Rung
from sassgis.gap.fit.parameters import Fitted
from sassgis.grid import FloatArray, Grid
from sassgis.report.figures import map_marks, style
from sassgis.report.figures.map_figure import MapPanel, colour_bar, draw_maps, finish
from sassgis.report.figures.relief import footprint, view_of
from sassgis.settings.languages import Phrase, joined, phrase, translated

#: Rows of one quantity beyond this number are left out, the least certain first.
MAX_ROWS = 14
#: Panels of one figure beyond this number are left out.
MAX_PANELS = 12
#: Up to this many observed values each is marked on the curve.
_MARKED = 60
#: Samples of a model from which its distance by chance is known.
_CHANCE_SAMPLES = 99
#: Quantities that are drawn before the others.
_FIRST = ("runout_m", "speed_mps", "height_m")
#: Names of the models in a note.
_CURVE_NAMES = {
    "configured": "configured",
    "base": "calibrated base model",
    "effect": "with the effect",
}
#: Height of a row (in); rows that the title and the axis of a panel take.
_ROW_IN, _HEAD_ROWS = 0.2, 2.6


@dataclass(frozen=True, slots=True)
class GapStretch:
    """A stretch of a fall line, or a station, with the gap there.

    The trace holds coordinates (m) of shape (n, 2), the gap is NaN where nothing was compared. A
    gap that is not sure to differ from chance is thin and grey.
    """

    trace: FloatArray
    gap: float
    sure: bool = True

    @property
    def known(self) -> bool:
        """Whether something was compared."""
        return math.isfinite(self.gap)


@dataclass(frozen=True, slots=True)
class GapMap:
    """The gap of one model on the map."""

    stretches: Sequence[GapStretch]
    stations: Mapping[str, GapStretch]

    @property
    def all(self) -> list[GapStretch]:
        """Stretches and stations."""
        return [*self.stretches, *self.stations.values()]

    @property
    def known(self) -> bool:
        """Whether anything was compared."""
        return any(own.known for own in self.all)


@style.house_style()
def gap_map_figure(
    grid: Grid,
    *,
    lines: Sequence[FloatArray],
    maps: Mapping[str, GapMap],
    release: FloatArray,
    stops: FloatArray,
    quantity: str,
    unit: str,
) -> Figure:
    """Draw fall lines and stations over the relief, coloured by the gap of one quantity.

    Lines, release and ``stops`` are of shape (n, 2) (m). ``maps``: a map for each model, by its
    name.
    """
    stations = next(iter(maps.values())).stations
    points = map_marks.all_points([*lines, *(s.trace for s in stations.values()), release, stops])
    points = points[np.isfinite(points).all(axis=1)]
    view = view_of(grid, footprint(grid, None, points))
    compared = [s for own in maps.values() for s in own.all if s.known]
    gaps = [s.gap for s in compared if s.sure]
    largest = max((abs(g) for g in gaps), default=0.0)
    norm = Normalize(-largest or -1.0, largest or 1.0)
    keys = {
        phrase(
            "Colour: {}, observed minus predicted; vermilion: observed is higher, blue: observed "
            "is lower.",
            words.quantity_name(quantity),
        ): gaps,
        phrase(
            "Thin and pale: gap not distinguishable from chance ({}).",
            words.quantity_name(quantity),
        ): len(compared) > len(gaps),
        phrase("Thin dark lines: fall lines."): lines,
        phrase("Triangles: release."): len(release),
        phrase("Diamonds: where observed blocks lie."): len(stops),
    }
    text = joined(" ", (part for part, there in keys.items() if there))
    drawn = iter(maps.values())

    def draw(ax: Axes) -> None:
        own = next(drawn)
        map_marks.draw_lines(ax, [c for c in lines if len(c) > 1], 0.5, 0.5)
        _draw_stretches(ax, own.stretches, norm, 2.4, 6)
        _draw_stretches(ax, list(own.stations.values()), norm, 3.2, 8)
        for station in own.stations.values():
            if len(station.trace) > 1 and not station.known:
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

    panels = [MapPanel(None, style.GAP_COLOURS, norm, name, alpha=1.0) for name in maps]
    names = [
        map_marks.line_name(n, station.trace)
        for n, station in stations.items()
        if len(station.trace)
    ]
    marks = map_marks.MapMarks(list(release[:, None]), names=names)
    sheet, axes = draw_maps(view, panels, marks, "Where the gap lies", [text], more=draw)
    if gaps:
        colour_bar(axes, panels[0], unit)
    return finish(sheet, axes, marks, view)


def _draw_stretches(
    ax: Axes, stretches: Sequence[GapStretch], norm: Normalize, width: float, zorder: float
) -> None:
    # What is sure lies over what is not.
    known = sorted((s for s in stretches if s.known and len(s.trace) > 1), key=lambda s: s.sure)
    widths = np.array([width if s.sure else 0.45 * width for s in known])
    traces = [s.trace for s in known]
    colours = [style.GAP_COLOURS(norm(s.gap)) if s.sure else style.LIGHT for s in known]
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
def gap_where_figure(
    findings: Sequence[GapFinding], configured: Sequence[GapFinding] = ()
) -> Figure:
    """Draw gaps with their intervals, a panel for each quantity; says what is left out.

    ``configured``: gaps of the configured model, drawn beside those of the same comparison.
    """
    groups = _chosen_rows(findings)
    before = {_comparison_key(f): f for f in configured}
    shown = sum(len(rows) for rows in groups.values())
    note = phrase(
        "Dots: mean over rocks with the calibrated base model. Bars: 95 % intervals, rocks "
        "resampled. Filled: significant after adjustment for all comparisons (5 %). Coloured "
        "ring: likely, false discovery rate 5 %. Grey: not distinguishable from chance. Right: "
        "number of rocks."
    )
    if before:
        note = joined(
            " ",
            (note, phrase("Diamonds and thin bars above them: the same for the configured model.")),
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
    sheet = style.Sheet("Observed minus predicted, by place and phase", note, _ROW_IN * max(filled))
    grid = sheet.figure.add_gridspec(1, len(columns))
    for k, keys in enumerate(columns):
        # The room below the shorter column stays empty.
        ratios: list[float] = [len(groups[key]) + _HEAD_ROWS for key in keys]
        rest = [max(filled) - filled[k]] if filled[k] < max(filled) else []
        parts = grid[0, k].subgridspec(len(keys) + len(rest), 1, height_ratios=ratios + rest)
        for i, key in enumerate(keys):
            ax = sheet.figure.add_subplot(parts[i])
            name = words.with_unit_in_brackets(words.quantity_name(key[0]), key[1])
            ax.set_title(style.wrap(name, style.WIDTH_IN / len(columns) - 1.6, style.TEXT))
            _draw_gaps(ax, groups[key], before)
    return sheet.figure


def _interval(
    ax: Axes, row: float, ends: tuple[float, float], colour: str, width: float = 1.5
) -> None:
    """Draw an interval in a row; nothing where it is not known."""
    if math.isfinite(ends[0]) and math.isfinite(ends[1]):
        ax.plot(ends, [row, row], color=colour, lw=width, alpha=0.8, gid="interval")


def _rows_only(ax: Axes, n: int, rest: float) -> None:
    """Give an axis the look of n rows, the first on top."""
    ax.set_ylim(n - 1 + rest, -rest)
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(False)
    ax.tick_params(axis="y", length=0)


def _comparison_key(finding: GapFinding) -> tuple[str, ...]:
    """Return what a comparison of two models has in common."""
    return finding.place, finding.phase, finding.quantity, finding.unit, finding.test


def _draw_gap(ax: Axes, at: float, finding: GapFinding, mark: str, size: float, gid: str) -> None:
    """Draw a gap with its interval, coloured where it is not chance."""
    sure = words.significance(finding)
    colour = style.VERMILION if finding.gap > 0.0 else style.BLUE
    colour = style.GREY if sure == "open" else colour
    _interval(ax, at, finding.ci95, colour, 0.3 * size)
    ax.plot(
        [finding.gap], [at], mark, ms=size, mec=colour, mew=1.1,
        mfc=colour if sure == "sure" else "white", zorder=5, gid=f"{gid}-{sure}",
    )  # fmt: skip


def _draw_gaps(
    ax: Axes, rows: Sequence[GapFinding], before: Mapping[tuple[str, ...], GapFinding]
) -> None:
    ax.axvline(0.0, color=style.GREY, lw=0.8, zorder=1)
    for i, finding in enumerate(rows):
        own = before.get(_comparison_key(finding))
        if own is not None:
            _draw_gap(ax, i - 0.22, own, "D", 2.8, "configured")
        _draw_gap(ax, i + (0.12 if own else 0.0), finding, "o", 4.5, "gap")
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


def _distance(observed: FloatArray, model: FloatArray) -> Phrase:
    """Return energy distance, squared as on the page, in standard deviations of the observed.

    "chance" where 5 of 100 samples of as many values of the model are as far from it.
    """
    unit = (float(np.std(observed, ddof=1)) if observed.size > 1 else 0.0) or 1.0

    def distance(values: FloatArray) -> float:
        return float(energy_distance(values, model) ** 2) / unit

    own, rng = distance(observed), np.random.default_rng(59)
    usual = [distance(rng.choice(model, observed.size)) for _ in range(_CHANCE_SAMPLES)]
    return phrase("chance") if own <= np.quantile(usual, 0.95) else phrase("{}", f"{own:.2g}")


#: Models in the order in which they are drawn and compared: colour and dashes.
_CURVES: Mapping[str, tuple[str, Any]] = {
    "configured": (style.ORANGE, (0, (3.0, 1.4))),
    "base": (style.BLUE, "-"),
    "effect": (style.VERMILION, "-"),
}


@style.house_style()
def gap_distributions_figure(comparisons: Sequence[Comparison], *, effect: str = "") -> Figure:
    """Draw the distributions of observed rocks and of the models, each as it is: in steps.

    The band is that of the calibrated base model for as many rocks as were observed. ``effect`` is
    that of the effect model, empty if none is named.
    """
    rank = {name: k for k, name in enumerate(_FIRST)}
    varied = [c for c in comparisons if len({*c.observed, *c.base, *c.effect, *c.configured}) > 1]
    chosen = sorted(varied, key=lambda c: rank.get(c.quantity, len(rank)))[:MAX_PANELS]
    shown = [name for name in _CURVES if any(getattr(c, name) for c in chosen)]
    shown = [name for name in shown if name != "effect" or effect]
    parts = [
        phrase(
            "Black: observed, one step per value. Blue: calibrated base model; pale band: 95 % "
            "of its samples of the same size."
        )
    ]
    if "configured" in shown:
        parts.append(phrase("Orange, dashed: the configured model."))
    if "effect" in shown:
        parts.append(phrase("Vermilion: with {}.", words.effect_name(effect)))
    parts.append(
        phrase(
            "D: energy distance to the observed values in their standard deviations, in the "
            "order {}; “chance”: not distinguishable from it.",
            joined(" → ", map(phrase, (_CURVE_NAMES[name] for name in shown))),
        )
    )
    if len(chosen) < len(comparisons):
        parts.append(phrase("{} of {} comparisons are drawn.", len(chosen), len(comparisons)))
    note = joined(" ", parts)
    columns = min(len(chosen), 3 if len(chosen) > 4 else 2)
    rows = -(-len(chosen) // columns)
    sheet = style.Sheet("Observed and simulated, before and after", note, 1.95 * rows)
    axes = sheet.figure.subplots(rows, columns, squeeze=False, sharey=True)
    for ax, comparison in zip(axes.flat, chosen, strict=False):
        _draw_comparison(ax, comparison, style.WIDTH_IN / columns - 0.6, shown)
    for ax in axes.flat[len(chosen) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("share below")
    return sheet.figure


def _draw_comparison(
    ax: Axes, comparison: Comparison, width_in: float, shown: Sequence[str]
) -> None:
    seen = _known(comparison.observed)
    models = {name: _known(getattr(comparison, name)) for name in shown}
    models = {name: values for name, values in models.items() if values.size}
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
    if "base" in models:
        x, low, high = _band(models["base"], seen.size)
        ax.fill_between(x, low, high, step="post", color=style.SKY, alpha=0.25, lw=0, gid="band")
    for name, values in models.items():
        colour, dashes = _CURVES[name]
        ax.step(*_steps(values), where="post", color=colour, ls=dashes, lw=1.3, gid=name)
    ax.step(*_steps(seen), where="post", color=style.INK, lw=1.1, gid="observed")
    if seen.size <= _MARKED:
        x, y = _steps(seen)
        ax.plot(x[1:], y[1:], "o", ms=2.2, color=style.INK, gid="observed-values")
    number = phrase("n = {}", seen.size)
    distances = [_distance(seen, values) for values in models.values()]
    if len({*distances}) == 1:
        distances = distances[:1]
    text = phrase("D: {}\n{}", joined(" → ", distances), number) if models else number
    ax.text(
        0.97, 0.06, text, transform=ax.transAxes, ha="right", va="bottom",
        size=style.SMALL, gid="distance", path_effects=style.halo(), zorder=9,
    )  # fmt: skip


@style.house_style()
def gap_ladder_figure(ladder: Sequence[Rung]) -> Figure:
    """Draw the distance of each model to the observed rocks, and how much it closes the gap."""
    note = (
        "Energy distance to the observed rocks, each compared with a model fitted without it; "
        "zero on average where only chance remains. In brackets: 95 % interval of the share "
        "closed (rocks resampled). Blue: certainly closes part of the gap."
    )
    models = ladder[:-1]
    n = len(models)
    sheet = style.Sheet("How far the gap shrinks", note, 0.34 * n + 0.5)
    ax = sheet.figure.subplots()
    ax.set_label("ladder")
    for i, rung in enumerate(models):
        sure = rung.share is not None and rung.ci95 is not None and rung.ci95[0] > 0.0
        length = max(rung.distance, 0.0)
        ax.barh(i, length, 0.6, color=style.BLUE if sure else style.LIGHT, gid=f"rung-{rung.rung}")
        said = [] if rung.share is None else [_closes(rung, sure)]
        if words.is_chance(rung, ladder) and (sure or rung.share is None):
            said.append(phrase("not distinguishable from chance"))
        ax.text(length, i, joined("; ", said), va="center", size=style.SMALL)
    ax.axvline(0.0, color=style.GREY, lw=0.8, zorder=1)
    names = [style.wrap(words.rung_name(r.rung), 1.85, style.TEXT) for r in models]
    ax.set_yticks(range(n), names, size=style.TEXT)
    _rows_only(ax, n, 0.6)
    ax.grid(visible=False)
    # Unbiased distances may all be below zero.
    ax.set_xlim(0.0, 1.7 * max(1e-3, *(r.distance for r in models)))
    ax.set_xlabel("energy distance", size=style.SMALL)
    return sheet.figure


def _closes(rung: Rung, sure: bool) -> Phrase:
    """Return what a model closes of the gap, never more than all of it."""
    numbers = (
        f"{words.closed_percent(v):.0f}".replace("-", "\u2212")
        for v in (rung.share or 0.0, *(rung.ci95 or ()))
    )
    if rung.ci95 is None:
        return phrase(" closes {} %", *numbers)
    if sure:
        return phrase(" closes {} % ({} to {})", *numbers)
    _, low, high = numbers
    return phrase(" no certain reduction ({} to {} %)", low, high)


@style.house_style()
def gap_hypotheses_figure(
    hypotheses: Sequence[Hypothesis],
    *,
    probabilities: Mapping[str, float],
    verdict: str,
    rivals: Sequence[str] = (),
) -> Figure:
    """Draw probability and gain of each cause; marks the one that is named, and its rivals.

    ``probabilities``: of single causes, most likely first; what else was calibrated comes below.
    """
    fitted = {h.effect: h for h in hypotheses}
    rows = list(dict.fromkeys([*probabilities, *fitted]))
    n = len(rows)
    named = "" if verdict in ("none", "unknown", "contact_law") else verdict
    others = rivals if named else ()
    note = phrase(
        "Left: probability of each cause. Right: gain in energy score of held-out rocks over the "
        "calibrated base model, with 95 % interval (rocks resampled); above zero is better. Only "
        "calibrated causes have a score."
    )
    marked = [phrase("Vermilion: the named cause.")] if named in rows else []
    if any(e in rows for e in others):
        marked.append(phrase("Blue: causes that are also possible."))
    note = joined(" ", (note, *marked))
    sheet = style.Sheet("Causes, most likely first", note, 0.31 * n + 0.6)
    shares, gains = sheet.figure.subplots(1, 2, width_ratios=(1.0, 1.6))
    gains.axvline(0.0, color=style.GREY, lw=0.8, zorder=1)
    for i, name in enumerate(rows):
        colour = style.VERMILION if name == named else style.BLUE if name in others else style.GREY
        share = probabilities.get(name, math.nan)
        if math.isfinite(share):
            bar = style.LIGHT if colour == style.GREY else colour
            shares.barh(i, share, 0.6, color=bar, gid=f"share-{name}")
            text = (
                f"{100 * min(share, words.MOST_SURE):.0f} %" if share >= words.LISTED else "< 1 %"
            )
            shares.text(share + 0.02, i, text, va="center", size=style.SMALL)
        hypothesis = fitted.get(name)
        if hypothesis is not None and math.isfinite(hypothesis.gain):
            colour = colour if hypothesis.ci95[0] > 0.0 else style.GREY
            if hypothesis.ci95[0] < hypothesis.ci95[1]:
                _interval(gains, i, hypothesis.ci95, colour)
            gains.plot([hypothesis.gain], [i], "o", ms=4.5, color=colour, zorder=5, gid="gain")
    forms = {name: style.wrap(h.form, 2.4) for name, h in fitted.items() if h.form}
    labels = [
        joined("\n", filter(None, (words.effect_name(name), forms.get(name)))) for name in rows
    ]
    shares.set_yticks(range(n), [style.wrap(translated(label), 2.4) for label in labels])
    for label, name in zip(shares.get_yticklabels(), rows, strict=True):
        label.set_fontweight("bold" if name == verdict else "normal")
    gains.set_yticks([])
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
        own = f.parameter.limits
        ends = [own.share(value) for value in (f.low, f.high)]
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
