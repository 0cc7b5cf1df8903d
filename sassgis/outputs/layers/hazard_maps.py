"""The hazard maps, from the hazard curves of the cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray, Grid
from sassgis.hazard.curves import at_energies, energy_at, rate_interval, return_period
from sassgis.hazard.levels import intensity_class
from sassgis.hazard.preset_labels import energy_labels, preset_unverified
from sassgis.hazard.sampling_error import LevelChances, rocks_factor
from sassgis.outputs.layers.maps import Place, described_band, described_raster, level_classes
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import Band, RasterClass, RasterLayer

#: Colours of "statistically certain" and "uncertain".
_CERTAIN, _UNCERTAIN = "#b8c4c2", "#d6721f"


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

    Cells to which a statement does not apply are NaN: those that no block reaches, or not as often;
    but another sample may give a level to some that this one does not reach.
    The thresholds of the preset are among the energies of the curves. Intensity and energy are
    mapped for the return periods (years, ascending), all frequencies for the reference width (m);
    ``confidence`` is that of the intervals, ``chances`` are those of the curves.
    """
    maker = _Maker(curves, preset, grid, ref_width_m, confidence)
    return (
        maker.level(chances),
        *(maker.intensity(years) for years in return_periods),
        maker.intensity(None),
        maker.energy(return_periods),
        maker.return_period(),
        maker.frequency(),
        maker.confidence(chances),
    )


class _Maker:
    """The layers one by one; what they share is computed once."""

    def __init__(
        self,
        curves: HazardCurves,
        preset: HazardPreset,
        grid: Grid,
        ref_width_m: float,
        confidence: float,
    ) -> None:
        self._curves = curves
        self._few = at_energies(curves, preset.thresholds_kj)
        self._reached = self._few.rate[:, 0] > 0.0
        self._preset = preset
        self._place = Place(curves.places, grid.shape)
        self._confidence = confidence
        percent = f"{100.0 * confidence:g} %"
        named = phrase("Preset {} ({}).", preset.name, phrase(preset.title))
        self._words: dict[str, Any] = {
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

    def level(self, chances: LevelChances) -> RasterLayer:
        key, place = "hazard_level", Place(chances.places, self._place.shape)
        values = place.map_of(np.where(chances.level > 0, chances.level, np.nan))
        bands = [described_band(key, "level", values)]
        return described_raster(key, bands, classes=level_classes(self._preset), **self._words)

    def intensity(self, years: float | None) -> RasterLayer:
        if years is None:
            stem, when = "intensity_extreme", phrase("extreme event")
            what = phrase(
                "Strongest class of intensity of any simulated block that is not too rare for a "
                "level."
            )
        else:
            stem, when = f"intensity_{years:g}", phrase("return period {} years", f"{years:g}")
            what = phrase(
                "Strongest class of intensity whose lower limit of energy is reached or exceeded "
                "at least once in {} years.",
                f"{years:g}",
            )
        key, codes = "intensity", intensity_class(self._few, self._preset, years)
        labels = zip(self._preset.intensities, energy_labels(self._preset), strict=True)
        return described_raster(
            key,
            [self._classes(key, key, codes, when=when)],
            classes=[
                RasterClass(i, phrase("{} ({})", phrase(c.label), phrase(span)), c.colour)
                for i, (c, span) in enumerate(labels, start=1)
            ],
            stem=stem,
            what=what,
            when=when,
            **self._words,
        )

    def energy(self, return_periods: Sequence[float]) -> RasterLayer:
        # The longest return period is the first band, the one shown: it reaches farthest.
        periods = (*return_periods[-1:], *return_periods[:-1])
        key, energies = "energy_at_return_period", self._curves.energies_kj
        return described_raster(
            key,
            [
                self._band(key, "e", energy_at(self._curves, years), f"e{years:g}", years=years)
                for years in periods
            ],
            (0.0, *self._preset.thresholds_kj[1:]),
            "YlOrRd",
            once=phrase(" once in {} years", f"{periods[0]:g}") if periods else "",
            count=energies.size,
            first=energies[0],
            last=energies[-1],
            **self._words,
        )

    def return_period(self) -> RasterLayer:
        key, years = "return_period", return_period(self._few.rate)
        bands = [
            self._band(key, "t", t, f"t{e:g}", of_energy=_of_energy(e))
            for e, t in zip(self._few.energies_kj, years.T, strict=True)
        ]
        breaks = (0.0, *self._preset.return_periods)
        return described_raster(key, bands, breaks, "plasma", **self._words)

    def frequency(self) -> RasterLayer:
        lower, upper = rate_interval(self._few, self._confidence)
        error = np.sqrt(self._few.variance)
        values = {"rate": self._few.rate, "standard_error": error, "lower": lower, "upper": upper}
        bands = [
            self._band(
                "frequency",
                column,
                np.where(self._reached, of_all[:, i], np.nan),
                f"{column}_{energy:g}",
                of_energy=_of_energy(energy),
            )
            for i, energy in enumerate(self._few.energies_kj)
            for column, of_all in values.items()
        ]
        limits = sorted(1.0 / t for t in self._preset.return_periods)
        breaks = (0.0, 0.1 * limits[0], *limits, 10.0 * limits[-1])
        return described_raster("frequency", bands, breaks, "plasma_r", **self._words)

    def confidence(self, chances: LevelChances) -> RasterLayer:
        factor = rocks_factor(self._few, self._preset, chances, self._confidence)
        factor = np.where(self._reached & np.isfinite(factor), factor, np.nan)
        # Another sample may come where this one did not.
        place = Place(chances.places, self._place.shape)
        seen = (chances.level > 0) | (chances.changed > 0.0)
        lowest, highest = (np.where(k > 0, k, np.nan) for k in chances.interval(self._confidence))
        values = {
            "uncertain": np.where(seen, chances.uncertain(self._confidence), np.nan),
            "change_chance": np.where(seen, chances.changed, np.nan),
            "lowest_level": lowest,
            "highest_level": highest,
        }
        key = "confidence"
        bands = [described_band(key, name, place.map_of(own)) for name, own in values.items()]
        return described_raster(
            key,
            [*bands, self._band(key, "rocks_factor", factor)],
            classes=(
                RasterClass(0, "statistically certain", _CERTAIN),
                RasterClass(1, "statistically uncertain", _UNCERTAIN),
            ),
            codes=joined(
                "; ",
                (
                    phrase("{} = {}", k, phrase(level.label))
                    for k, level in enumerate(self._preset.levels, start=1)
                ),
            ),
            **self._words,
        )

    def _classes(self, key: str, column: str, codes: NDArray[np.int16], **words: Any) -> Band:
        return self._band(key, column, np.where(codes > 0, codes, np.nan), **words)

    def _band(
        self, key: str, column: str, values: FloatArray, name: str = "", **words: Any
    ) -> Band:
        on_map = self._place.map_of(np.where(np.isfinite(values), values, np.nan))
        return described_band(key, column, on_map, name, **words)


def _of_energy(energy_kj: float) -> str:
    if energy_kj == 0.0:
        return phrase("of any energy")
    return phrase("of {} kJ and more", f"{energy_kj:g}")
