"""From the counts of a simulation to hazard curves, levels, intensities and their zones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sassgis.hazard.attribution import attribution, governing, zone_of_cells
from sassgis.hazard.curves import at_energies, hazard_curves
from sassgis.hazard.levels import deciding_energy, hazard_level, intensity_class, undecided
from sassgis.hazard.sources import Sampled
from sassgis.hazard.zoning.generalise import (
    BoolArray,
    Coverage,
    ZoneSettings,
    generalised_series,
    nested_coverages,
)
from sassgis.model.grid import Grid, IntArray
from sassgis.model.hazard import HazardCurves, HazardPreset


@dataclass(frozen=True, slots=True)
class ZoneFacts:
    """What is known of each zone of hazard level.

    Attributes
    ----------
    area_m2 : float64, shape (n_zones,)
    cells : int64, shape (n_zones,)
        Cells that rocks reach; the others were raised when the zone was drawn.
    undecided : float64, shape (n_zones,)
        Share of those cells whose level another sample of rocks might change; NaN without any.
    shares : float64, shape (n_zones, n_sources)
        Of each source in the rate that makes the level; NaN in zones without a reached cell.
    governing : int64, shape (n_zones,)
        Source with the largest share; -1 for none.
    """

    area_m2: np.ndarray
    cells: IntArray
    undecided: np.ndarray
    shares: np.ndarray
    governing: IntArray


@dataclass(frozen=True, slots=True)
class IntensityMap:
    """Zones of intensity at one return period; ``years`` is None for the extreme event."""

    years: float | None
    zones: Coverage


@dataclass(frozen=True, slots=True)
class Hazard:
    """What a simulation says of the hazard.

    Attributes
    ----------
    sampled : tuple of Sampled
    curves : HazardCurves
    levels : Coverage
        Zones of hazard level; class k is the preset's level k - 1.
    facts : ZoneFacts
        Of the zones of ``levels``.
    intensities : tuple of IntensityMap
        From frequent to rare; class k is the preset's intensity k - 1.
    undecided : bool, shape (n_cells,)
        Whether another sample of rocks might change the level of a cell of ``curves``.
    """

    sampled: tuple[Sampled, ...]
    curves: HazardCurves
    levels: Coverage
    facts: ZoneFacts
    intensities: tuple[IntensityMap, ...]
    undecided: BoolArray

    @property
    def undecided_share(self) -> float:
        """Share of the cells that rocks reach whose level another sample might change."""
        return _share(self.undecided)


def raster(grid: Grid, cells: IntArray, classes: np.ndarray) -> IntArray:
    """Classes of some cells on the grid, 0 elsewhere."""
    out = np.zeros(grid.shape[0] * grid.shape[1], np.int64)
    out[cells] = classes
    return out.reshape(grid.shape)


def curves_of(sampled: Sequence[Sampled], energies_kj: np.ndarray) -> HazardCurves:
    """Hazard curves of all cells."""
    return hazard_curves([s.source for s in sampled], [s.cells for s in sampled], energies_kj)


def share_undecided(curves: HazardCurves, preset: HazardPreset, confidence: float) -> float:
    """Share of the reached cells whose level another sample might change."""
    return _share(undecided(curves, preset, confidence))


def _share(cells: BoolArray) -> float:
    return float(cells.mean()) if cells.size else 0.0


def intensity_maps(
    curves: HazardCurves, preset: HazardPreset, grid: Grid, settings: ZoneSettings
) -> tuple[IntensityMap, ...]:
    """Zones of intensity for the preset's return periods and the extreme event.

    The zones of a rarer event contain those of a more frequent one.
    """
    few = at_energies(curves, preset.thresholds_kj)
    years: list[float | None] = [*preset.return_periods, None]
    known = np.isfinite(grid.values)
    maps = [raster(grid, few.places, intensity_class(few, preset, t)) for t in years]
    drawn = nested_coverages(
        generalised_series(maps, grid.cell_size, settings, known), grid, settings, known
    )
    return tuple(IntensityMap(t, zones) for t, zones in zip(years, drawn, strict=True))


def level_zones(
    curves: Sequence[HazardCurves], preset: HazardPreset, grid: Grid, settings: ZoneSettings
) -> list[Coverage]:
    """Zones of hazard level of several simulations, as with and without barriers.

    Where no cell of a map is above that of the next, the zones of the first lie within those of the
    next: drawn each for itself, smoothing alone would make zones higher here and lower there.
    """
    known = np.isfinite(grid.values)
    maps = [raster(grid, c.places, hazard_level(c, preset)) for c in curves]
    if all((one <= other).all() for one, other in pairwise(maps)):
        smooth = generalised_series(maps, grid.cell_size, settings, known)
        return nested_coverages(smooth, grid, settings, known)
    return [
        nested_coverages(
            generalised_series([one], grid.cell_size, settings, known), grid, settings, known
        )[0]
        for one in maps
    ]


def zone_facts(
    sampled: Sequence[Sampled],
    curves: HazardCurves,
    preset: HazardPreset,
    zones: Coverage,
    grid: Grid,
    unsure: BoolArray,
) -> ZoneFacts:
    """Attribution and confidence of zones of hazard level; ``unsure`` cells of the curves."""
    n = zones.polygons.size
    zone = zone_of_cells(zones, grid, curves.places)
    inside = zone >= 0
    shares = attribution(
        zone,
        curves.places,
        [s.source for s in sampled],
        [s.cells for s in sampled],
        deciding_energy(curves, preset),
        n,
    )
    cells = np.bincount(zone[inside], minlength=n)
    unsure_cells = np.bincount(zone[inside], weights=unsure[inside], minlength=n)
    return ZoneFacts(
        np.array([p.area for p in zones.polygons], np.float64),
        cells,
        np.where(cells > 0, unsure_cells / np.maximum(cells, 1), np.nan),
        shares,
        governing(shares)[0],
    )


def hazard_of(
    sampled: Sequence[Sampled],
    curves: HazardCurves,
    zones: Coverage,
    preset: HazardPreset,
    grid: Grid,
    settings: ZoneSettings,
    confidence: float,
) -> Hazard:
    """Everything that the counts of a simulation say of the hazard.

    Parameters
    ----------
    sampled : sequence of Sampled
    curves : HazardCurves
        Of the cells, from all of them.
    zones : Coverage
        Of hazard level.
    preset : HazardPreset
    grid : Grid
    settings : ZoneSettings
    confidence : float
        Of the sampling interval.
    """
    unsure = undecided(curves, preset, confidence)
    return Hazard(
        tuple(sampled),
        curves,
        zones,
        zone_facts(sampled, curves, preset, zones, grid, unsure),
        intensity_maps(curves, preset, grid, settings),
        unsure,
    )


def by_area(
    sampled: Sequence[Sampled],
    energies_kj: np.ndarray,
    preset: HazardPreset,
    grid: Grid,
    settings: ZoneSettings,
) -> dict[str, tuple[IntensityMap, ...]]:
    """Zones of intensity of each release area alone."""
    areas = dict.fromkeys(s.source.area for s in sampled)
    return {
        area: intensity_maps(
            curves_of([s for s in sampled if s.source.area == area], energies_kj),
            preset,
            grid,
            settings,
        )
        for area in areas
    }
