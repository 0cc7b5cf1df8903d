"""From the counts of a simulation to hazard curves, levels, intensities and their zones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sassgis.hazard.another_sample import LevelChances, level_chances
from sassgis.hazard.attribution import attribution, governing, zone_of_cells
from sassgis.hazard.curves import at_energies, hazard_curves
from sassgis.hazard.levels import deciding_energy, hazard_level, intensity_class
from sassgis.hazard.risk import RiskTable, assess_risk
from sassgis.hazard.sources import Sampled
from sassgis.hazard.zoning.generalise import (
    Coverage,
    generalised_series,
    nested_coverages,
)
from sassgis.model.exposure import PlacedObjects, Vulnerability
from sassgis.model.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.model.hazard import HazardCurves, HazardPreset, ZoningSettings
from sassgis.terrain.edge import edge_cells


@dataclass(frozen=True, slots=True)
class ZoneFacts:
    """What is known of each zone of hazard level.

    Attributes
    ----------
    area_m2 : float64, shape (n_zones,)
    cells : int64, shape (n_zones,)
        Cells that blocks reach; the others were raised when the zone was drawn.
    uncertain : float64, shape (n_zones,)
        Share of those cells whose level another sample of blocks might change; NaN without any.
    moves_m : float64, shape (n_zones,)
        Mean distance between the outer limit and that of another sample of as many blocks (m).
    open_m : float64, shape (n_zones,)
        Length along the edge of the known terrain, beyond which the zone goes on (m).
    shares : float64, shape (n_zones, n_sources)
        Of each source in the rate that makes the level; NaN in zones without a reached cell.
    governing : int64, shape (n_zones,)
        Source with the largest share; -1 for none.
    """

    area_m2: np.ndarray
    cells: IntArray
    uncertain: np.ndarray
    moves_m: np.ndarray
    open_m: np.ndarray
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
    levels : Coverage
        Zones of hazard level; class k is the preset's level k - 1.
    facts : ZoneFacts
        Of the zones of ``levels``.
    intensities : tuple of IntensityMap
        From frequent to rare; class k is the preset's intensity k - 1.
    chances : LevelChances
        What another sample of blocks would make of the level of cells.
    uncertain : bool, shape (n,)
        Whether it might change the level of a cell of ``chances``.
    """

    sampled: tuple[Sampled, ...]
    curves: HazardCurves
    levels: Coverage
    facts: ZoneFacts
    intensities: tuple[IntensityMap, ...]
    chances: LevelChances
    uncertain: BoolArray

    @property
    def changed_share(self) -> float:
        """Area whose level another sample would change, over the area that has a level."""
        return self.chances.changed_share

    @property
    def uncertain_share(self) -> float:
        """Area whose level another sample might change, over the area that has a level."""
        zoned = int((self.chances.level > 0).sum())
        return float(self.uncertain.sum()) / zoned if zoned else 0.0


def raster(grid: Grid, cells: IntArray, classes: np.ndarray) -> IntArray:
    """Classes of some cells on the grid, 0 elsewhere."""
    out = np.zeros(grid.shape[0] * grid.shape[1], np.int64)
    out[cells] = classes
    return out.reshape(grid.shape)


def curves_of(sampled: Sequence[Sampled], energies_kj: np.ndarray) -> HazardCurves:
    """Hazard curves of all cells."""
    return hazard_curves([s.source for s in sampled], [s.cells for s in sampled], energies_kj)


def intensity_maps(
    curves: HazardCurves, preset: HazardPreset, grid: Grid, settings: ZoningSettings
) -> tuple[IntensityMap, ...]:
    """Zones of intensity for the preset's return periods and the extreme event.

    The zones of a rarer event contain those of a more frequent one.
    """
    few = at_energies(curves, preset.thresholds_kj)
    years: list[float | None] = [*preset.return_periods, None]
    maps = [(few.places, intensity_class(few, preset, t)) for t in years]
    return tuple(map(IntensityMap, years, _nested_zones(maps, grid, settings)))


def _nested_zones(
    maps: Sequence[tuple[IntArray, np.ndarray]], grid: Grid, settings: ZoningSettings
) -> list[Coverage]:
    """Zones of maps, each some cells and their classes, of which none is above the next."""
    felt = felt_cells(settings, grid.cell_size)
    reached = np.unique(np.concatenate([cells for cells, _ in maps]))
    beside = 4 * felt
    while True:
        own, cells, cut = around(grid, reached, beside)
        known = np.isfinite(own.values)
        smooth = generalised_series(
            [raster(own, cells[np.searchsorted(reached, c)], classes) for c, classes in maps],
            grid.cell_size, settings, known,
        )  # fmt: skip
        if not _feels_edge(smooth[-1], cut, felt):
            return nested_coverages(smooth, own, settings, known)
        beside *= 2


def around(
    grid: Grid, cells: IntArray, beside: int
) -> tuple[Grid, IntArray, tuple[bool, bool, bool, bool]]:
    """The part of a grid around some cells, with so many cells beside them on each side.

    Returns
    -------
    cells : int64
        On that part.
    cut : (bool, bool, bool, bool)
        Whether the grid goes on in the north, east, south and west.
    """
    n_rows, n_cols = grid.shape
    row, col = np.divmod(cells, n_cols)
    if not cells.size:
        row = col = np.zeros(1, np.int64)
    top, left = max(int(row.min()) - beside, 0), max(int(col.min()) - beside, 0)
    bottom = min(int(row.max()) + beside + 1, n_rows)
    right = min(int(col.max()) + beside + 1, n_cols)
    own = replace(
        grid,
        values=grid.values[top:bottom, left:right],
        west=grid.west + left * grid.cell_size,
        north=grid.north - top * grid.cell_size,
    )
    flat = (row - top) * (right - left) + (col - left)
    return own, flat[: cells.size], (top > 0, right < n_cols, bottom < n_rows, left > 0)


def felt_cells(settings: ZoningSettings, cell_size: float) -> int:
    """Cells from a zone within which drawing it looks at others."""
    growth = math.ceil(1.2 * math.sqrt(settings.smallest_cells(cell_size)))
    return settings.closing_cells(cell_size) + settings.width_cells(cell_size) + growth + 2


def _feels_edge(classes: IntArray, cut: tuple[bool, bool, bool, bool], felt: int) -> bool:
    """Whether zones come near an edge beyond which the grid goes on."""
    edges = (classes[:felt], classes[:, -felt:], classes[-felt:], classes[:, :felt])
    return any(c and bool(edge.any()) for c, edge in zip(cut, edges, strict=True))


def level_zones(
    curves: Sequence[HazardCurves], preset: HazardPreset, grid: Grid, settings: ZoningSettings
) -> list[Coverage]:
    """Zones of hazard level of several simulations, as with and without barriers.

    Where no cell of a map is above that of the next, the zones of the first lie within those of the
    next: drawn each for itself, smoothing alone would make zones higher here and lower there.
    """
    maps = [(c.places, hazard_level(c, preset)) for c in curves]
    whole = (raster(grid, *own) for own in maps)
    nested = all((one <= other).all() for one, other in pairwise(whole))
    return [
        drawn
        for series in ([maps] if nested else [[one] for one in maps])
        for drawn in _nested_zones(series, grid, settings)
    ]


def zone_facts(
    sampled: Sequence[Sampled],
    curves: HazardCurves,
    preset: HazardPreset,
    zones: Coverage,
    grid: Grid,
    unsure: BoolArray,
    lowered: FloatArray,
) -> ZoneFacts:
    """Attribution and confidence of zones of hazard level.

    Of the cells of the curves, ``unsure`` are those whose level is, and ``lowered`` is the
    probability that another sample lowers it.
    """
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
    # What a zone loses on one side of its limit it gains on the other, on average.
    moved = 2.0 * grid.cell_size**2 * np.bincount(zone[inside], lowered[inside], minlength=n)
    length = np.array([p.exterior.length for p in zones.polygons], np.float64)
    edge = zone_of_cells(zones, grid, np.flatnonzero(edge_cells(np.isfinite(grid.values))))
    return ZoneFacts(
        np.array([p.area for p in zones.polygons], np.float64),
        cells,
        np.where(cells > 0, unsure_cells / np.maximum(cells, 1), np.nan),
        moved / length,
        grid.cell_size * np.bincount(edge[edge >= 0], minlength=n),
        shares,
        governing(shares)[0],
    )


def hazard_of(
    sampled: Sequence[Sampled],
    curves: HazardCurves,
    zones: Coverage,
    preset: HazardPreset,
    grid: Grid,
    settings: ZoningSettings,
    confidence: float,
) -> Hazard:
    """Everything that the counts of a simulation say of the hazard.

    Parameters
    ----------
    curves : HazardCurves
        Of the cells, from all of them.
    zones : Coverage
        Of hazard level.
    confidence : float
        Of the sampling interval.
    """
    chances = level_chances(curves, preset, np.isfinite(grid.values))
    unsure = chances.uncertain(confidence)
    reached = np.searchsorted(chances.places, curves.places)
    of_cells = unsure[reached], chances.lowered[reached]
    return Hazard(
        tuple(sampled),
        curves,
        zones,
        zone_facts(sampled, curves, preset, zones, grid, *of_cells),
        intensity_maps(curves, preset, grid, settings),
        chances,
        unsure,
    )


def by_area(
    sampled: Sequence[Sampled],
    energies_kj: np.ndarray,
    preset: HazardPreset,
    grid: Grid,
    settings: ZoningSettings,
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


@dataclass(frozen=True, slots=True)
class Rules:
    """What zoning needs besides the simulated blocks.

    Attributes
    ----------
    frequencies : dict of (area, scenario) to float
        Blocks per year.
    placed : PlacedObjects
        Exposed objects; may be none.
    ref_width_m : float
        Reference width of all frequencies (m): one cell or more.
    notices : tuple of str
        What the readers had to say.
    """

    preset: HazardPreset
    frequencies: dict[tuple[str, str], float]
    placed: PlacedObjects
    vulnerability: Vulnerability | None
    zones: ZoningSettings
    ref_width_m: float
    notices: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Assessment:
    """What zoning found.

    Attributes
    ----------
    hazard : Hazard
        With the walls and nets there are.
    without : Hazard or None
        Without them; None if there are none or nobody asked.
    by_area : dict of str to tuple of IntensityMap
        Intensities of each release area alone; empty unless asked for.
    """

    hazard: Hazard
    without: Hazard | None
    by_area: dict[str, tuple[IntensityMap, ...]]
    risk: RiskTable | None
    risk_without: RiskTable | None

    @property
    def without_barriers(self) -> tuple[Sampled, ...]:
        """The sources as they reach a line without barriers."""
        return (self.without or self.hazard).sampled


def assess(
    rules: Rules,
    grid: Grid,
    energies_kj: np.ndarray,
    sampled: Sequence[Sampled],
    without: Sequence[Sampled] | None,
    *,
    confidence: float,
    by_source: bool,
) -> Assessment:
    """What the counts of a simulation say of hazard and risk.

    Parameters
    ----------
    energies_kj : float64, shape (n,)
        Of the hazard curves.
    without : sequence of Sampled or None
        The same sources without walls and nets.
    confidence : float
        Of the sampling interval.
    by_source : bool
        Whether to draw zones of intensity of each release area alone.
    """
    both = [sampled] if without is None else [sampled, without]
    curves = [curves_of(own, energies_kj) for own in both]
    zones = level_zones(curves, rules.preset, grid, rules.zones)
    after, *others = (
        hazard_of(*own, rules.preset, grid, rules.zones, confidence)
        for own in zip(both, curves, zones, strict=True)
    )
    before = others[0] if others else None
    alone = (
        by_area(after.sampled, energies_kj, rules.preset, grid, rules.zones) if by_source else {}
    )
    return Assessment(
        after,
        before,
        alone,
        risk_of(rules, after.sampled, energies_kj),
        None if before is None else risk_of(rules, before.sampled, energies_kj),
    )


def risk_of(rules: Rules, sampled: Sequence[Sampled], energies: np.ndarray) -> RiskTable | None:
    """Risk of the exposed objects; None if there are none."""
    if rules.vulnerability is None:
        return None
    return assess_risk(
        rules.placed.objects,
        [s.source for s in sampled],
        [s.objects for s in sampled],
        energies,
        rules.preset.thresholds_kj,
        rules.vulnerability,
    )
