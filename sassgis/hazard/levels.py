"""Intensity classes and hazard levels from hazard curves; their words and styles on maps.

Codes: 0 is "not reached"; intensity 1 and level 1 are the weakest of the preset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.hazard.curves import at_energies, meets
from sassgis.settings.hazard_rules import HazardCurves, HazardLevel, HazardPreset, Provenance
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import thousands
from sassgis.settings.styles import StyleClass, Symbol, VectorStyle

#: What a sheet shows.
Shown = Literal["level", "intensity", "risk"]
#: Standard deviations beyond which neighbours do not count.
_TRUNCATED = 2.5


class CellWindow(NamedTuple):
    """A part of a grid around some cells."""

    rows: slice
    cols: slice
    cells: IntArray  # flat indices in the part

    def map_of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return a map of the part with the values of the cells, 0 elsewhere."""
        shape = self.rows.stop - self.rows.start, self.cols.stop - self.cols.start
        out = np.zeros(shape, values.dtype)
        out.ravel()[self.cells] = values
        return out


def intensity_class(
    curves: HazardCurves, preset: HazardPreset, years: float | None
) -> NDArray[np.int16]:
    """Find the strongest intensity class reached at least once in a return period T (years).

    A class is met if λ(E >= its lower limit) >= 1/T, the lowest class if blocks arrive that often
    at all. Without ``years`` it is that of the extreme event: whatever is not rarer than the
    preset's ``rarest_years``. 0 where blocks arrive less often, else the class's position plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    met = _counts(rate, preset) if years is None else meets(rate, years)
    codes = np.where(met, np.arange(1, rate.shape[1] + 1, dtype=np.int16), np.int16(0))
    strongest: NDArray[np.int16] = codes.max(axis=1, initial=0)
    return strongest


def _counts(rate: FloatArray, preset: HazardPreset) -> NDArray[np.bool_]:
    """Return whether a rate is high enough for any level."""
    some: NDArray[np.bool_] = rate > 0.0
    return some if preset.rarest_years is None else some & meets(rate, preset.rarest_years)


def levels_of_rates(rate: FloatArray, preset: HazardPreset) -> NDArray[np.int16]:
    """Find the level of each matrix field that a place's rates meet, shape (n, n_intensities).

    Rates are λ(E >= lower limit of each class of intensity) per year, in the same shape. The field
    is that of class i and the class of return period of T = 1/λ_i, whose limit belongs to it (T <=
    30); the level is 0 where λ_i is 0, or T is beyond the preset's ``rarest_years``.
    """
    out = np.zeros(rate.shape, np.int16)
    for i, row in enumerate(preset.matrix):
        beyond = np.zeros(rate.shape[0], np.int64)
        for limit in preset.return_periods:
            beyond += ~meets(rate[:, i], limit)
        out[:, i] = np.where(_counts(rate[:, i], preset), np.asarray(row)[beyond] + 1, 0)
    return out


def levels_of_events(
    energy_kj: FloatArray, years: FloatArray, preset: HazardPreset
) -> NDArray[np.int16]:
    """Find the level of places that blocks of one energy reach once in so many years.

    0 where it is too rare for any level, else the level's position in the preset plus 1.
    """
    met = energy_kj[:, None] >= np.array(preset.thresholds_kj)
    rate = np.where(met, 1.0 / years[:, None], 0.0)
    highest: NDArray[np.int16] = levels_of_rates(rate, preset).max(axis=1)
    return highest


def hazard_level(curves: HazardCurves, preset: HazardPreset) -> NDArray[np.int16]:
    """Find the hazard level of each place: the highest of the matrix that its curve crosses.

    Along the curve the rate falls as the energy rises, so within a class of intensity its lower
    limit has the highest level: only the thresholds decide, which are among the energies. 0 where
    no block arrives, or too rarely for any level, else the level's position in the preset plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    highest: NDArray[np.int16] = levels_of_rates(rate, preset).max(axis=1, initial=0)
    return highest


def deciding_energy(curves: HazardCurves, preset: HazardPreset) -> IntArray:
    """Return the column of the energy that gave each place its level; -1 where there is none.

    It is the lower limit of the weakest class of intensity that gives the level.
    """
    columns = np.array([curves.column(e) for e in preset.thresholds_kj], np.int64)
    levels = levels_of_rates(curves.rate[:, columns], preset)
    # argmax takes the first of equal levels, which is the weakest class.
    return np.where(levels.max(axis=1, initial=0) > 0, columns[levels.argmax(axis=1)], -1)


def limits_of_levels(preset: HazardPreset) -> FloatArray:
    """Compute the least rate (1/year) of each class that gives each level or a higher one.

    Infinite where the class never gives it, 0 where any block does; shape (n_levels,
    n_intensities).
    """
    last = 0.0 if preset.rarest_years is None else 1.0 / preset.rarest_years
    rates = np.array([*(1.0 / t for t in preset.return_periods), last])
    matrix = np.asarray(preset.matrix)
    return np.array(
        [np.where(matrix >= k, rates, np.inf).min(axis=1) for k in range(len(preset.levels))]
    )


def window_of(cells: IntArray, shape: tuple[int, int], margin: int = 0) -> CellWindow:
    """Return the rows and columns of a grid around some cells, and the cells' indices there."""
    row, col = np.divmod(cells if cells.size else np.zeros(1, np.int64), shape[1])

    def around(own: IntArray, n: int) -> slice:
        return slice(max(int(own.min()) - margin, 0), min(int(own.max()) + margin + 1, n))

    rows, cols = around(row, shape[0]), around(col, shape[1])
    flat = (row - rows.start) * (cols.stop - cols.start) + col - cols.start
    return CellWindow(rows, cols, flat[: cells.size])


def cells_within_limit(
    curves: HazardCurves, preset: HazardPreset, grid: Grid, width_m: float
) -> BoolArray:
    """Find places around which blocks arrive at least as often as the rarest event of a preset.

    The frequency is the mean around a place, weighted by a normal density that has the standard
    deviation of a disk of this width along each axis. So single paths do not shape the limit. Only
    places that a block reached are within it. With a width of 0 no place is.
    """
    if preset.rarest_years is None or width_m == 0.0 or not curves.places.size:
        return np.zeros(curves.places.size, np.bool_)
    window = window_of(curves.places, grid.shape)
    # The sum of each cell is made in the same order wherever the raster begins.
    mean = ndimage.gaussian_filter(
        window.map_of(curves.rate[:, 0]),
        width_m / 4.0 / grid.cell_size,
        mode="constant",
        truncate=_TRUNCATED,
    )
    reached: BoolArray = curves.rate[:, 0] > 0.0
    return reached & meets(mean.ravel()[window.cells], preset.rarest_years)


def period_labels(return_periods: Sequence[float]) -> tuple[str, ...]:
    """Name the classes of return period: "up to 30", "30 to 100", ..., "beyond 300" (years)."""
    limits = [f"{t:g}" for t in return_periods]
    between = [phrase("{} to {}", a, b) for a, b in pairwise(limits)]
    return (phrase("up to {}", limits[0]), *between, phrase("beyond {}", limits[-1]))


def energy_labels(preset: HazardPreset) -> tuple[str, ...]:
    """Return spans of energy of the classes of intensity: "below 30 kJ", ..., "300 kJ and more"."""
    limits = [f"{e:g}" for e in preset.thresholds_kj]
    if len(limits) == 1:
        return (phrase("any energy"),)
    between = [phrase("{} to {} kJ", a, b) for a, b in pairwise(limits[1:])]
    return (phrase("below {} kJ", limits[1]), *between, phrase("{} kJ and more", limits[-1]))


def preset_unverified(preset: HazardPreset) -> list[str]:
    """List values of a preset that were not read in its source: a warning for each source."""
    return [
        phrase(
            "Preset {}, unverified: {}. {}.",
            preset.name,
            joined(", ", what),
            phrase(source.rstrip(".")),
        )
        for source, what in _unverified(preset).items()
    ]


def unverified_in_short(preset: HazardPreset, shown: Shown = "level") -> list[str]:
    """Return what of it decides a sheet, without the sources: one text, or none."""
    what = [text for own in _unverified(preset, shown).values() for text in own]
    text = "Preset {}, unverified: {}. See the report."
    return [phrase(text, preset.name, joined(", ", what))] if what else []


def _unverified(preset: HazardPreset, shown: Shown = "level") -> dict[str, list[str]]:
    """Return unverified values by the text of their source, each in words.

    Those of all rules, which decide the level; or those that decide intensities, or risk.
    """
    periods = ", ".join(f"{t:g}" for t in preset.return_periods)
    values = [(phrase("intensity {}", phrase(c.label)), c.provenance) for c in preset.intensities]
    if shown == "risk":
        return _by_source(values)
    values.append((phrase("return periods {} years", periods), preset.return_period_provenance))
    if preset.rarest_provenance is not None and preset.rarest_years is not None:
        beyond = phrase("no level beyond {} years", thousands(preset.rarest_years))
        values.append((beyond, preset.rarest_provenance))
    if preset.sheet is not None:
        least = phrase(
            "zones of at least {} mm and {} mm² on the sheet",
            f"{preset.sheet.width_mm:g}",
            f"{preset.sheet.area_mm2:g}",
        )
        values.append((least, preset.sheet.provenance))
    if shown == "intensity":
        return _by_source(values)
    values += [(phrase("level {}", phrase(c.label)), c.provenance) for c in preset.levels]
    by_source = _by_source(values)
    for source, text in _unverified_fields(preset).items():
        by_source.setdefault(source, []).append(text)
    return by_source


def _by_source(values: Sequence[tuple[str, Provenance]]) -> dict[str, list[str]]:
    """Return unverified values by the text of their source."""
    found: dict[str, list[str]] = {}
    for what, provenance in values:
        if not provenance.verified:
            found.setdefault(provenance.source, []).append(what)
    return found


def _unverified_fields(preset: HazardPreset) -> dict[str, str]:
    """Return unverified fields of the matrix in a few words, by their source."""
    fields = [
        (phrase("{} {} years", intensity.code, period), provenance)
        for intensity, row in zip(preset.intensities, preset.matrix_provenance, strict=True)
        for period, provenance in zip(period_labels(preset.return_periods), row, strict=True)
    ]
    words: dict[str, str] = {}
    for source, own in _by_source(fields).items():
        if len(own) == len(fields):
            words[source] = phrase("the whole matrix")
        elif 2 * len(own) > len(fields):
            words[source] = phrase("{} of {} fields of the matrix", len(own), len(fields))
        else:
            words[source] = phrase("matrix {}", joined(", ", own))
    return words


#: Opacity of zones: terrain and layers below remain visible.
ZONE_OPACITY = 0.7
_ZONE = Symbol("fill", "#808080", opacity=ZONE_OPACITY, outline="#4d4d4d", outline_mm=0.25)

#: How barriers change the level of a place: label and colour. Green and purple differ in all common
#: kinds of colour vision, and no level has them.
LEVEL_CHANGES: Mapping[str, tuple[str, str]] = {
    "lower": ("Lower level", "#7fbf7b"),
    "same": ("Same level", "#f7f7f7"),
    "higher": ("Higher level", "#762a83"),
}


def zone_symbol(colour: str, *, hatched: bool = False) -> Symbol:
    """Return the sign of a zone: filled, or striped on white if hatched."""
    if not hatched:
        return replace(_ZONE, colour=colour)
    return replace(
        _ZONE, colour=colour, hatch="diagonal", hatch_mm=0.9, hatch_step_mm=2.0, ground="#ffffff"
    )


def hazard_level_style(column: str, levels: Sequence[HazardLevel]) -> VectorStyle:
    """Return zones in the colours of their hazard level, the most severe first in the legend.

    ``column`` holds the code of the level; ``levels`` are from low to high.
    """
    return zone_style(column, [(v.code, v.label, v.colour, v.hatched) for v in levels])


def level_change_style(column: str) -> VectorStyle:
    """Return areas by how barriers change their level: the codes of :data:`LEVEL_CHANGES`."""
    changes = LEVEL_CHANGES.items()
    return zone_style(column, [(code, label, colour, False) for code, (label, colour) in changes])


def uncertain_style() -> VectorStyle:
    """Return fine black lines over uncertain places, falling across the stripes of levels."""
    return VectorStyle(
        Symbol(
            "fill", "#000000", opacity=0.8, outline="#000000", outline_mm=0.15, hatch="falling",
            hatch_mm=0.15, hatch_step_mm=1.4,
        )
    )  # fmt: skip


def zone_style(column: str, entries: Sequence[tuple[str, str, str, bool]]) -> VectorStyle:
    """Make a sign per code, the last first; entries: code, label, ``#rrggbb``, hatched."""
    return VectorStyle(
        symbol=_ZONE,
        method="categories",
        column=column,
        classes=tuple(
            StyleClass(label, zone_symbol(colour, hatched=hatched), value=code)
            for code, label, colour, hatched in reversed(entries)
        ),
    )


def opaque(style: VectorStyle) -> VectorStyle:
    """Return the same style, opaque."""
    return replace(
        style,
        symbol=replace(style.symbol, opacity=1.0),
        classes=tuple(replace(c, symbol=replace(c.symbol, opacity=1.0)) for c in style.classes),
    )
