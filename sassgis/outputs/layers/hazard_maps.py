"""The hazard maps, from the hazard curves of the cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray, Grid
from sassgis.hazard.curves import at_energies, energy_at, rate_interval, return_period
from sassgis.hazard.levels import energy_labels, intensity_class, preset_unverified
from sassgis.hazard.sampling_error import LevelChances, rocks_factor
from sassgis.outputs.layers.maps import described_band, described_raster, level_classes, on_grid
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import Band, RasterClass, RasterLayer
from sassgis.settings.statistics_table import ENERGY_BREAKS, ENERGY_RAMP

#: Colours of "statistically certain" and "uncertain".
_CERTAIN, _UNCERTAIN = "#b8c4c2", "#d6721f"


#: Makes a band of a map from the values of the cells of the curves.
_Banding = Callable[..., Band]


def hazard_layers(
    curves: HazardCurves,
    chances: LevelChances,
    preset: HazardPreset,
    grid: Grid,
    ref_width_m: float,
    *,
    return_periods: Sequence[float],
    confidence: float = 0.95,
) -> tuple[RasterLayer, ...]:
    """Map level and its certainty, intensity, energy, return period and frequency.

    Cells that no block reaches, or not as often, are NaN; but another sample may give a level to
    some that this one does not reach. The thresholds of the preset are among the energies of the
    curves. Return periods (years) are ascending; all frequencies are for the reference width (m).
    """
    few = at_energies(curves, preset.thresholds_kj)

    def band(key: str, column: str, values: NDArray[Any], name: str = "", **words: Any) -> Band:
        known = np.where(np.isfinite(values), values, np.nan)
        return described_band(key, column, on_grid(known, curves.places, grid.shape), name, **words)

    words = _words(preset, ref_width_m, confidence)
    periods = [
        band("return_period", "t", t, f"t{e:g}", of_energy=_of_energy(e))
        for e, t in zip(few.energies_kj, return_period(few.rate).T, strict=True)
    ]
    breaks = (0.0, *preset.return_periods)
    return (
        _level(chances, preset, grid.shape, words),
        *(_intensity(band, few, preset, years, words) for years in (*return_periods, None)),
        _energy(band, curves, preset, return_periods, words),
        described_raster("return_period", periods, breaks, "plasma", **words),
        _frequency(band, few, preset, confidence, words),
        _confidence(
            band=band,
            few=few,
            preset=preset,
            chances=chances,
            shape=grid.shape,
            confidence=confidence,
            words=words,
        ),
    )


def _words(preset: HazardPreset, ref_width_m: float, confidence: float) -> dict[str, Any]:
    """Return what the notes of all maps say."""
    percent = f"{100.0 * confidence:g} %"
    named = phrase("Preset {} ({}).", preset.name, phrase(preset.title))
    return {
        "percent": percent,
        "frequencies": phrase(
            "Annual frequency: onset frequency times the share of the simulated blocks that "
            "reach the cell, summed over release areas and block scenarios. Reference width "
            "{} m.",
            f"{ref_width_m:.4g}",
        ),
        "rules": joined(" ", [named, *preset_unverified(preset)]),
        "sampled": phrase(
            "{} intervals cover the sampling of blocks. They do not cover errors of the "
            "model, its parameters or the onset frequency.",
            percent,
        ),
    }


def _codes(codes: NDArray[np.int16]) -> FloatArray:
    return np.where(codes > 0, codes, np.nan)


def _level(
    chances: LevelChances, preset: HazardPreset, shape: tuple[int, int], words: dict[str, Any]
) -> RasterLayer:
    """Return the map of the level, which the assessment computed."""
    level = _codes(chances.level)
    bands = [described_band("hazard_level", "level", on_grid(level, chances.places, shape))]
    return described_raster("hazard_level", bands, classes=level_classes(preset), **words)


def _intensity(
    band: _Banding,
    few: HazardCurves,
    preset: HazardPreset,
    years: float | None,
    words: Mapping[str, Any],
) -> RasterLayer:
    """Map the intensity of a return period, or of the extreme event."""
    if years is None:
        stem, when = "intensity_extreme", phrase("extreme event")
        what = phrase(
            "Highest intensity class of the simulated blocks that are frequent enough for a level."
        )
    else:
        stem, when = f"intensity_{years:g}", phrase("return period {} years", f"{years:g}")
        what = phrase(
            "Highest intensity class whose lower energy limit is reached or exceeded at least "
            "once in {} years.",
            f"{years:g}",
        )
    codes = _codes(intensity_class(few, preset, years))
    labels = zip(preset.intensities, energy_labels(preset), strict=True)
    classes = [
        RasterClass(i, phrase("{} ({})", phrase(c.label), phrase(span)), c.colour)
        for i, (c, span) in enumerate(labels, start=1)
    ]
    bands = [band("intensity", "intensity", codes, when=when)]
    more = {"what": what, "when": when, **words}
    return described_raster("intensity", bands, classes=classes, stem=stem, **more)


def _energy(
    band: _Banding,
    curves: HazardCurves,
    preset: HazardPreset,
    return_periods: Sequence[float],
    words: Mapping[str, Any],
) -> RasterLayer:
    """Map the energy; the longest return period is the first band, the one shown."""
    periods = (*return_periods[-1:], *return_periods[:-1])
    key, energies = "energy_at_return_period", curves.energies_kj
    bands = [band(key, "e", energy_at(curves, t), f"e{t:g}", years=t) for t in periods]
    once = phrase(" once in {} years", f"{periods[0]:g}") if periods else ""
    ends = {"count": energies.size, "first": energies[0], "last": energies[-1]}
    breaks = sorted({*ENERGY_BREAKS, *preset.thresholds_kj[1:]})
    return described_raster(key, bands, breaks, ENERGY_RAMP, once=once, **ends, **words)


def _frequency(
    band: _Banding,
    few: HazardCurves,
    preset: HazardPreset,
    confidence: float,
    words: Mapping[str, Any],
) -> RasterLayer:
    lower, upper = rate_interval(few, confidence)
    error, reached = np.sqrt(few.variance), few.rate[:, 0] > 0.0
    values = {"rate": few.rate, "standard_error": error, "lower": lower, "upper": upper}
    bands = [
        band(
            "frequency",
            column,
            np.where(reached, of_all[:, i], np.nan),
            f"{column}_{energy:g}",
            of_energy=_of_energy(energy),
        )
        for i, energy in enumerate(few.energies_kj)
        for column, of_all in values.items()
    ]
    limits = sorted(1.0 / t for t in preset.return_periods)
    breaks = (0.0, 0.1 * limits[0], *limits, 10.0 * limits[-1])
    return described_raster("frequency", bands, breaks, "plasma_r", **words)


def _confidence(
    band: _Banding,
    few: HazardCurves,
    preset: HazardPreset,
    chances: LevelChances,
    shape: tuple[int, int],
    confidence: float,
    words: Mapping[str, Any],
) -> RasterLayer:
    """Map how sure the level is, also where only another sample would come."""
    factor = rocks_factor(few, preset, chances, confidence)
    factor = np.where((few.rate[:, 0] > 0.0) & np.isfinite(factor), factor, np.nan)
    seen = (chances.level > 0) | (chances.changed > 0.0)
    lowest, highest = (_codes(k) for k in chances.interval(confidence))
    values = {
        "uncertain": np.where(seen, chances.uncertain(confidence), np.nan),
        "change_chance": np.where(seen, chances.changed, np.nan),
        "lowest_level": lowest,
        "highest_level": highest,
    }
    key = "confidence"
    bands = [
        described_band(key, name, on_grid(own, chances.places, shape))
        for name, own in values.items()
    ]
    classes = (
        RasterClass(0, "statistically certain", _CERTAIN),
        RasterClass(1, "statistically uncertain", _UNCERTAIN),
    )
    levels = enumerate(preset.levels, start=1)
    codes = joined("; ", (phrase("{} = {}", k, phrase(level.label)) for k, level in levels))
    bands.append(band(key, "rocks_factor", factor))
    return described_raster(key, bands, classes=classes, codes=codes, **words)


def _of_energy(energy_kj: float) -> str:
    if energy_kj == 0.0:
        return phrase("of any energy")
    return phrase("of {} kJ and more", f"{energy_kj:g}")
