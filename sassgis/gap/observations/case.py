"""A case: observations on a slope, the slope and rocks of the model, campaigns of both."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.simulate_paths import PathTerrain
from sassgis.errors import InputError
from sassgis.gap.constants import (
    CALIBRATED_RUNOUTS,
    DENSITY_KGM3,
    FEWEST_GROUPS,
    GRAVITY_MPS2,
    LEAST_GROUND_SHARE,
    MASS_ERROR_REL,
    PASSING_HEIGHT_ERROR_M,
    POSITION_ERROR_M,
    PROLONG_M,
    ROTATION_ERROR_REL,
    SPEED_ERROR_REL,
    TURN_ERROR_DEG,
)
from sassgis.gap.observations.observed import (
    Observations,
    deposit_masses_kg,
    rock_masses_kg,
    stated_or,
)
from sassgis.gap.observations.projection import (
    ContactRows,
    Projected,
    contacts_of,
    observed_release_points,
    project_observations,
    prolonged,
    station_chainages,
)
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Forest, MapRun
from sassgis.settings.results import ControlLine, ProfileSet, ReleasePoints, TraceSet
from sassgis.settings.settings import EngineSettings
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.prepare import plan, prepare_lines
from sassgis.terrain.release import point_keys, take


@dataclass(frozen=True, slots=True)
class LearnedContacts:
    """Contacts as they were recorded."""

    table: GroundTable  # ground classes with the law of these contacts
    spin_scale: float  # spins over those of a block that turns in the plane of its path
    spin_noise: float  # relative scatter of the spins beyond the errors that are stated


@dataclass(frozen=True, slots=True)
class Case:
    """Observations in the planes of fall lines, with all that is needed to simulate the rocks."""

    observations: Observations
    grid: Grid
    table: GroundTable  # ground classes as configured
    engine: EngineSettings
    effects: EffectSettings  # those that the configuration has switched on already
    forest: Forest | None  # stems on the cells of the grid, if the configuration has any
    traces: TraceSet  # fall lines
    profiles: ProfileSet  # the same unrolled, with a lead-in of ground behind the start (s < 0)
    line: IntArray  # shape (n_rocks,); fall line of each of ``observations.rock_names``
    #: Of each rock known values are fixed; the configuration draws the others.
    blocks: tuple[BlockPopulation, ...]
    start: FloatArray  # shape (n_rocks, 2); limits of the chainage at which each starts (m)
    mass_kg: FloatArray  # shape (n_rocks,); as observed, NaN where unknown
    #: Of the sphere of equal volume, shape (n_rocks,); where unknown, of the configured blocks.
    radius_m: FloatArray
    stations: FloatArray  # chainages of the stations, shape (n_lines, n_stations); NaN: not crossed
    projected: Mapping[str, Projected]  # every point by table, in the plane of its rock's line
    #: What paths are followed on, with the stations; None: rocks keep to their fall lines.
    terrain: PathTerrain | None = None
    #: Factor on the ranges in which the ground may be calibrated; above 1 where the configured
    #: classes are guesses.
    ground_range: float = 1.0
    met: tuple[str, ...] = ()  # classes on which the rocks come
    learned: LearnedContacts | None = None  # None where too few contacts were recorded

    @property
    def n_rocks(self) -> int:
        """Rocks: the units of resampling."""
        return int(self.line.size)

    @property
    def group(self) -> IntArray:
        """Group of each rock (block, day, source) that is resampled together, (n_rocks,)."""
        table = self.observations.rocks
        stated = dict(zip(table.rock_id.tolist(), table.group.tolist(), strict=True))
        numbers: dict[str, int] = {}
        names = self.observations.rock_names
        keys = [f"={g}" if (g := stated.get(name, "")) else name for name in names]
        return np.array([numbers.setdefault(key, len(numbers)) for key in keys], np.int64)

    @property
    def unit(self) -> IntArray:
        """Units of resampling from 0: groups, or rocks where these are too few, (n_rocks,)."""
        groups, unit = np.unique(self.group, return_inverse=True)
        return np.asarray(
            unit if groups.size >= FEWEST_GROUPS else np.arange(self.n_rocks), np.int64
        )

    @property
    def station_names(self) -> tuple[str, ...]:
        """Names of the stations that fall lines cross, from the top down."""
        names = self.observations.stations.station
        return tuple(str(names[j]) for j in self.station_order.tolist())

    @property
    def passed_station(self) -> IntArray:
        """Place in ``station_names`` of the station of each passage; -1: no line crosses it."""
        place = {name: k for k, name in enumerate(self.station_names)}
        stations = self.observations.passages.station.tolist()
        return np.array([place.get(name, -1) for name in stations], np.int64)

    @property
    def station_order(self) -> IntArray:
        """Rows of the table of stations that fall lines cross, by the median chainage."""
        crossed = np.flatnonzero(np.isfinite(self.stations).any(axis=0))
        middle = np.nanmedian(self.stations[:, crossed], axis=0)
        return crossed[np.argsort(middle, kind="stable")]

    @property
    def station_s(self) -> FloatArray:
        """Chainage of ``station_names`` on the lines of rocks (m), (n_rocks, n_stations)."""
        return self.stations[self.line][:, self.station_order]

    @property
    def reaches(self) -> tuple[str, ...]:
        """Names of the stretches between release, stations and the end of the run-out."""
        stops = ("release", *self.station_names, "end")
        return tuple(f"{a}-{b}" for a, b in itertools.pairwise(stops))

    def reach_of(self, rock: IntArray, s: FloatArray) -> IntArray:
        """Find the number of the reach in which points at chainage ``s`` of rocks' lines lie."""
        edges = self.station_s[rock]
        # A line may begin below a station, or pass one by.
        behind = np.where(edges <= np.asarray(s)[:, None], np.arange(1, edges.shape[1] + 1), 0)
        return np.asarray(behind.max(axis=1, initial=0), np.int64)

    @property
    def semi_axes_m(self) -> FloatArray:
        """Half axes in the middle of their limits, longest first, shape (n_rocks, 3)."""
        limits = [(b.axis_1_m, b.axis_2_m, b.axis_3_m) for b in self.blocks]
        axes: FloatArray = 0.5 * np.array(limits, np.float64).sum(axis=2)
        # Of blocks of a given volume they are relative.
        relative = np.array([b.volume_m3 is not None for b in self.blocks])
        axes[relative] *= (self.radius_m[relative] / np.cbrt(axes[relative].prod(axis=1)))[:, None]
        return -np.sort(-axes, axis=1)

    def turns(
        self, rock: IntArray, turn_deg: FloatArray, vt_mps: FloatArray, vn_mps: FloatArray
    ) -> FloatArray:
        """Return turns at contacts that rocks leave, by the speed after, fast enough to fly, (n,).

        One that is slower than after a fall of its diameter tumbles over its edges, whichever way
        they point; such turns are NaN. Without a speed they stay.
        """
        fall = 4.0 * self.engine.gravity_mps2 * self.radius_m[rock]
        return np.where(vt_mps**2 + vn_mps**2 < fall, np.nan, turn_deg)

    def ground_at(self, rock: IntArray, s: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return class (-1: no rock) and dip (rad, positive downhill) of the ground, (n,) each."""
        kind = np.full(rock.size, -1, np.int64)
        dip = np.full(rock.size, np.nan)
        lines = np.where(rock >= 0, self.line[rock], -1)
        for line in np.unique(lines[lines >= 0]).tolist():
            rows = np.flatnonzero(lines == line)
            vertex_s, vertex_z = self.profiles.vertices(line)
            first = int(self.profiles.offset[line])
            j = np.clip(np.searchsorted(vertex_s, s[rows], side="right") - 1, 0, vertex_s.size - 2)
            kind[rows] = self.profiles.ground[first + j]
            dip[rows] = -np.arctan2(np.diff(vertex_z)[j], np.diff(vertex_s)[j])
        return kind, dip


def case_of(run: MapRun, seen: Observations, file: Path) -> Case:
    """Put a configuration and observations together; ``file`` is what messages call these.

    InputError if there is no rock whose fall line can be traced.
    """
    if not seen.rock_names:
        raise InputError(
            "no rocks: neither a table of rocks nor any row with a rock_id",
            file=file,
            field="rocks",
            expected="one row or more",
        )
    traces, line, moved = _fall_lines(run, seen, file)
    prepared = prepare_lines(run, traces)
    stations = station_chainages(traces, seen.stations, prolong_m=PROLONG_M)
    masses = rock_masses_kg(seen)
    row = {name: i for i, name in enumerate(seen.rocks.rock_id.tolist())}
    blocks = tuple(
        _observed(replace(run.blocks[0], name=name), seen, row.get(name), float(mass))
        for name, mass in zip(seen.rock_names, masses, strict=True)
    )
    radius = np.array([_radius(b) for b in blocks], np.float64)
    case = Case(
        observations=seen, grid=run.grid, table=run.table, engine=run.engine, effects=run.effects,
        forest=run.forest, traces=traces, profiles=prepared.profiles, line=line, blocks=blocks,
        start=prepared.starts(moved)[line], mass_kg=masses, radius_m=radius, stations=stations,
        projected=project_observations(seen, traces, line, grid=run.grid, prolonged=run.followed),
    )  # fmt: skip
    case = replace(case, met=classes_met(case))
    if not run.followed:
        return case
    traced = station_traces(case)
    terrain = PathTerrain(
        run.heights, run.ground, run.terrain.segment_tolerance_m, traced, run.forest
    )
    return replace(case, terrain=terrain)


def drop_and_density(blocks: Sequence[BlockPopulation]) -> tuple[float, float]:
    """Return the largest height above the ground of releases (m), and the density (kg/m³).

    A speed counts as its height; densities as the mean of the middles of their limits.
    """
    heights = (own.drop_m[1] + own.speed_mps[1] ** 2 / (2.0 * GRAVITY_MPS2) for own in blocks)
    middles = [middle for own in blocks if (middle := 0.5 * sum(own.density_kgm3)) > 0.0]
    return max(heights, default=0.0), sum(middles) / len(middles) if middles else DENSITY_KGM3


def classes_met(case: Case) -> tuple[str, ...]:
    """Return classes on the fall lines of the rocks, as far down as rocks can have come."""
    stops = case.projected["deposits"].s if "deposits" in case.projected else np.empty(0)
    known = np.concatenate([case.station_s.ravel(), stops])
    known = known[np.isfinite(known)]
    length = np.zeros(len(case.table.classes))
    if "impacts" in case.projected:
        rock, s = case.observations.rock_of("impacts"), case.projected["impacts"].s
        own = (rock >= 0) & np.isfinite(s)
        kind, _ = case.ground_at(rock[own], s[own])
        np.add.at(length, kind[kind >= 0], 1.0)
    # Impacts by themselves say nothing of ground without any.
    limit = CALIBRATED_RUNOUTS * float(known.max()) if known.size else 0.0
    for line in np.unique(case.line).tolist():
        first, last = (int(v) for v in case.profiles.offset[line : line + 2])
        ends_s = np.clip(case.profiles.s[first:last], 0.0, limit)
        np.add.at(length, case.profiles.ground[first : last - 1], np.diff(ends_s))
    return tuple(
        c.name
        for c, own in zip(case.table.classes, length.tolist(), strict=True)
        if own > LEAST_GROUND_SHARE * length.sum()
    )


def station_traces(case: Case) -> list[tuple[ControlLine, FloatArray]]:
    """Return the stations on the map, prolonged, in the order of their names in the case."""
    vertices = case.observations.stations.vertices
    return [
        (ControlLine(name, "station"), prolonged(vertices[row], PROLONG_M))
        for name, row in zip(case.station_names, case.station_order.tolist(), strict=True)
    ]


def _fall_lines(
    run: MapRun, observations: Observations, file: Path
) -> tuple[TraceSet, IntArray, FloatArray]:
    """Return fall lines, that of each rock, and how far up from the release they begin (m)."""
    points, rock = observed_release_points(observations)
    line = np.full(len(observations.rock_names), -1, np.int64)
    if len(points):
        places = np.column_stack([points.x, points.y])
        unique, which = np.unique(places, axis=0, return_inverse=True)
        keys = np.concatenate([point_keys(f"{x:.3f} {y:.3f}", 1) for x, y in unique])
        numbers = np.arange(len(unique), dtype=np.int64)
        x, y = (unique[:, k].copy() for k in (0, 1))
        starts = ReleasePoints(x, y, numbers, keys, tuple(map(str, numbers.tolist())))
        line[rock] = which.ravel()
        moved = np.zeros(len(unique))
    else:
        planned = plan(run)
        starts, moved = planned.starts, planned.moved
    surface = fall_line_surface(run.grid, run.terrain)
    good = prepare_lines(run, trace(run.grid, surface, starts, run.terrain)).good
    if not good.any():
        raise InputError(
            "no fall line can be traced from the release points",
            file=file,
            field="rocks.x, rocks.y",
            found=f"{len(starts)} points",
            expected="points on the terrain model, on a slope",
        )
    line[(line >= 0) & ~good[line]] = -1
    # A rock of unknown release may have come from any of the places: they take turns.
    loose = np.flatnonzero(line < 0)
    line[loose] = np.resize(np.flatnonzero(good), loose.size)
    used, line = np.unique(line, return_inverse=True)
    traces = trace(run.grid, surface, take(starts, used), run.terrain)
    return traces, line.ravel().astype(np.int64), moved[used]


def _observed(
    block: BlockPopulation, observations: Observations, i: int | None, mass: float
) -> BlockPopulation:
    """Return population of a rock, row ``i``: what was observed is fixed, else as configured."""
    if i is None:
        return block
    rocks = observations.rocks
    axes = [float(getattr(rocks, f"semi_axis_{c}_m")[i]) for c in "abc"]
    density = float(rocks.density_kgm3[i])
    speed = float(rocks.release_speed_mps[i])
    changes: dict[str, object] = {}
    if math.isfinite(density):
        changes["density_kgm3"] = (density, density)
    if math.isfinite(speed):
        changes["speed_mps"] = (speed, speed)
    if all(math.isfinite(a) for a in axes):
        changes.update({f"axis_{j + 1}_m": (a, a) for j, a in enumerate(axes)})
        changes["volume_m3"] = changes["volume_exponent"] = None
    elif math.isfinite(mass):
        volume = float(rocks.volume_m3[i])
        if not math.isfinite(volume):
            middle = 0.5 * sum(block.density_kgm3) or DENSITY_KGM3
            volume = mass / (density if math.isfinite(density) else middle)
        changes["volume_m3"] = (volume, volume)
        changes["volume_exponent"] = None
    return replace(block, **changes)  # type: ignore[arg-type]


def _radius(block: BlockPopulation) -> float:
    """Return the radius of the sphere of equal volume of a rock in the middle of its limits (m)."""
    if block.volume_m3 is not None:
        volume = 0.5 * sum(block.volume_m3)
    else:
        limits = (block.axis_1_m, block.axis_2_m, block.axis_3_m)
        volume = 4.0 / 3.0 * math.pi * math.prod(0.5 * sum(axis) for axis in limits)
    return float(np.cbrt(3.0 * volume / (4.0 * math.pi)))


#: Kinds of block: the rock itself, a fragment of it, a block that belongs to no rock.
WHOLE, PIECE, LOOSE = 0, 1, 2


@dataclass(frozen=True, slots=True)
class PassageRows:
    """Passages at stations, columns of shape (n,); NaN where a number was not measured."""

    rock: IntArray  # -1 for a loose block
    station: IntArray  # position in ``Case.station_names``
    kind: IntArray
    lateral_m: FloatArray
    speed_mps: FloatArray
    rotation_hz: FloatArray
    height_m: FloatArray  # of the centre above the ground
    mass_kg: FloatArray


@dataclass(frozen=True, slots=True)
class DepositRows:
    """Blocks where they lie; columns as in PassageRows, ``s`` the chainage (m)."""

    rock: IntArray
    kind: IntArray
    s: FloatArray
    lateral_m: FloatArray
    mass_kg: FloatArray


@dataclass(frozen=True, slots=True)
class ImpactRows:
    """Impacts of whole rocks in the order of time, before and after; columns of shape (n,)."""

    rock: IntArray
    # Chainage and height of the point or the centre (m).
    s: FloatArray
    z: FloatArray
    # Along the ground and its outward normal (m/s), spin (rad/s).
    vt_in: FloatArray
    vn_in: FloatArray
    spin_in: FloatArray
    vt_out: FloatArray
    vn_out: FloatArray
    spin_out: FloatArray
    turn_deg: FloatArray  # in plan, clockwise; NaN of rocks that tumble on (``Case.turns``)
    slope_deg: FloatArray  # dip of the ground along the travel
    # On the map (m); NaN where unknown, as of simulated rocks that keep to their fall lines.
    x: FloatArray
    y: FloatArray


@dataclass(frozen=True, slots=True)
class PathRows:
    """Points of paths of whole rocks, by rock and time; columns of shape (n,)."""

    rock: IntArray
    t_s: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    speed_mps: FloatArray
    rotation_hz: FloatArray


@dataclass(frozen=True, slots=True)
class Campaign:
    """One campaign; a table that was not observed is None."""

    n_rocks: int
    passages: PassageRows | None
    deposits: DepositRows | None
    impacts: ImpactRows | None
    contacts: ContactRows | None = None
    paths: PathRows | None = None  # simulated ones; observed paths are read from their table


@dataclass(frozen=True, slots=True)
class Errors:
    """How a motion is recorded: standard errors, stated or usual, and detection limits."""

    speed_rel: float = SPEED_ERROR_REL
    rotation_rel: float = ROTATION_ERROR_REL
    height_m: float = PASSING_HEIGHT_ERROR_M
    position_m: float = POSITION_ERROR_M
    turn_deg: float = TURN_ERROR_DEG
    mass_rel: float = MASS_ERROR_REL
    stop_m: float = POSITION_ERROR_M  # of the place of a stop; ``position_m``: of any other
    contact_min_normal_speed_mps: float = 0.0  # lighter contacts are not recorded
    contact_min_interval_s: float = 0.0  # sooner than this after one: taken for one with it
    passages_missed_share: float = 0.0  # of those at stations


def errors_of(case: Case) -> Errors:
    """Return errors of measurement of the observations of a case."""
    meta, usual = case.observations.metadata, Errors()
    position_m = stated_or(meta.position_error_m, usual.position_m)
    return Errors(
        stated_or(meta.speed_error_rel, usual.speed_rel),
        stated_or(meta.rotation_error_rel, usual.rotation_rel),
        stated_or(meta.height_error_m, usual.height_m), position_m,
        mass_rel=stated_or(meta.mass_error_rel, usual.mass_rel),
        stop_m=stated_or(meta.stop_error_m, position_m),
    )  # fmt: skip


def observed_campaign(case: Case) -> Campaign:
    """Return the observed campaign of a case."""
    seen = case.observations
    return Campaign(
        case.n_rocks,
        _passages(case) if len(seen.passages) and case.station_names else None,
        _deposits(case) if len(seen.deposits) else None,
        _impacts(case) if len(seen.impacts) else None,
        contacts_of(seen) if len(seen.contacts) else None,
    )


def _kinds(case: Case, table: str) -> tuple[IntArray, IntArray]:
    rock = case.observations.rock_of(table)
    kind = np.where(rock < 0, LOOSE, np.where(case.observations.is_piece(table), PIECE, WHOLE))
    return rock, kind.astype(np.int64)


def _passages(case: Case) -> PassageRows:
    table = case.observations.passages
    rock, kind = _kinds(case, "passages")
    station = case.passed_station
    # A station that the fall line of a rock does not cross has no place on it, here as in replicas.
    known = (station >= 0) & ((rock < 0) | np.isfinite(case.station_s[rock, station]))
    columns: tuple[Any, ...] = (
        rock, station, kind, case.projected["passages"].lateral_m,
        table.speed_mps, table.rotation_hz, table.height_m, table.mass_kg,
    )  # fmt: skip
    return PassageRows(*(values[known] for values in columns))


def _deposits(case: Case) -> DepositRows:
    put = case.projected["deposits"]
    mass_kg = deposit_masses_kg(case.observations)
    return DepositRows(*_kinds(case, "deposits"), put.s, put.lateral_m, mass_kg)


def _impacts(case: Case) -> ImpactRows:
    table = case.observations.impacts
    rock, kind = _kinds(case, "impacts")
    put = case.projected["impacts"]
    order = np.lexsort((table.number, rock))
    order = order[kind[order] == WHOLE]
    turn_deg = case.turns(rock, table.turn_deg, table.vt_out_mps, table.vn_out_mps)
    columns: tuple[Any, ...] = (
        rock, put.s, np.where(np.isfinite(table.z), table.z, put.ground_m),
        table.vt_in_mps, table.vn_in_mps, table.omega_in_radps,
        table.vt_out_mps, table.vn_out_mps, table.omega_out_radps,
        turn_deg, table.slope_deg, table.x, table.y,
    )  # fmt: skip
    return ImpactRows(*(values[order] for values in columns))


def main_blocks(rows: DepositRows, n_rocks: int) -> NDArray[np.int64]:
    """Return the row of the heaviest block of each rock, of unknown masses the first; or -1."""
    best = np.full(n_rocks, -1, np.int64)
    own = np.flatnonzero(rows.rock >= 0)
    mass = np.where(np.isfinite(rows.mass_kg), rows.mass_kg, 0.0)[own]
    # Written last: the heaviest, and among equals the first row.
    for i in own[np.lexsort((-own, mass))].tolist():
        best[rows.rock[i]] = i
    return best
