"""From counts of a simulation to hazard curves, levels, intensities, zones and their sources."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.grid import BoolArray, Bounds, ClassMap, FloatArray, Grid, IntArray
from sassgis.hazard.curves import at_energies, hazard_curves
from sassgis.hazard.levels import (
    cells_within_limit,
    deciding_energy,
    hazard_level,
    intensity_class,
    window_of,
)
from sassgis.hazard.risk import RiskTable, assess_risk
from sassgis.hazard.sampling_error import LevelChances, level_chances
from sassgis.hazard.sources import Sampled
from sassgis.hazard.zoning.applied_edits import AppliedEdit, share_of, with_edits
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.hazard.zoning.drawing import drawn_zones, reach_cells
from sassgis.settings.exposure import PlacedObjects, Vulnerability
from sassgis.settings.hazard_rules import (
    Drawing,
    Edit,
    HazardCurves,
    HazardPreset,
    Source,
    SourceCounts,
)
from sassgis.terrain.edge import edge_sides
from sassgis.terrain.release import release_rims

T = TypeVar("T")


def zone_of_cells(coverage: Coverage, grid: Grid, cells: IntArray) -> IntArray:
    """Return the position of the zone that holds the centre of each cell; -1 outside all zones.

    ``cells`` are flat indices on the grid of the zones, ascending. A centre on a common boundary
    belongs to the higher class, then to the earlier zone.
    """
    zone = np.full(np.size(cells), -1, np.int64)
    if zone.size == 0 or coverage.polygons.size == 0:
        return zone
    x, y = grid.cell_centres(cells)
    shapely.prepare(coverage.polygons)
    west, south, east, north = shapely.bounds(coverage.polygons).T
    # Cells ascend from the north to the south.
    first, last = np.searchsorted(-y, -north), np.searchsorted(-y, -south, side="right")
    # The last one written stays.
    for k in np.lexsort((-np.arange(west.size), coverage.classes)).tolist():
        rows = slice(first[k], last[k])
        near = first[k] + np.flatnonzero((x[rows] >= west[k]) & (x[rows] <= east[k]))
        zone[near[shapely.intersects_xy(coverage.polygons[k], x[near], y[near])]] = k
    return zone


def attribution(
    zone_of_cell: IntArray,
    cells: IntArray,
    sources: Sequence[Source],
    counts: Sequence[SourceCounts],
    column_of_cell: IntArray,
    n_zones: int,
) -> FloatArray:
    """Compute the share of each source in the rate that makes each zone.

    Parameters
    ----------
    zone_of_cell : int64, shape (n,)
        From `zone_of_cells`; cells of -1 do not count.
    cells : int64, shape (n,)
        Flat indices, ascending.
    column_of_cell : int64, shape (n,)
        Column of the energy that decides the class of each cell.

    Returns
    -------
    float64, shape (n_zones, n_sources)
        Of the rates at the deciding energy, summed over the cells of the zone. NaN for a zone
        without a reached cell: all its cells were raised.
    """
    if np.any(np.diff(cells) <= 0):
        raise ValueError("cells are not in ascending order")
    rate = np.zeros((n_zones, len(sources)))
    if cells.size:
        for s, (source, count) in enumerate(zip(sources, counts, strict=True)):
            at = np.minimum(np.searchsorted(cells, count.places), cells.size - 1)
            known = (cells[at] == count.places) & (zone_of_cell[at] >= 0)
            at = at[known]
            rocks = count.count[known, column_of_cell[at]]
            rate[:, s] = source.rate_per_rock * np.bincount(
                zone_of_cell[at], weights=rocks, minlength=n_zones
            )
    total = rate.sum(axis=1, keepdims=True)
    shares = np.full_like(rate, np.nan)
    np.divide(rate, total, out=shares, where=total > 0.0)
    return shares


def governing(shares: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the source with the largest share in each zone, and that share; shape (n_zones,).

    The first of equal ones; -1 and NaN where no source reaches the zone.
    """
    n_zones = shares.shape[0]
    if shares.shape[1] == 0:
        return np.full(n_zones, -1, np.int64), np.full(n_zones, np.nan)
    reached = ~np.isnan(shares).all(axis=1)
    source = np.where(reached, np.argmax(np.nan_to_num(shares, nan=-1.0), axis=1), -1)
    share = np.where(reached, shares[np.arange(n_zones), source], np.nan)
    return source.astype(np.int64), share


def shares_by(shares: FloatArray, names: Sequence[str]) -> tuple[tuple[str, ...], FloatArray]:
    """Add up the shares of sources of the same name (area or scenario): names, shares by zone."""
    each = tuple(dict.fromkeys(names))
    columns = [np.array([n == name for n in names]) for name in each]
    parts = [shares[:, column].sum(axis=1) for column in columns]
    return each, np.column_stack(parts) if parts else np.empty((shares.shape[0], 0))


@dataclass(frozen=True, slots=True)
class ZoneFacts:
    """Facts about each zone of hazard level, shape (n_zones,) each."""

    area_m2: FloatArray
    cells: IntArray  # that blocks reach; the others were raised when the zone was drawn
    # Share of those cells whose level another sample of blocks might change; NaN without any.
    uncertain: FloatArray
    # Mean distance (m) between the outer limit and that of another sample of as many blocks.
    moves_m: FloatArray
    # Lines where it ends at the edge of the known terrain and continues beyond; may be empty.
    open_limit: NDArray[np.object_]
    # Shape (n_zones, n_sources); of each source in the rate that makes the level; NaN in zones
    # without a reached cell.
    shares: FloatArray
    governing: IntArray  # source with the largest share; -1 for none
    edit: IntArray  # the edit that set the level; -1 for none

    @property
    def open_m(self) -> FloatArray:
        """Return the length of the open limit of each zone (m), shape (n_zones,)."""
        length: FloatArray = shapely.length(self.open_limit)
        return length


#: Zones of intensity by return period (years), from frequent to rare; None is the extreme event.
Intensities = dict[float | None, Coverage]


@dataclass(frozen=True, slots=True)
class Hazard:
    """Hazard by a simulation."""

    sampled: tuple[Sampled, ...]
    curves: HazardCurves
    computed: Coverage  # zones of hazard level; class k is the preset's level k - 1
    levels: Coverage  # the same with the edits of experts
    facts: ZoneFacts  # of the zones of ``levels``
    intensities: Intensities  # class k is the preset's intensity k - 1
    chances: LevelChances  # levels of cells with another sample
    uncertain: BoolArray  # shape (n,); whether it might change the level of a cell of ``chances``
    edits: tuple[AppliedEdit, ...]

    @property
    def changed_share(self) -> float:
        """Return the area on which another sample differs, over that with a level."""
        return self.chances.changed_share

    @property
    def uncertain_share(self) -> float:
        """Return the share of the area with a level on which another sample might change it."""
        zoned = self.chances.level > 0
        return float(self.uncertain[zoned].mean()) if zoned.any() else 0.0

    def without_curves(self) -> Hazard:
        """Return it without curves and counts of single cells, which take most of the memory."""
        none = SourceCounts.none(self.curves.energies_kj.size)
        sampled = tuple(replace(own, cells=none) for own in self.sampled)
        return replace(self, sampled=sampled, curves=self.curves.part([]))


def raster(grid: Grid, cells: IntArray, classes: np.ndarray) -> ClassMap:
    """Return classes of some cells on the grid, 0 elsewhere."""
    out = np.zeros(grid.shape[0] * grid.shape[1], np.int16)
    out[cells] = classes
    return out.reshape(grid.shape)


def curves_of(sampled: Sequence[Sampled], energies_kj: np.ndarray) -> HazardCurves:
    """Return hazard curves of all cells."""
    return hazard_curves([s.source for s in sampled], [s.cells for s in sampled], energies_kj)


#: Rims without any release area.
NO_RIMS: IntArray = np.empty((2, 0), np.int64)


def rims_of(sampled: Sequence[Sampled], grid: Grid) -> IntArray:
    """Return the cells of the release areas of sources and of their rims, by release_rims."""
    shapes = {s.source.area: s.release for s in sampled if s.release is not None}
    return release_rims(list(shapes.values()), grid)


def intensity_maps(
    curves: HazardCurves,
    preset: HazardPreset,
    grid: Grid,
    rules: Drawing,
    rims: IntArray = NO_RIMS,
) -> Intensities:
    """Draw zones of intensity for the preset's return periods and the extreme event.

    The zones of a rarer event contain those of a more frequent one. The extreme event has the outer
    limit of the hazard levels. ``rims`` are those of rims_of.
    """
    few = at_energies(curves, preset.thresholds_kj)
    years: list[float | None] = [*preset.return_periods, None]
    classes = [intensity_class(few, preset, t) for t in years]
    classes[-1] = np.maximum(classes[-1], cells_within_limit(few, preset, grid, rules.smoothing_m))
    maps = [(few.places, c) for c in classes]
    envelopes = [t is None for t in years]
    return dict(zip(years, _nested_zones(maps, grid, rules, envelopes, rims), strict=True))


def _nested_zones(
    maps: Sequence[tuple[IntArray, np.ndarray]],
    grid: Grid,
    rules: Drawing,
    envelopes: Sequence[bool],
    rims: IntArray,
) -> list[Coverage]:
    """Return zones of maps, each some cells and their classes, of which none is above the next.

    A cell of a release area has at least the class of the rim below it: what leaves there falls.
    """
    # Maps of the same curves name the same cells, which are ascending already.
    named = list({id(cells): cells for cells, _ in maps}.values())
    reached = named[0] if len(named) == 1 else np.unique(np.concatenate(named))
    if rims.size and reached.size:
        reached = np.union1d(reached, rims.ravel())
    window = window_of(reached, grid.shape, reach_cells(rules, grid.cell_size))
    own = grid.part(window.rows, window.cols)
    rasters = [raster(own, window.cells[np.searchsorted(reached, c)], k) for c, k in maps]
    if rims.size and reached.size:
        cells, rim = window.cells[np.searchsorted(reached, rims)]
        for classes in (one.ravel() for one in rasters):
            np.maximum.at(classes, cells, classes[rim])
    return drawn_zones(rasters, own, rules, np.isfinite(own.values), envelopes)


def level_zones(
    curves: Sequence[HazardCurves],
    levels: Sequence[NDArray[np.int16]],
    preset: HazardPreset,
    grid: Grid,
    rules: Drawing,
    rims: IntArray = NO_RIMS,
) -> list[Coverage]:
    """Draw zones of hazard level of several simulations, as with and without barriers.

    ``levels`` are those of the places of the curves, ``rims`` those of rims_of.

    Where no cell of a map is above that of the next, the zones of the first lie within those of the
    next. Drawn separately, smoothing would raise zones here and lower them there.
    """
    maps = [
        (c.places, np.maximum(level, cells_within_limit(c, preset, grid, rules.smoothing_m)))
        for c, level in zip(curves, levels, strict=True)
    ]
    whole = (raster(grid, *own) for own in maps)
    nested = all((one <= other).all() for one, other in pairwise(whole))
    return [
        drawn
        for series in ([maps] if nested else [[one] for one in maps])
        for drawn in _nested_zones(series, grid, rules, [True] * len(series), rims)
    ]


def zone_facts(
    sampled: Sequence[Sampled],
    curves: HazardCurves,
    preset: HazardPreset,
    zones: Coverage,
    grid: Grid,
    not_certain: BoolArray,
    lowered: FloatArray,
    edit: IntArray,
) -> ZoneFacts:
    """Compute the attribution and confidence of zones of hazard level.

    ``not_certain`` marks the cells of the curves whose level is uncertain, ``lowered`` is the
    probability that another sample lowers it. A level that an edit has set depends on no sample.
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
    open_cells = np.bincount(zone[inside], weights=not_certain[inside], minlength=n)
    # What a zone loses on one side of its limit it gains on the other, on average.
    moved = 2.0 * grid.cell_size**2 * np.bincount(zone[inside], lowered[inside], minlength=n)
    length = np.array([p.exterior.length for p in zones.polygons], np.float64)
    cell, side = edge_sides(grid)
    of_side = zone_of_cells(zones, grid, cell)
    open_limit = [shapely.line_merge(shapely.union_all(side[of_side == k])) for k in range(n)]
    return ZoneFacts(
        area_m2=np.array([p.area for p in zones.polygons], np.float64),
        cells=cells,
        uncertain=np.where((cells > 0) & (edit < 0), open_cells / np.maximum(cells, 1), np.nan),
        moves_m=np.where(edit < 0, moved / length, 0.0),
        open_limit=np.array(open_limit, np.object_),
        shares=shares,
        governing=governing(shares)[0],
        edit=edit,
    )


@dataclass(frozen=True, slots=True)
class Rules:
    """Rules that zoning needs besides the simulated blocks."""

    preset: HazardPreset
    frequencies: dict[tuple[str, str], float]  # blocks per year, by area and scenario
    placed: PlacedObjects  # exposed objects; may be none
    vulnerability: Vulnerability | None
    zones: Drawing
    ref_width_m: float  # reference width of all frequencies (m): one cell or more
    notices: tuple[str, ...]  # warnings of the readers
    edits: tuple[Edit, ...] = ()  # of the zones with the barriers there are
    assessed: tuple[Any, ...] = ()  # shapely polygons: what was assessed completely
    some_areas: bool = False  # whether further release areas are not simulated
    in_part: bool = False  # whether maps are made part by part: sampling_error.level_chances


@dataclass(frozen=True, slots=True)
class Assessment:
    """Result of zoning."""

    hazard: Hazard  # with the barriers there are
    # Without them, and without curves of single cells; None if there are none or not wanted.
    without: Hazard | None
    # Intensities of each single release area; empty unless asked for.
    by_area: dict[str, Intensities]
    risk: RiskTable | None
    risk_without: RiskTable | None
    drawing: Drawing  # how its zones are drawn

    @property
    def without_barriers(self) -> tuple[Sampled, ...]:
        """Return the sources as they reach a line without barriers."""
        return (self.without or self.hazard).sampled


def hazard_of(
    rules: Rules,
    grid: Grid,
    sampled: Sequence[Sampled],
    curves: HazardCurves,
    level: NDArray[np.int16],
    zones: Coverage,
    intensities_of: Callable[[], Intensities],
    chances_of: Callable[[], LevelChances],
    confidence: float,
    edits: Sequence[Edit],
) -> Hazard:
    """Assess the hazard from the counts of a simulation.

    Curves and levels are those of all cells, zones those of hazard level, to which the edits
    belong; ``intensities_of`` returns the zones of intensity, ``chances_of`` the levels of another
    sample; ``confidence`` is that of the sampling interval.
    """
    preset, chances = rules.preset, chances_of()
    not_certain = chances.uncertain(confidence)
    levels, edit, applied = with_edits(zones, edits, [c.code for c in preset.levels])
    applied = tuple(
        replace(own, by_chance=share_of(own.edit.geometry, grid, chances.places, chances.changed))
        for own in applied
    )
    reached = np.searchsorted(chances.places, curves.places)
    of_cells = not_certain[reached], chances.lowered[reached]
    return Hazard(
        sampled=tuple(sampled),
        curves=curves,
        computed=zones,
        levels=levels,
        facts=zone_facts(sampled, curves, preset, levels, grid, *of_cells, edit),
        intensities=intensities_of(),
        chances=chances,
        uncertain=not_certain,
        edits=applied,
    )


def assess(
    rules: Rules,
    grid: Grid,
    energies_kj: np.ndarray,
    sampled: Sequence[Sampled],
    without: Sequence[Sampled] | None,
    *,
    confidence: float,
    by_source: bool,
    drawing_of: Callable[[Bounds], Drawing] | None = None,
    jobs: int = 1,
) -> Assessment:
    """Assess hazard and risk from the counts of a simulation.

    ``without`` are the same sources without barriers; ``by_source`` asks for zones of
    intensity of each single release area. ``drawing_of`` returns the drawing for a sheet that shows
    the cells with a level; default: that of the rules. If ``jobs`` is more than 1, zones of
    intensity and the levels of another sample are found in other threads, most of the time without
    the GIL.
    """
    both = [sampled] if without is None else [sampled, without]
    curves = [curves_of(own, energies_kj) for own in both]
    levels = [hazard_level(own, rules.preset) for own in curves]
    if drawing_of is not None:
        rules = replace(rules, zones=drawing_of(_extent(curves, levels, grid)))
    rims = rims_of(sampled, grid)
    names = dict.fromkeys(s.source.area for s in sampled) if by_source else {}
    of_areas = {name: [s for s in sampled if s.source.area == name] for name in names}

    def intensities_of(area: str) -> Intensities:
        mine = of_areas[area]
        own = curves_of(mine, energies_kj)
        return intensity_maps(own, rules.preset, grid, rules.zones, rims_of(mine, grid))

    with ExitStack() as until_done:
        pool = ThreadPoolExecutor(jobs) if jobs > 1 else None
        if pool is not None:
            # After an error nothing more is begun.
            until_done.callback(pool.shutdown, cancel_futures=True)

        def begun(work: Callable[[], T]) -> Callable[[], T]:
            return work if pool is None else pool.submit(work).result

        drawn = [
            begun(partial(intensity_maps, own, rules.preset, grid, rules.zones, rims))
            for own in curves
        ]
        known = np.isfinite(grid.values)
        chances = [
            begun(partial(level_chances, *own, rules.preset, known, rules.in_part))
            for own in zip(curves, levels, strict=True)
        ]
        drawn_of = {area: begun(partial(intensities_of, area)) for area in of_areas}
        zones = level_zones(curves, levels, rules.preset, grid, rules.zones, rims)

        def hazard(k: int, edits: Sequence[Edit]) -> Hazard:
            own = both[k], curves[k], levels[k], zones[k], drawn[k], chances[k]
            return hazard_of(rules, grid, *own, confidence, edits)

        after = hazard(0, rules.edits)
        before = None if without is None else hazard(1, ()).without_curves()
        by_area = {area: of_area() for area, of_area in drawn_of.items()}
    risk_before = None if without is None else risk_of(rules, without, energies_kj)
    return Assessment(
        after, before, by_area, risk_of(rules, sampled, energies_kj), risk_before, rules.zones
    )


def _extent(
    curves: Sequence[HazardCurves], levels: Sequence[NDArray[np.int16]], grid: Grid
) -> Bounds:
    """Return the extent of the cells with a level (m); that of the grid without any."""
    cells = np.concatenate([c.places[k > 0] for c, k in zip(curves, levels, strict=True)])
    if not cells.size:
        return grid.bounds
    x, y = grid.cell_centres(cells)
    half = 0.5 * grid.cell_size
    return x.min() - half, y.min() - half, x.max() + half, y.max() + half


def risk_of(rules: Rules, sampled: Sequence[Sampled], energies: np.ndarray) -> RiskTable | None:
    """Return the risk of the exposed objects; None if there are none."""
    if rules.vulnerability is None:
        return None
    sources, counts = [s.source for s in sampled], [s.objects for s in sampled]
    limits = rules.preset.thresholds_kj
    return assess_risk(rules.placed.objects, sources, counts, energies, limits, rules.vulnerability)
