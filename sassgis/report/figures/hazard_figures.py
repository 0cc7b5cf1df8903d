"""Figures of hazard: curve of a place, risk, protection, maps side by side.

A figure of protection shows what reaches a line along the slope, and what goes on behind it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray

from sassgis.grid import FloatArray, Grid
from sassgis.hazard.curves import Arrivals, rate_interval, return_period
from sassgis.hazard.levels import (
    LEVEL_CHANGES,
    deciding_energy,
    energy_labels,
    hazard_level,
    levels_of_events,
    period_labels,
)
from sassgis.report.figures import map_figure, style
from sassgis.report.figures.map_marks import MapMarks, all_points, draw_points
from sassgis.report.figures.relief import footprint, view_of
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset
from sassgis.settings.languages import counted, joined, phrase
from sassgis.settings.results import RasterClass, RasterLayer, power_of_ten, thousands
from sassgis.settings.styles import class_tint

#: Sources with a separate curve; the others go together.
MAX_SOURCES = 6
_COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
_DASHES = ((0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 2)), "-")
_FIELD_ALPHA = 0.38


def leading_sources(by_source: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the rates of the most frequent sources, at most MAX_SOURCES with the rest as one."""
    coming = {name: np.asarray(r, float) for name, r in by_source.items() if np.any(r > 0.0)}
    names = sorted(coming, key=lambda name: -coming[name][0])
    if len(names) <= MAX_SOURCES:
        return {name: coming[name] for name in names}
    out = {name: coming[name] for name in names[: MAX_SOURCES - 1]}
    rest = names[MAX_SOURCES - 1 :]
    name = phrase("others ({})", len(rest))
    out[name] = np.sum([coming[name] for name in rest], axis=0)
    return out


def _draw_matrix(ax: Axes, preset: HazardPreset, energy: tuple[float, float]) -> None:
    """Fill the fields of the matrix with their level, and name it in each."""
    low, high = ax.get_ylim()
    limits = [max(e, energy[0]) for e in preset.thresholds_kj]
    spans = list(pairwise([*limits, energy[1]]))
    # From rare to frequent along the rates; a limit belongs to the more frequent class.
    rates = [low, *sorted(1.0 / t for t in preset.return_periods), high]
    bands = list(pairwise(rates))[::-1]
    for (left, right), row in zip(spans, preset.matrix, strict=True):
        for (bottom, top), place in zip(bands, row, strict=True):
            level = preset.levels[place]
            bottom, top = max(bottom, low), min(top, high)
            if top <= bottom or right <= left:
                continue
            # A hatched level is striped on white, as on maps.
            field = ax.fill_between(
                [left, right], bottom, top, facecolor="white" if level.hatched else level.colour,
                alpha=None if level.hatched else _FIELD_ALPHA, lw=0.0, zorder=0.5,
                gid=f"field-{level.code}",
            )  # fmt: skip
            if level.hatched:
                field.set_hatch("/////")
                field.set_edgecolor(level.colour)
            size = (right - left, top - bottom)
            ax.add_patch(
                Rectangle((left, bottom), *size, fc="none", ec="white", lw=1.0, zorder=0.6)
            )
            if np.log(top / bottom) > 0.06 * np.log(high / low):
                words = style.ink_on(level.colour, _FIELD_ALPHA)
                ax.text(
                    np.sqrt(left * right), np.sqrt(bottom * top), level.label, size=style.SMALL,
                    color=words, ha="center", va="center", zorder=5.0, path_effects=style.halo(),
                )  # fmt: skip


def _rate_limits(rates: FloatArray, preset: HazardPreset) -> tuple[float, float]:
    """Return whole powers of ten around the rates that are shown and the limits of the matrix."""
    known = rates[np.isfinite(rates) & (rates > 0.0)]
    limits = [1.0 / t for t in preset.return_periods]
    low = min([0.3 * limits[-1], *limits, *known])
    high = max([3.0 * limits[0], *limits, *known])
    # Rates far below the last limit say nothing more about the level.
    low = max(low, 1e-4 * limits[-1])
    return 10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(1.2 * high))


@style.house_style()
def hazard_curve_figure(
    one: HazardCurves,
    preset: HazardPreset,
    *,
    by_source: Mapping[str, FloatArray] | None = None,
    confidence: float = 0.95,
    note: str = "",
) -> Figure:
    """Draw how often blocks reach a place with at least some energy, over the hazard matrix.

    ``one`` are the curves of that place, with the thresholds of the preset; ``by_source`` are
    rates (1/year) of shape (n_energies,), of which the least of more than ``MAX_SOURCES`` go
    together.
    """
    energies, total = one.energies_kj, one.rate[0]
    sources = leading_sources(by_source or {})
    lower, upper = (limit[0] for limit in rate_interval(one, confidence))
    notes = [_level_words(one, preset)]
    if np.isnan(lower[total > 0.0]).any():
        notes.append("The sample does not give the error of the rates.")
    sheet = style.Sheet("Hazard curve", joined(" ", filter(None, (*notes, note))), 3.8)
    ax = sheet.figure.subplots()
    ax.set_label("curve")
    first = float(energies[1]) if energies.size > 1 else 1.0
    second = preset.thresholds_kj[1] if len(preset.thresholds_kj) > 1 else first
    left = min(first, second / 10.0) / 2.0
    right = 2.0 * max(float(energies[-1]), 2.0 * preset.thresholds_kj[-1])
    limits = _rate_limits(np.concatenate([total, upper]), preset)
    ax.set(xscale="log", yscale="log", xlim=(left, right), ylim=limits)
    ax.grid(False)
    _draw_matrix(ax, preset, (left, right))

    # The rate of all blocks stands at the left edge: 0 kJ has no place on the axis.
    at = np.maximum(energies, left)

    def shown(rates: FloatArray) -> FloatArray:
        return np.where(rates > 0.0, rates, np.nan)

    if np.isfinite(lower).any():
        ax.fill_between(
            at, np.maximum(np.nan_to_num(lower), 1e-300), np.nan_to_num(upper, nan=0.0),
            where=np.isfinite(lower) & (upper > 0.0), color=style.INK, alpha=0.2, lw=0.0, zorder=3,
            label=phrase("{} % interval of the sample", f"{100.0 * confidence:g}"), gid="band",
        )  # fmt: skip
    for (name, rates), colour, dashes in zip(sources.items(), _COLOURS, _DASHES, strict=False):
        ax.plot(
            at, shown(rates), color=colour, ls=dashes, lw=1.3, label=name, zorder=4,
            gid=f"source-{name}",
        )  # fmt: skip
    label = "all release areas and scenarios"
    ax.plot(at, shown(total), color=style.INK, lw=1.8, label=label, zorder=5, gid="total")
    columns = [one.column(e) for e in preset.thresholds_kj]
    dots = np.column_stack([at[columns], shown(total)[columns]])
    look = {"clip_on": False, "zorder": 6, "gid": "thresholds"}
    draw_points(ax=ax, xy=dots, mark="o", size=4.5, fill="white", edge=style.INK, width=1.2, **look)
    _label_axes(ax, preset)
    sheet.legend(ax.get_legend_handles_labels()[0])
    return sheet.figure


#: Steps of energy and of return period in the picture of what a preset makes.
_STEPS = 300


@style.house_style()
def preset_figure(preset: HazardPreset) -> Figure:
    """Draw the matrix of a preset as it is written, and the levels that are computed by it."""
    note = (
        "Left: the fields as they are written. Right: what the program computes for a place that "
        "blocks reach with an energy once in a return period. Pale: hatched on maps. White: no "
        "level."
    )
    sheet = style.Sheet(phrase("Rules: preset {}", preset.name), note, 3.2)
    table, plane = sheet.figure.subplots(1, 2)
    _matrix_table(table, preset)
    _level_plane(plane, preset)
    return sheet.figure


def _matrix_table(ax: Axes, preset: HazardPreset) -> None:
    """Draw the fields in the colours of maps, the strongest intensity at the top."""
    for y, row in enumerate(preset.matrix):
        for x, place in enumerate(row):
            level = preset.levels[place]
            ax.add_patch(
                Rectangle(
                    (x, y), 1.0, 1.0, fc="white" if level.hatched else level.colour,
                    ec=level.colour if level.hatched else "white", lw=0.8,
                    hatch="////" if level.hatched else None, gid=f"field-{y}-{x}",
                )
            )  # fmt: skip
            ax.text(
                x + 0.5, y + 0.5, style.wrap(level.label, 0.7), size=style.SMALL, ha="center",
                va="center", color=style.INK if level.hatched else style.ink_on(level.colour),
                path_effects=style.halo() if level.hatched else None,
            )  # fmt: skip
    names = [joined(": ", (phrase(c.label), span)) for c, span in zip(
        preset.intensities, energy_labels(preset), strict=True)]  # fmt: skip
    ax.set(xlim=(0, len(preset.return_periods) + 1), ylim=(0, len(names)))
    ax.set_xticks(np.arange(len(preset.return_periods) + 1) + 0.5)
    ax.set_xticklabels([style.wrap(own, 0.6) for own in period_labels(preset.return_periods)])
    ax.set_yticks(np.arange(len(names)) + 0.5, [style.wrap(own, 0.9) for own in names])
    ax.set_xlabel("return period (years)")
    ax.tick_params(length=0)
    ax.grid(False)


def _level_plane(ax: Axes, preset: HazardPreset) -> None:
    """Draw the computed level over energy and return period."""
    limits, periods = preset.thresholds_kj, preset.return_periods
    low = limits[1] / 10.0 if len(limits) > 1 else 1.0
    energies = np.geomspace(low, 10.0 * max(limits[-1], low), _STEPS)
    last = preset.rarest_years or periods[-1]
    years = np.geomspace(periods[0] / 10.0, 3.0 * last, _STEPS)
    e, t = (own.ravel() for own in np.meshgrid(energies, years, indexing="ij"))
    levels = levels_of_events(e, t, preset).reshape(_STEPS, _STEPS)
    colours = ["white", *(class_tint(RasterClass(0, c.label, c.colour, c.hatched))
                          for c in preset.levels)]  # fmt: skip
    codes = np.arange(len(colours) + 1) - 0.5
    norm = BoundaryNorm(codes, len(colours))
    ax.pcolormesh(
        years, energies, levels, cmap=ListedColormap(colours), norm=norm, shading="nearest",
        rasterized=True, gid="levels",
    )  # fmt: skip
    ax.set(
        xscale="log", yscale="log", xlabel="return period (years)", ylabel="energy at least (kJ)"
    )
    marks = [t for t in (*periods, preset.rarest_years) if t]
    ax.set_xticks(marks, [thousands(t) for t in marks], rotation=45)
    ax.set_yticks(limits[1:], [f"{own:g}" for own in limits[1:]])
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_locator(NullLocator())
    ax.grid(False)


def _level_words(one: HazardCurves, preset: HazardPreset) -> str:
    """Return the level of the place and what decides it."""
    level = int(hazard_level(one, preset)[0])
    if not level:
        return "No block arrives here."
    energy = float(one.energies_kj[int(deciding_energy(one, preset)[0])])
    years = float(return_period(one.rate[0, one.column(energy)]))
    mean = thousands(years, 0 if years >= 10.0 else 1)
    return phrase(
        "Level: {}, from {}, once in {} years. Circles: lower energy limits of the intensity "
        "classes, which decide the level; the first (all blocks) lies at the left edge.",
        phrase(preset.levels[level - 1].label),
        phrase("blocks of {} kJ and more", f"{energy:g}")
        if energy
        else phrase("blocks of any energy"),
        mean,
    )


def _label_axes(ax: Axes, preset: HazardPreset) -> None:
    ax.set(
        xlabel="kinetic energy, translation and rotation (kJ)",
        ylabel="frequency of reaching it or more (1/year)",
    )
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(style.plain_tick)
        axis.set_minor_locator(NullLocator())
    periods = preset.return_periods
    right = ax.twinx()
    right.set(
        label="return period", ylabel="limits of return period (years)",
        yscale="log", ylim=ax.get_ylim(),
    )  # fmt: skip
    right.grid(False)
    right.set_yticks([1.0 / t for t in periods], [f"{t:g}" for t in periods])
    right.yaxis.set_minor_locator(NullLocator())
    right.spines["right"].set_visible(True)


@style.house_style()
def blocks_figure(history: Sequence[tuple[int, float]], limit: float) -> Figure:
    """Draw the share of the zoned area that another sample changes against the blocks."""
    figure = style.new_figure(style.WIDTH_IN, 2.6)
    ax = figure.subplots()
    blocks, shares = (np.array(values, np.float64) for values in zip(*history, strict=True))
    ax.axhline(100.0 * limit, color=style.VERMILION, linewidth=0.8)
    ax.plot(blocks, 100.0 * shares, "o-", color=style.BLUE, markersize=4, linewidth=1.1)
    # Room for ticks on both sides, also where the rounds are few.
    left, right = blocks[0] / 2.0, 2.0 * blocks[-1]
    ax.set(
        xscale="log", xlim=(left, right), xlabel="simulated blocks",
        ylim=(0.0, 110.0 * max(limit, *shares)), ylabel="changed by another seed (%)",
    )  # fmt: skip
    style.log_ticks(ax.xaxis, np.log10(right / left))
    ax.xaxis.set_minor_locator(NullLocator())
    return figure


def amount(value: float) -> str:
    """Write a risk with three digits: '12 300', '4.56', '1.20 × 10⁻⁵'."""
    if value == 0.0:
        return "0"
    if abs(value) >= 1000.0:
        digits = int(np.floor(np.log10(abs(value)))) - 2
        return thousands(round(value, -digits))
    if abs(value) >= 1e-3:
        return f"{value:.3g}"
    return style.times_ten(*f"{value:.2e}".split("e"))


@style.house_style()
def risk_figure(
    names: Sequence[str],
    values: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    *,
    quantity: str,
    unit: str,
    top: int = 15,
) -> Figure:
    """Draw the ``top`` objects at risk, one at least, as bars with the interval of the sample.

    ``limits`` are low and high (95 %), NaN where not known; the other objects are summed in the
    note.
    """
    order = np.argsort(-np.nan_to_num(values), kind="stable")
    order = order[values[order] > 0.0]
    chosen, rest = order[:top], order[top:]
    risk, low, high = (own[chosen] for own in (values, *limits))
    total = amount(float(np.nansum(values)))
    unit = phrase(unit)
    one, more = "Sum of all {} object: {} {}.", "Sum of all {} objects: {} {}."
    notes = [counted(values.size, one, more, thousands(values.size), total, unit)]
    if rest.size:
        less = amount(float(values[rest].sum()))
        one = "Not drawn: {} object of lower risk ({} {})."
        more = "Not drawn: {} objects of lower risk ({} {} in all)."
        notes.append(counted(rest.size, one, more, thousands(rest.size), less, unit))
    known = np.isfinite(high)
    if known.any():
        text = "Thin lines: 95 % intervals of the sampling error."
        notes.append(phrase(text))
    title = {"loss": "Loss by object", "deaths": "Deaths by object"}[quantity]
    labels = [style.wrap(names[i], 1.9) for i in chosen]
    heights = [0.13 * style.lines_in(label) + 0.1 for label in labels]
    sheet = style.Sheet(title, joined(" ", notes), max(sum(heights), 0.8) + 0.4)
    ax = sheet.figure.subplots()
    ax.set_label("risk")
    exponent = min(0, 3 * int(np.floor(np.log10(risk.max()) / 3.0)))
    power = f"{power_of_ten(exponent)} " if exponent else ""
    ax.set_xlabel(phrase("{} ({}{})", phrase(quantity), power, unit))
    ax.xaxis.set_major_formatter(partial(_risk_tick, exponent))
    edges = np.cumsum([0.0, *heights])
    middle = (edges[:-1] + edges[1:]) / 2.0
    ax.barh(middle, risk, height=0.14, color=style.BLUE, alpha=0.75, zorder=2, gid="bars")
    ax.hlines(
        middle[known], low[known], high[known], color=style.INK, lw=0.9, zorder=3, gid="intervals"
    )
    ends = np.where(known, high, risk)
    for y, value, end in zip(middle, risk, ends, strict=True):
        text = amount(float(value))
        style.beside(
            ax, text, (float(end), y), (4, 0), va="center", ha="left", color=style.INK, gid="value"
        )
    ax.set(xlim=(0.0, 1.2 * ends.max()), ylim=(edges[-1], 0.0))
    ax.set_yticks(middle, labels)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(True)
    return sheet.figure


def _risk_tick(exponent: int, value: float, _: object) -> str:
    return thousands(value) if value >= 1e3 else f"{value / 10.0**exponent:g}"


#: Columns of places_table that a figure of protection shows.
PLACES_SHOWN = (
    "moved_m",
    "share",
    *(f"{key}{end}" for key in ("energy_q95_kj", "height_q95_m") for end in ("", "_low", "_high")),
)
#: Frequencies this much rarer than the longest return period are not drawn.
_RARER = 5.0


@style.house_style()
def protection_figure(
    places: Mapping[str, FloatArray],
    before: Arrivals,
    behind: Arrivals | None,
    return_periods_years: Sequence[float],
    *,
    capacity_kj: float,
    confidence: float,
) -> Figure:
    """Draw energies before and behind a line by frequency, and what reaches copies of the line.

    ``places`` are PLACES_SHOWN of its rows of places_table; with a single one the second part is
    left out.
    """
    along = len(places["moved_m"]) > 1
    figure = style.new_figure(style.WIDTH_IN, 2.9)
    grid = figure.add_gridspec(2, 2 if along else 1, height_ratios=(2.2, 1.0))
    ax = figure.add_subplot(grid[:, 0])
    least = 1.0 / max(return_periods_years) / _RARER
    for curve, colour, name in (
        (before, style.BLUE, "arriving, without barriers"),
        (behind, style.VERMILION, "passing the barrier"),
    ):
        if curve is None:
            continue
        # The first bin holds blocks that a barrier takes.
        known = slice(1, None)
        low, high = (end.rate[known] for end in curve.limits(confidence))
        energy, rate = curve.edges[known], curve.rate[known]
        ax.fill_between(energy, low, high, where=high > 0, color=colour, alpha=0.18, lw=0.0)
        ax.plot(energy[rate > 0.0], rate[rate > 0.0], color=colour, lw=1.3, label=name)
    most = float(before.rate[1])
    shown = before.edges[1:][before.rate[1:] >= min(0.9 * most, least)]
    ends = (before.largest, capacity_kj)
    right = max([10.0, *(e for e in ends if np.isfinite(e))])
    ax.set(
        xscale="log", xlim=(max(1.0, shown.min(initial=1.0)), 1.6 * right),
        xlabel="energy at least (kJ)",
        yscale="log", ylim=(least, max(2.0 * most, 10.0 * least)), ylabel="blocks a year",
    )  # fmt: skip
    for years in return_periods_years:
        ax.axhline(1.0 / years, color=style.LIGHT, lw=0.8, zorder=0.5)
        style.beside(
            ax, phrase("{} years", f"{years:g}"), (ax.get_xlim()[1], 1.0 / years), (-3, 2),
            ha="right", color=style.GREY, path_effects=style.halo(),
        )  # fmt: skip
    if np.isfinite(capacity_kj):
        ax.axvline(
            capacity_kj, color=style.INK, lw=0.9, ls="--", label=phrase("capacity of the net")
        )
    left, right = ax.get_xlim()
    style.log_ticks(ax.xaxis, np.log10(right / left))
    ax.yaxis.set_major_formatter(style.plain_tick)
    ax.yaxis.set_minor_locator(NullLocator())
    if ax.get_legend_handles_labels()[0]:
        figure.legend(fontsize=style.SMALL, loc="outside lower left", ncols=3, frameon=False)
    if along:
        upper = figure.add_subplot(grid[0, 1])
        _draw_along(upper, figure.add_subplot(grid[1, 1], sharex=upper), places)
    return figure


def _draw_along(upper: Axes, lower: Axes, places: Mapping[str, FloatArray]) -> None:
    """Draw 95 % energy and passing height, and the share of the blocks that comes so far."""
    moved = places["moved_m"]
    other = upper.twinx()
    for ax, key, colour, name, marks in (
        (upper, "energy_q95_kj", style.BLUE, "energy, 95 % (kJ)", "o-"),
        (other, "height_q95_m", style.VERMILION, "passing height, 95 % (m)", "s--"),
    ):
        value, low, high = (places[key + end] for end in ("", "_low", "_high"))
        ax.fill_between(moved, low, high, color=colour, alpha=0.15, lw=0.0)
        ax.plot(moved, value, marks, color=colour, ms=3.0, lw=1.1)
        # A long label on the right may go down beside the lower panel.
        ax.set_ylabel(name, color=colour, size=style.SMALL, loc="center" if ax is upper else "top")
        if ax is upper:
            ax.yaxis.set_major_formatter(style.thousands_formatter())
        ax.set_ylim(0.0, 1.15 * float(np.nanmax([*value, *high, 1e-9])))
    other.spines["right"].set_visible(True)
    upper.tick_params(labelbottom=False)
    lower.bar(moved, 100.0 * places["share"], 7.0, color=style.GREY)
    lower.set_ylabel("blocks (%)", size=style.SMALL)
    lower.set_xlabel("line moved: upslope (−), downslope (+) (m)")
    lower.set_xticks(moved)
    for ax in (upper, lower):
        ax.axvline(0.0, color=style.INK, lw=0.7, zorder=0.4)


_PALE = 0.65


def _class_maps(
    grid: Grid,
    panels: Sequence[map_figure.MapPanel],
    signs: Sequence[Patch],
    marks: MapMarks,
    title: str,
    *,
    note: str = "",
    columns: int = 0,
) -> Figure:
    """Draw maps of classes: one with its legend next to it, several with it below them."""
    values = [panel.values for panel in panels if panel.values is not None]
    seen = np.where(np.any(np.isfinite(values), axis=0), 1.0, np.nan)
    view = view_of(grid, footprint(grid, seen, all_points(marks.release)))
    notes = [note, marks.key(view.box), map_figure.coarse_note(view, "highest class")]
    sheet, axes = map_figure.draw_maps(view, panels, marks, title, notes, columns=columns)
    if len(panels) == 1:
        map_figure.legend_beside(axes[0], signs, "")
    else:
        sheet.legend(signs)
    return map_figure.finish(sheet, axes, marks, view)


@style.house_style()
def intensity_figure(grid: Grid, layers: Sequence[RasterLayer], marks: MapMarks) -> Figure:
    """Draw maps of the classes of the first side by side, each below its title."""
    panels = [
        map_figure.class_panel(layer.bands[0].values, layer.classes, layer.title)
        for layer in layers
    ]
    signs = map_figure.class_signs(layers[0].classes)
    return _class_maps(grid, panels, signs, marks, "Intensity by return period")


@style.house_style()
def confidence_figure(
    grid: Grid, level: RasterLayer, uncertain: NDArray[np.bool_], marks: MapMarks
) -> Figure:
    """Draw the hazard level, with fine black lines over the cells whose level is uncertain."""
    values, classes = level.bands[0].values, level.classes
    panel = map_figure.class_panel(values, classes, level.title, over=uncertain, alpha=_PALE)
    assert panel.values is not None
    reached = np.isfinite(panel.values)
    share = int((uncertain & reached).sum()) / max(int(reached.sum()), 1)
    text = "Statistically uncertain: {} % of the cells that have a level."
    note = phrase(text, f"{100.0 * share:.1f}")
    signs = map_figure.class_signs(classes, "statistically uncertain")
    title = "Levels that another random seed may change"
    return _class_maps(grid, [panel], signs, marks, title, note=note)


def level_changes(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the change of positions among classes (-1, 0, 1); NaN, below all, without any."""
    old, new = np.nan_to_num(before, nan=-1.0), np.nan_to_num(after, nan=-1.0)
    return np.where((old < 0.0) & (new < 0.0), np.nan, np.sign(new - old))


@style.house_style()
def change_figure(
    grid: Grid,
    before: RasterLayer,
    after: RasterLayer,
    marks: MapMarks,
    *,
    names: tuple[str, str] = ("Without barriers", "With barriers"),
    title: str = "Hazard level without and with barriers",
) -> Figure:
    """Draw two maps of the same classes, and where the level became lower or higher."""
    classes = before.classes
    positions = [
        map_figure.class_positions(layer.bands[0].values, classes) for layer in (before, after)
    ]
    change = level_changes(*positions)
    kinds = tuple(
        RasterClass(number, *LEVEL_CHANGES[code])
        for number, code in ((-1, "lower"), (0, "same"), (1, "higher"))
    )
    area = grid.cell_size**2
    changes = [thousands(np.count_nonzero(change == kind.value) * area) for kind in kinds]
    panels = [
        map_figure.class_panel(before.bands[0].values, classes, names[0]),
        map_figure.class_panel(after.bands[0].values, classes, names[1]),
        map_figure.class_panel(change, kinds, "Change"),
    ]
    signs = [*map_figure.class_signs(classes), *map_figure.class_signs(kinds)]
    text = "Lower level: {} m²; same level: {} m²; higher level: {} m²."
    note = phrase(text, *changes)
    # In one row they are as legible on a sheet of A4 as in a report.
    return _class_maps(grid, panels, signs, marks, title, note=note, columns=3)


@style.house_style()
def map_change_figure(
    grid: Grid,
    before: FloatArray,
    after: FloatArray,
    change: FloatArray,
    marks: MapMarks,
    *,
    unit: str,
    ramp: str,
    title: str,
) -> Figure:
    """Draw a map before and after, and the difference; NaN where no block comes.

    The unit is empty for shares, which are drawn in per cent; ``ramp`` colours the first two.
    """
    scale = 1.0 if unit else 100.0
    view = view_of(grid, footprint(grid, change, all_points(marks.release)))
    known = np.concatenate([scale * m[np.isfinite(m)] for m in (before, after)])
    # One cell must not take all the colour; the bar says that it is cut.
    high = (float(np.quantile(known, 0.995)) if known.size else 0.0) or 1.0
    moved = np.abs(scale * change[np.isfinite(change)])
    moved = moved[moved > 0.0]
    most = float(np.quantile(moved, 0.98)) if moved.size else 1.0
    amounts = (mpl.colormaps[ramp], Normalize(0.0, high))
    changes = (style.GAP_COLOURS, Normalize(-most, most))
    panels = [
        map_figure.MapPanel(scale * values, *colours, name, alpha=0.9, together="mean")
        for name, values, colours in (
            ("Before", before, amounts),
            ("After", after, amounts),
            ("After less before", change, changes),
        )
    ]
    sheet, axes = map_figure.draw_maps(view, panels, marks, title, [marks.key(view.box)], columns=3)
    below = {"location": "bottom", "shrink": 0.9}
    map_figure.colour_bar(axes[:2], panels[0], unit or "%", extend="max", **below)
    words = phrase("change ({})", phrase(unit or "percentage points"))
    map_figure.colour_bar(axes[2:], panels[2], words, extend="both", **below)
    return map_figure.finish(sheet, axes, marks, view)
