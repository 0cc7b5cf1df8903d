"""Release points, and the surface on which their fall lines are traced."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sassgis.grid import FloatArray, IntArray
from sassgis.settings.map_run import MapRun, Round
from sassgis.settings.profiles import ReleasePoints
from sassgis.terrain.fall_lines import fall_line_surface
from sassgis.terrain.release import release_points
from sassgis.terrain.stretch import moved_uphill
from sassgis.terrain.surface import Surface


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of a simulation before anything is simulated."""

    points: ReleasePoints  # as placed in the release areas
    starts: ReleasePoints  # where their fall lines begin
    moved: FloatArray  # shape (n,); how far up the slope from the points (m)
    surface: Surface
    scenarios: tuple[tuple[int, ...], ...]  # positions in ``blocks`` of the scenarios of each area
    # Of each area, where they are not those of the run for all; else empty.
    repetitions: tuple[int, ...] = ()

    def blocks_of_point(self, run: MapRun) -> IntArray:
        """Return blocks that are released at each point, shape (n,)."""
        rounds = [self.blocks_of_round(run, own) for own in run.rounds]
        if self.repetitions:
            once = self.blocks_of_round(run, Round())
            rounds = [once * np.array(self.repetitions, np.int64)[self.points.area]]
        blocks: IntArray = np.sum(rounds, axis=0, dtype=np.int64)
        return blocks

    def blocks_of_round(self, run: MapRun, own: Round) -> IntArray:
        """Return blocks of a repetition at each point, shape (n,)."""
        repeated = np.zeros(len(self.points), np.int64)
        for area, scenarios in enumerate(self.scenarios):
            of = self.points.area == area
            for k in scenarios:
                repeated[of] += own.repetitions >> (
                    0 if own.halvings is None else own.halvings[of, k].astype(np.int64)
                )
        return repeated * run.release.rocks_per_point


def placed_points(run: MapRun) -> ReleasePoints:
    """Place the release points of a run; errors are those of release.release_points."""
    return release_points([(a.name, a.geometry) for a in run.areas], run.release, run.seed)


def plan(run: MapRun) -> Plan:
    """Place the release points and prepare the surface; errors are those of placed_points."""
    points = placed_points(run)
    surface = fall_line_surface(run.grid, run.terrain)
    polygonal = np.array([a.geometry.area > 0.0 for a in run.areas], bool)
    distance = 0.5 * run.release.spacing_m if run.release.placement == "grid" else 0.0
    starts, moved = moved_uphill(points, surface, distance, polygonal[points.area])
    names = {b.name: i for i, b in enumerate(run.blocks)}
    return Plan(
        points,
        starts,
        moved,
        surface,
        tuple(tuple(names[s] for s in a.scenarios) for a in run.areas),
    )
