"""One slope on cells of 1 to 10 m: frequencies, levels and zones do not grow with the cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers import zone_slope
from helpers.zone_slope import NORTH, WEST, Zoned, two_areas, zoned

from sassgis.hazard.levels import hazard_level
from sassgis.simulation.accumulators import kept_stops

pytestmark = pytest.mark.battery

CELLS = (1.0, 2.0, 5.0, 10.0)
WIDTH_M = 10.0
THRESHOLDS_KJ = (0.0, 30.0, 300.0)
# What the terrain between the centres of coarser cells changes: on cells of 10 m the mean path of
# the blocks is 2.5 % shorter than on cells of 1 m (90.0 and 92.4 m, each known to 0.25 m).
TERRAIN = 0.03


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A slope that flattens out and is hollow along its middle, at 25° to the cells (m)."""
    turn = np.radians(25.0)
    along = x * np.cos(turn) + (y - 60.0) * np.sin(turn)
    across = (y - 60.0) * np.cos(turn) - x * np.sin(turn)
    return 1000.0 - 0.9 * along + 0.0016 * along**2 + 0.004 * across**2


def on_cells(folder: Path, cell: float, seed: int) -> Zoned:
    """The slope on some cells, zoned: 216 points with 10 blocks each of both scenarios."""
    folder.mkdir()
    case = two_areas(folder, hazard={"ref_width_m": WIDTH_M}, run={"seed": seed})
    x, y = (np.arange(0.5 * cell, size, cell) for size in (240.0, 200.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zone_slope, "CELL", cell)
        case.write_dem(height(x[None, :], y[:, None]))
    release = shapely.box(WEST + 20.0, NORTH - 100.0, WEST + 40.0, NORTH - 50.0)
    case.write_layer("release.gpkg", [release], {"name": ["north"]})
    case.sections["release"] |= {"spacing_m": 2.0, "rocks_per_point": 10}
    # Of blocks of 3 m³ enough have 300 kJ.
    case.blocks[1] |= {"axis_1_m": [0.9, 1.3], "axis_2_m": 0.9, "axis_3_m": 0.7}
    case.write()
    return zoned(case.config, folder / "work")


@pytest.fixture(scope="module")
def slopes(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[float, int], Zoned]:
    """By size of the cells and seed."""
    folder = tmp_path_factory.mktemp("cells")
    return {
        (cell, seed): on_cells(folder / f"{cell:g} m, {seed}", cell, seed)
        for cell in CELLS
        for seed in (1, 2)
    }


def per_width(zone: Zoned, energy_kj: float) -> float:
    """Rate integrated over the map (m² per year): what all blocks sweep in a year."""
    grid = zone.done.run.grid
    return float(zone.rate(energy_kj).sum()) * grid.cell_size**2


def levels_from(zone: Zoned, least: int) -> float:
    """Area of all cells of a level and above (m²)."""
    level = hazard_level(zone.curves, zone.rules.preset)
    return float((level >= least).sum()) * zone.done.run.grid.cell_size**2


def test_blocks_sweep_a_strip_of_the_reference_width(slopes) -> None:
    """∫ λ dA is frequency · path · width plus the half disks at both ends, whatever the cells."""
    for (cell, _), zone in slopes.items():
        want = 0.0
        for source in (s.source for s in zone.found.hazard.sampled):
            rocks = kept_stops(zone.done.run, zone.done.progress)
            number = [b.name for b in zone.done.run.blocks].index(source.scenario)
            rows = rocks.rocks[rocks.rock_scenario == number]
            path = rows["furthest_m"] - rows["start_m"]
            want += source.frequency * float(np.mean(path * WIDTH_M + 0.25 * np.pi * WIDTH_M**2))
        assert per_width(zone, 0.0) == pytest.approx(want, rel=0.03), cell


@pytest.mark.parametrize("energy_kj", THRESHOLDS_KJ)
def test_frequencies_are_those_of_fine_cells(slopes, energy_kj: float) -> None:
    """Within three times the sampling error of the blocks that have the energy somewhere.

    What one of n blocks sweeps scatters as much as its mean, at most: the sum is known to
    (2/n)^½, and the fine cells have twice as many.
    """
    rows = [kept_stops(z.done.run, z.done.progress).rocks for z in slopes.values()]
    fewest = min(int((own["max_energy_kj"] >= energy_kj).sum()) for own in rows)
    assert fewest > 500
    within = TERRAIN + 3.0 * (1.5 * 2.0 / fewest) ** 0.5
    fine = np.mean([per_width(slopes[1.0, seed], energy_kj) for seed in (1, 2)])
    for (cell, _), zone in slopes.items():
        assert per_width(zone, energy_kj) == pytest.approx(fine, rel=within), cell


@pytest.mark.parametrize("least", [1, 2, 3])
def test_areas_of_levels_are_those_of_fine_cells(slopes, least: int) -> None:
    """Within three times the sampling error, known from the seeds, and that of counting cells.

    An edge of length P runs through P/cell cells, and each counts by its centre: known to
    (P/cell/12)^½ cells.
    """
    areas = {key: levels_from(zone, least) for key, zone in slopes.items()}
    fine = 0.5 * (areas[1.0, 1] + areas[1.0, 2])
    assert fine > 4000.0
    seeds = np.mean([0.5 * (areas[cell, 1] - areas[cell, 2]) ** 2 for cell in CELLS]) ** 0.5
    # That of a strip whose width is a third of its length.
    edge = 2.0 * (fine * 3.0) ** 0.5 * (1.0 + 1.0 / 3.0)
    for (cell, _), found in areas.items():
        counted = cell**2 * (edge / cell / 12.0) ** 0.5
        within = TERRAIN * fine + 3.0 * np.hypot(1.5**0.5 * seeds, counted)
        assert within < 0.15 * fine
        assert found == pytest.approx(fine, abs=within), cell


def test_zones_grow_by_what_their_cells_stand_out_and_no_more(slopes) -> None:
    """A zone holds whole cells: on coarse ones it is larger by a strip of about a cell.

    It is smaller by a fifth at most: single cells that few blocks reach make a fringe, whose gaps
    are closed, and the fringe of fine cells is the wider one.
    """

    def area(zone: Zoned, least: int) -> float:
        levels = zone.found.hazard.levels
        return float(sum(p.area for p in levels.polygons[levels.classes >= least]))

    def edge(zone: Zoned, least: int) -> float:
        levels = zone.found.hazard.levels
        return float(shapely.union_all(levels.polygons[levels.classes >= least]).length)

    for (cell, seed), zone in slopes.items():
        fine = slopes[1.0, seed]
        for least in (1, 2, 3):
            extra = area(zone, least) - area(fine, least)
            assert -0.2 * area(fine, least) < extra < cell * edge(zone, least), (cell, least)
