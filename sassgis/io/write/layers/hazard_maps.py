"""The hazard maps, from the hazard curves of the cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.curves import at_energies, energy_at, rate_interval, return_period
from sassgis.hazard.levels import (
    hazard_level,
    intensity_class,
    levels_of_interval,
    rocks_factor,
)
from sassgis.hazard.preset_labels import energy_labels, preset_unverified
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.hazard import HazardCurves, HazardPreset
from sassgis.model.results import Band, RasterClass, RasterLayer

#: Colours of "statistically certain" and "uncertain".
_CERTAIN, _UNCERTAIN = "#b8c4c2", "#d6721f"


def hazard_layers(
    curves: HazardCurves,
    preset: HazardPreset,
    shape: tuple[int, int],
    ref_width_m: float,
    *,
    return_periods: Sequence[float],
    confidence: float = 0.95,
) -> tuple[RasterLayer, ...]:
    """Maps of level, intensity, energy, return period and frequency, and how sure the level is.

    Parameters
    ----------
    curves : HazardCurves
        Of the cells, with the thresholds of the preset among the energies.
    preset : HazardPreset
    shape : (n_rows, n_cols)
    ref_width_m : float
        Reference width of all frequencies (m).
    return_periods : sequence of float
        Years for which intensity and energy are mapped, ascending.
    confidence : float
        Of the intervals.

    Returns
    -------
    tuple of RasterLayer
        Cells to which a statement does not apply are NaN: those that no block reaches, or not as
        often.
    """
    maker = _Maker(curves, preset, shape, ref_width_m, confidence)
    return (
        maker.level(),
        *(maker.intensity(years) for years in return_periods),
        maker.intensity(None),
        maker.energy(return_periods),
        maker.return_period(),
        maker.frequency(),
        maker.confidence(),
    )


class _Maker:
    """The layers one by one; what they share is computed once."""

    def __init__(
        self,
        curves: HazardCurves,
        preset: HazardPreset,
        shape: tuple[int, int],
        ref_width_m: float,
        confidence: float,
    ) -> None:
        self._curves = curves
        self._few = at_energies(curves, preset.thresholds_kj)
        self._reached = self._few.rate[:, 0] > 0.0
        self._interval = rate_interval(self._few, confidence)
        self._preset = preset
        self._shape = shape
        self._percent = f"{100.0 * confidence:g} %"
        self._confidence = confidence
        self._frequencies = (
            "Annual frequency: onset frequency times the share of the simulated blocks that reach "
            "the cell, summed over release areas and block scenarios. Reference width "
            f"{ref_width_m:.4g} m."
        )
        self._rules = " ".join(
            [f"Preset {preset.name} ({preset.title}).", *map(_sentence, preset_unverified(preset))]
        )
        self._sampled = (
            f"{self._percent} intervals say what another sample of blocks would change, not the "
            "error of the model, its parameters or the onset frequency."
        )

    def level(self) -> RasterLayer:
        codes = hazard_level(self._few, self._preset)
        return RasterLayer(
            "hazard_level",
            "Hazard level",
            "Highest level of the matrix that the hazard curve of the cell crosses. "
            f"{self._frequencies} {self._rules}",
            (self._classes("level", "Hazard level", codes),),
            (),
            "",
            self._level_classes(),
        )

    def intensity(self, years: float | None) -> RasterLayer:
        codes = intensity_class(self._few, self._preset, years)
        if years is None:
            name, when = "intensity_extreme", "extreme event"
            what = "Strongest class of intensity of any simulated block, however rare."
        else:
            name, when = f"intensity_{years:g}", f"return period {years:g} years"
            what = (
                "Strongest class of intensity whose lower limit of energy is reached or exceeded "
                f"at least once in {years:g} years."
            )
        return RasterLayer(
            name,
            f"Intensity, {when}",
            f"{what} {self._frequencies} {self._rules}",
            (self._classes("intensity", f"Class of intensity, {when}", codes),),
            (),
            "",
            tuple(
                RasterClass(i, f"{c.label} ({span})", c.colour)
                for i, (c, span) in enumerate(
                    zip(self._preset.intensities, energy_labels(self._preset), strict=True), start=1
                )
            ),
        )

    def energy(self, return_periods: Sequence[float]) -> RasterLayer:
        # The longest return period is the first band, the one shown: it reaches farthest.
        periods = (*return_periods[-1:], *return_periods[:-1])
        energies = self._curves.energies_kj
        return RasterLayer(
            "energy_at_return_period",
            f"Energy once in {periods[0]:g} years (kJ)" if periods else "Energy (kJ)",
            "Kinetic energy (translation and rotation) reached or exceeded once in the return "
            f"period; nothing where blocks arrive less often. {self._frequencies} Interpolated "
            f"between {energies.size} energies from {energies[0]:g} to {energies[-1]:g} kJ; where "
            "even the last is exceeded more often, the last.",
            tuple(
                self._band(
                    f"e{years:g}",
                    f"Energy reached or exceeded once in {years:g} years",
                    "kJ",
                    energy_at(self._curves, years),
                )
                for years in periods
            ),
            (0.0, *self._preset.thresholds_kj[1:]),
            "YlOrRd",
        )

    def return_period(self) -> RasterLayer:
        years = return_period(self._few.rate)
        return RasterLayer(
            "return_period",
            "Return period of arriving blocks (years)",
            "Mean time between blocks that reach the cell with at least the energy of the band: "
            f"1 / frequency; nothing where none does. {self._frequencies}",
            tuple(
                self._band(f"t{e:g}", f"Return period of blocks {_with_energy(e)}", "years", t)
                for e, t in zip(self._few.energies_kj, years.T, strict=True)
            ),
            (0.0, *self._preset.return_periods),
            "plasma",
        )

    def frequency(self) -> RasterLayer:
        bands = []
        error = np.sqrt(self._few.variance)
        for i, energy in enumerate(self._few.energies_kj):
            blocks = f"blocks {_with_energy(float(energy))}"
            for name, what, values in (
                ("rate", f"Frequency of {blocks}", self._few.rate),
                ("standard_error", f"Standard error of the frequency of {blocks}", error),
                ("lower", f"Lower limit of the frequency of {blocks}", self._interval[0]),
                ("upper", f"Upper limit of the frequency of {blocks}", self._interval[1]),
            ):
                bands.append(
                    self._band(
                        f"{name}_{energy:g}",
                        what,
                        "1/year",
                        np.where(self._reached, values[:, i], np.nan),
                    )
                )
        limits = sorted(1.0 / t for t in self._preset.return_periods)
        return RasterLayer(
            "frequency",
            "Frequency of arriving blocks (1/year)",
            f"{self._frequencies} {self._sampled} Gamma interval of weighted counts. Errors and "
            "limits are missing where the sample does not give them (one block per fall line).",
            tuple(bands),
            (0.0, 0.1 * limits[0], *limits, 10.0 * limits[-1]),
            "plasma_r",
        )

    def confidence(self) -> RasterLayer:
        lowest, highest = levels_of_interval(self._few.rate, *self._interval, self._preset)
        open_ = (lowest != highest).astype(np.int16)
        factor = rocks_factor(self._few, self._preset, self._confidence)
        codes = "; ".join(f"{k} = {c.label}" for k, c in enumerate(self._preset.levels, start=1))
        return RasterLayer(
            "confidence",
            "Is the level statistically uncertain?",
            f"Statistically uncertain: the {self._percent} intervals of the frequencies leave more "
            f"than one level open. Levels: {codes}. {self._sampled} Cells that no block reached "
            "are left out. Factor of blocks: how many times the blocks would make the level "
            "certain; missing where the frequency lies on a limit of the matrix, so that no "
            "sample does, or where the sample does not give its error. "
            f"{self._frequencies} {self._rules}",
            (
                self._band(
                    "uncertain",
                    "Whether another sample of blocks might give another level",
                    "class",
                    np.where(self._reached, open_, np.nan),
                ),
                self._classes("lowest_level", "Level at the lower limits of the rates", lowest),
                self._classes("highest_level", "Level at the upper limits of the rates", highest),
                self._band(
                    "rocks_factor",
                    "Factor by which the blocks would have to be more for the level to be certain",
                    "1",
                    np.where(self._reached & np.isfinite(factor), factor, np.nan),
                ),
            ),
            (),
            "",
            (
                RasterClass(0, "statistically certain", _CERTAIN),
                RasterClass(1, "statistically uncertain", _UNCERTAIN),
            ),
        )

    def _level_classes(self) -> tuple[RasterClass, ...]:
        return tuple(
            RasterClass(k, c.label, c.colour, c.hatched)
            for k, c in enumerate(self._preset.levels, start=1)
        )

    def _classes(self, name: str, description: str, codes: NDArray[np.int16]) -> Band:
        return self._band(name, description, "class", np.where(codes > 0, codes, np.nan))

    def _band(self, name: str, description: str, unit: str, values: FloatArray) -> Band:
        return Band(name, description, unit, _on_map(values, self._curves.places, self._shape))


def _on_map(values: FloatArray, places: IntArray, shape: tuple[int, int]) -> NDArray[np.float32]:
    out = np.full(shape[0] * shape[1], np.nan, np.float32)
    out[places] = np.where(np.isfinite(values), values, np.nan)
    return out.reshape(shape)


def _with_energy(energy_kj: float) -> str:
    return f"of {energy_kj:g} kJ and more" if energy_kj > 0.0 else "of any energy"


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."
