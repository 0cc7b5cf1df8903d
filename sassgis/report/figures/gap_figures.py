"""Figures of a diagnosis: where simulated and observed rocks part, why, and what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import PercentFormatter
from scipy.stats import binom

from sassgis.gap.diagnosis import Comparison, GapFinding, Hypothesis
from sassgis.gap.inference.distances import energy_distance, observed_scale
from sassgis.gap.words import (
    effect_name,
    place_words,
    quantity_name,
    significance,
    tested_by,
    with_unit_in_brackets,
)
from sassgis.model.grid import FloatArray, Grid
from sassgis.report.figures import relief
from sassgis.report.figures.map_figure import draw_release, footprint
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
        "5 %); grey: not told from chance. Right: number of rocks."
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
    it is not told from that model.

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
    told = [f"{_distance(seen, v):.2g}" for v in (base, with_effect) if v.size]
    ax.text(
        0.97, 0.06, "D " + " → ".join(told) + f"\nn = {seen.size}" if told else f"n = {seen.size}",
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
    contenders : sequence of Contender
        The most probable first.
    verdict : str
        The effect that the diagnosis names.
    confusion : sequence of str
        Effects that the data cannot tell apart.
    title : str
    """
    n = max(len(hypotheses), 1)
    others = [e for e in confusion if e != verdict]
    note = (
        "Left: by how much the energy score of rocks left out falls below that of the calibrated "
        "base model, with 95 % interval (rocks resampled); above zero is better. Right: "
        "probability of being the cause. Vermilion: the answer"
        + ("; blue: not told from it by these data." if others else ".")
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


# --- on the map ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GapStretch:
    """A stretch of a fall line, or a station, with the gap there.

    Attributes
    ----------
    course : float64, shape (n, 2)
        Coordinates (m).
    gap : float
        NaN where nothing was compared.
    sure : bool
        Whether the gap is told from chance; others are drawn thin.
    """

    course: FloatArray
    gap: float
    sure: bool = True


@styled
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
    title: str = "Where the gap lies",
    note: str = "",
) -> Figure:
    """Draw fall lines and stations over the relief, coloured by the gap of one quantity.

    Parameters
    ----------
    grid : Grid
    lines : float, each of shape (n, 2)
        Fall lines (m).
    stretches : sequence of GapStretch
        Parts of them on which the quantity was compared.
    stations : mapping of name to GapStretch
    release, stops : float, shape (n, 2)
        Release points and where observed blocks lie (m).
    quantity, unit : str
        Empty if no gap is to be shown.
    title, note : str
    """
    courses = [*lines, *(s.course for s in stations.values()), release, stops]
    filled = [c for c in courses if len(c)]
    marks = np.concatenate(filled) if filled else np.empty((0, 2))
    marks = marks[np.isfinite(marks).all(axis=1)]
    box = footprint(grid, np.full(grid.shape, np.nan), marks)
    aspect = (box[3] - box[1]) / (box[2] - box[0])
    left, right = 0.62, 0.95
    map_w = WIDTH_IN - left - right
    map_h = map_w * aspect
    if map_h > 6.5:
        map_w, map_h = 6.5 / aspect, 6.5
        left = max(left, (WIDTH_IN - map_w - right + left) / 2.0)
    gaps = [s.gap for s in (*stretches, *stations.values()) if math.isfinite(s.gap)]
    largest = max((abs(g) for g in gaps), default=0.0)
    norm = Normalize(-largest or -1.0, largest or 1.0)
    keys = [
        "Thin dark lines: fall lines." if len(lines) else "",
        "Triangles: release." if len(release) else "",
        "Diamonds: where observed blocks lie." if len(stops) else "",
    ]
    if gaps:
        keys.insert(
            0,
            f"Colour: {quantity_name(quantity)}, observed less predicted; vermilion: more was "
            "observed, blue: less; thin: not told from chance.",
        )
    text = " ".join(part for part in (*keys, note) if part)
    top, bottom = 0.52, 0.5 + _note_height(text)
    height = top + map_h + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, text)
    ax = figure.add_axes((left / WIDTH_IN, bottom / height, map_w / WIDTH_IN, map_h / height))
    ax.set_label("map")
    relief.draw_relief(ax, relief.window_of(grid, box).grid(grid))
    ax.add_collection(
        LineCollection(
            [c for c in lines if len(c) > 1], colors=INK, linewidths=0.5, alpha=0.5, zorder=5,
            gid="fall-lines",
        )
    )  # fmt: skip
    for part, width, z in ((stretches, 2.4, 6), (tuple(stations.values()), 3.2, 8)):
        known = [s for s in part if math.isfinite(s.gap) and len(s.course) > 1]
        widths = np.array([width if s.sure else 0.45 * width for s in known])
        colours = GAP_COLOURS(norm([s.gap for s in known])) if known else INK
        for edge, paint, extra in ((True, INK, 0.8), (False, colours, 0.0)):
            ax.add_collection(
                LineCollection(
                    [s.course for s in known], colors=paint, linewidths=widths + extra,
                    alpha=0.55 if edge else None, zorder=z if edge else z + 1,
                    gid=None if edge else "gaps",
                )
            )  # fmt: skip
    for name, station in stations.items():
        if len(station.course) > 1 and not math.isfinite(station.gap):
            ax.plot(
                station.course[:, 0], station.course[:, 1], ls="--", color=INK, lw=1.1, zorder=7
            )
        if len(station.course):
            east = station.course[np.argmax(station.course[:, 0])]
            ax.annotate(
                name, (float(east[0]), float(east[1])), xytext=(3, 0), va="center",
                textcoords="offset points", size=SMALL, weight="bold", path_effects=_HALO,
                zorder=22, clip_on=True, annotation_clip=True,
            )  # fmt: skip
    if len(release):
        draw_release(ax, (), release)
    ax.plot(
        stops[:, 0], stops[:, 1], "D", ms=3.2, mfc="white", mec=INK, mew=0.7, ls="none", zorder=11,
        gid="stops",
    )  # fmt: skip
    relief.map_axes(ax, box)
    taken = np.zeros((40, 40), bool)
    if marks.size:
        col = np.clip((marks[:, 0] - box[0]) / (box[2] - box[0]) * 40, 0, 39).astype(int)
        row = np.clip((box[3] - marks[:, 1]) / (box[3] - box[1]) * 40, 0, 39).astype(int)
        taken[row, col] = True
    corner = relief.emptiest_corner(
        taken, min(1.0, relief.FURNITURE_IN[0] / map_w), min(1.0, relief.FURNITURE_IN[1] / map_h)
    )
    relief.draw_furniture(ax, box, map_w, right=corner[0], top=corner[1])
    if gaps:
        bar_h = min(2.4, 0.8 * map_h)
        bar = figure.add_axes(
            (
                (left + map_w + 0.14) / WIDTH_IN, (bottom + map_h - bar_h - 0.18) / height,
                0.14 / WIDTH_IN, bar_h / height,
            ),
            label="legend",
        )  # fmt: skip
        figure.colorbar(ScalarMappable(norm, GAP_COLOURS), cax=bar).outline.set_linewidth(0.5)
        bar.tick_params(labelsize=SMALL)
        bar.grid(False)
        figure.text(
            (left + map_w + 0.14) / WIDTH_IN, (bottom + map_h) / height, unit, size=SMALL, va="top"
        )
    return figure


# --- on the hazard ---------------------------------------------------------------------------


@styled
def map_change_figure(
    grid: Grid,
    before: FloatArray,
    after: FloatArray,
    change: FloatArray,
    *,
    names: tuple[str, str] = ("Before", "After"),
    unit: str,
    ramp: str,
    release: Sequence[FloatArray] = (),
    title: str,
    note: str = "",
) -> Figure:
    """Draw a map before and after, and the difference.

    Parameters
    ----------
    grid : Grid
    before, after, change : shape of the grid
        NaN where no rock comes.
    names : (str, str)
        Over the first two maps.
    unit : str
        Empty for shares, which are drawn in per cent.
    ramp : str
        Name of a matplotlib colour map for the first two.
    release : float, each of shape (n, 2)
        Outlines of the release areas (m).
    title, note : str
    """
    scale = 1.0 if unit else 100.0
    shown_unit = unit or "%"
    marks = [np.asarray(r, float).reshape(-1, 2) for r in release]
    others = np.concatenate(marks) if marks else np.empty((0, 2))
    box = footprint(grid, np.where(np.isfinite(change), change, np.nan), others)
    window = relief.window_of(grid, box)
    part = window.grid(grid)
    factor = -(-max(part.shape) // relief.MAX_CELLS)
    aspect = (box[3] - box[1]) / (box[2] - box[0])
    left, right, between = 0.6, 0.12, 0.1
    map_w = (WIDTH_IN - left - right - 2 * between) / 3.0
    map_h = map_w * aspect
    if map_h > 6.0:
        map_w, map_h = 6.0 / aspect, 6.0
    text = " ".join(p for p in (note, "Black outline: release area." if len(release) else "") if p)
    room = WIDTH_IN - relief.FURNITURE_IN[0] - 0.4
    top, bottom = 0.55, 1.0 + max(_note_height(text, room), relief.FURNITURE_IN[1] + 0.1)
    height = top + map_h + bottom
    figure = new_figure(WIDTH_IN, height, constrained=False)
    _heading(figure, title, text, room)
    known = np.concatenate([scale * m[np.isfinite(m)] for m in (before, after)])
    # One cell must not take all the colour; the bar says that it is cut.
    high = float(np.quantile(known, 0.995)) if known.size else 1.0
    moved = np.abs(scale * change[np.isfinite(change)])
    moved = moved[moved > 0.0]
    most = float(np.quantile(moved, 0.98)) if moved.size else 1.0
    panels: tuple[tuple[str, FloatArray, str | Colormap, Normalize], ...] = (
        (names[0], scale * before, ramp, Normalize(0.0, high)),
        (names[1], scale * after, ramp, Normalize(0.0, high)),
        (
            f"{names[1]} less {names[0].lower()}",
            scale * change,
            GAP_COLOURS,
            Normalize(-most, most),
        ),
    )
    for i, (name, values, colours, norm) in enumerate(panels):
        x = left + i * (map_w + between)
        ax = figure.add_axes((x / WIDTH_IN, bottom / height, map_w / WIDTH_IN, map_h / height))
        ax.set_label("map")
        relief.draw_relief(ax, part)
        coarse = relief.coarsen(window.cut(values), factor, "mean")
        step = part.cell_size * factor
        picture = ax.imshow(
            np.ma.masked_invalid(coarse), cmap=colours, norm=norm, interpolation="nearest",
            extent=(
                part.west, part.west + coarse.shape[1] * step,
                part.north - coarse.shape[0] * step, part.north,
            ),
            alpha=0.9, zorder=2, gid="layer",
        )  # fmt: skip
        draw_release(ax, release)
        relief.map_axes(ax, box, parts=3)
        ax.set_title(name, size=TEXT, pad=3)
        if i:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)
        if i != 1:
            first = i == 0
            bar_w = map_w * (2.0 if first else 1.0) + (between if first else 0.0) - 0.3
            bar = figure.add_axes(
                ((x + 0.15) / WIDTH_IN, (bottom - 0.62) / height, bar_w / WIDTH_IN, 0.09 / height),
                label="legend",
            )
            figure.colorbar(
                picture, cax=bar, orientation="horizontal", extend="max" if first else "both"
            ).outline.set_linewidth(0.5)
            bar.tick_params(labelsize=SMALL)
            bar.set_xlabel(
                shown_unit if first else f"change ({unit or 'percentage points'})", size=SMALL
            )
            bar.grid(False)
    # Below the maps, where it hides nothing.
    size = (relief.FURNITURE_IN[0] + 0.1, relief.FURNITURE_IN[1] + 0.1)
    corner = figure.add_axes(
        (
            (WIDTH_IN - right - size[0]) / WIDTH_IN, 0.04 / height,
            size[0] / WIDTH_IN, size[1] / height,
        ),
        label="scale",
    )  # fmt: skip
    corner.set_axis_off()
    inch = (box[2] - box[0]) / map_w
    corner.set_xlim(0.0, size[0] * inch)
    corner.set_ylim(0.0, size[1] * inch)
    relief.draw_furniture(
        corner, (0.0, 0.0, size[0] * inch, size[1] * inch), size[0], right=True, top=True
    )
    return figure
