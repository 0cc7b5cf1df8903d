"""A case: what was observed on a slope, and the model's slope and rocks that go with it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sassgis.engine.simulate_paths import PathTerrain
from sassgis.gap.observations.observed import Observations
from sassgis.gap.observations.projection import Projected, StationChainages
from sassgis.model.blocks import BlockPopulation
from sassgis.model.effects import EffectSettings
from sassgis.model.grid import FloatArray, Grid, IntArray
from sassgis.model.ground import GroundTable
from sassgis.model.map_run import Forest
from sassgis.model.profiles import ProfileSet, TraceSet
from sassgis.model.settings import EngineSettings

#: Groups from which on a group counts as one: fewer say nothing of their scatter.
_FEWEST_GROUPS = 3


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
    #: Of each rock what is known as fixed values, the rest as the configuration draws it.
    blocks: tuple[BlockPopulation, ...]
    start: FloatArray  # shape (n_rocks, 2); limits of the chainage at which each starts (m)
    mass_kg: FloatArray  # shape (n_rocks,); as observed, NaN where unknown
    #: Of the sphere of equal volume, shape (n_rocks,); where unknown, of the configured blocks.
    radius_m: FloatArray
    stations: StationChainages  # where lines cross the stations, shape (n_lines, n_stations)
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
        """Group of each rock (block, day, source): what is resampled together, shape (n_rocks,).

        A rock without a group is one of its own.
        """
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
            unit if groups.size >= _FEWEST_GROUPS else np.arange(self.n_rocks), np.int64
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
        """Rows of the table of stations that fall lines cross, from the top down."""
        order = self.stations.order
        crossed = np.asarray(np.isfinite(self.stations.s).any(axis=0), np.bool_)
        return np.asarray(order[crossed[order]], np.int64)

    @property
    def station_s(self) -> FloatArray:
        """Chainage of the stations on the line of each rock (m), shape (n_rocks, n_stations).

        In the order of ``station_names``; NaN where the line does not cross.
        """
        return self.stations.s[self.line][:, self.station_order]

    @property
    def reaches(self) -> tuple[str, ...]:
        """Names of the stretches between release, stations and the end of the run-out."""
        stops = ("release", *self.station_names, "end")
        return tuple(f"{a}-{b}" for a, b in itertools.pairwise(stops))

    def reach_of(self, rock: IntArray, s: FloatArray) -> IntArray:
        """Number of the reach in which points at chainage ``s`` of the lines of rocks lie."""
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
        """Turns at contacts of rocks that leave them, by the speed after, fast enough to fly.

        One that is slower than after a fall of its own diameter tumbles over its edges, whichever
        way they point; such turns are NaN, shape (n,) as all arrays. Without a speed they stay.
        """
        fall = 4.0 * self.engine.gravity_mps2 * self.radius_m[rock]
        return np.where(vt_mps**2 + vn_mps**2 < fall, np.nan, turn_deg)

    def ground_at(self, rock: IntArray, s: FloatArray) -> tuple[IntArray, FloatArray]:
        """Ground at chainages ``s`` of the lines of rocks.

        Returns
        -------
        kind : int64, shape (n,)
            Class of the ground; -1 where there is no rock (below zero).
        dip : float64, shape (n,)
            Positive where the line falls (rad); NaN where there is no rock.
        """
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
