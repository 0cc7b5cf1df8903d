"""Hazard curves against rocks that are simulated and counted one at a time, in plain Python.

Each rock is released alone, so that what it leaves in the cells of its line is its own largest
energy there. Nothing of what adds up in the program takes part: not the counting at thresholds, not
the joining of chunks, not the windows or the objects.
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers.zone_slope import Case, Zoned, box, place, two_areas, zoned
from shapely import ops

from sassgis.engine.simulate import simulate
from sassgis.settings.statistics_table import bins_of
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.prepare import draw_keys, prepare_lines
from sassgis.terrain.release import take

#: Area, scenario, line, repetition: cells with the largest energy of a rock there (kJ).
Rock = tuple[str, str, int, int, dict[int, float]]
#: The straight line across each cell from where its path enters to where it leaves, in cells.
Chords = dict[int, shapely.LineString]


def across(
    trace: shapely.LineString, low: float, high: float, cells: Iterable[int], n_cols: int
) -> Chords:
    """The chord of a line in each of some cells, as far as a block went on it."""
    out = {}
    for cell in cells:
        row, col = divmod(cell, n_cols)
        inside = trace.intersection(shapely.box(col, row, col + 1, row + 1))
        ends = sorted(trace.project(shapely.Point(p)) for p in shapely.get_coordinates(inside))
        chord = shapely.LineString([trace.interpolate(ends[0]), trace.interpolate(ends[-1])])
        scale = chord.length / (ends[-1] - ends[0])
        out[cell] = ops.substring(
            chord, max(low - ends[0], 0.0) * scale, min(high, ends[-1]) * scale - ends[0] * scale
        )
    return out


def rocks_one_by_one(zoned: Zoned) -> tuple[list[Rock], list[Chords]]:
    """Simulate every rock of a run by itself."""
    run, planned = zoned.done.run, zoned.done.planned
    out: list[Rock] = []
    chords: list[Chords] = []
    n = run.release.rocks_per_point
    for point in range(len(planned.points)):
        starts = take(planned.starts, np.array([point]))
        line = trace(run.grid, planned.surface, starts, run.terrain)
        prepared = prepare_lines(run, line)
        if not len(prepared):
            continue
        course = shapely.LineString(
            np.column_stack([line.x - run.grid.west, run.grid.north - line.y]) / run.grid.cell_size
        )
        area = int(starts.area[0])
        moved = planned.moved[point]
        for scenario in planned.scenarios[area]:
            blocks = run.blocks[scenario]
            for number in range(run.repetitions * n):
                # Off the map it counts for all cells that it touches.
                alone = simulate(
                    dataclasses.replace(prepared.profiles, on_map=None),
                    run.table,
                    blocks,
                    run.engine,
                    seed=run.seed,
                    rocks_per_line=1,
                    line_keys=draw_keys(starts.key, blocks.name, number // n),
                    starts=prepared.starts(np.array([moved])),
                    control_lines=prepared.crossings,
                    first_rock=number % n,
                    bins=bins_of(run),
                    log_events=2000,
                )
                came = alone.sums["reach"] == 1
                cells = alone.cells[came].tolist()
                energy = alone.sums["energy_max"][came].tolist()
                # A block turns back at an event, if it does.
                chainage = alone.event_logs[0]["x_m"] / run.grid.cell_size
                chords.append(
                    across(course, chainage.min(), chainage.max(), cells, run.grid.shape[1])
                )
                stratum = point * run.repetitions + number // n
                out.append(
                    (run.areas[area].name, blocks.name, stratum, number,
                     dict(zip(cells, energy, strict=True)))
                )  # fmt: skip
    return out, chords


def in_windows(
    rocks: Iterable[Rock], chords: Iterable[Chords], n_rows: int, n_cols: int, radius: float
) -> list[Rock]:
    """Each rock with its largest energy within a radius (in cells) of the centre of every cell."""
    centres = shapely.points(
        *(c.ravel() + 0.5 for c in np.meshgrid(*map(np.arange, (n_cols, n_rows))))
    )
    tree = shapely.STRtree(centres)
    out = []
    for (area, scenario, line, number, own), paths in zip(rocks, chords, strict=True):
        around: dict[int, float] = {}
        for cell, energy in own.items():
            for there in tree.query(paths[cell], "dwithin", radius).tolist():
                around[there] = max(around.get(there, 0.0), energy)
        out.append((area, scenario, line, number, around))
    return out


def on_objects(rocks: Iterable[Rock], cells: list[set[int]]) -> list[Rock]:
    """Each rock with its largest energy on every object that it comes to."""
    out = []
    for area, scenario, line, number, own in rocks:
        hit = {}
        for thing, ground in enumerate(cells):
            there = [own[c] for c in ground & own.keys()]
            if there:
                hit[thing] = max(there)
        out.append((area, scenario, line, number, hit))
    return out


def counted(rocks: list[Rock], source: tuple[str, str], energies: list[float]) -> tuple:
    """Rocks of a source by place and energy, the squares by stratum, and how many rocks it has."""
    per_line: dict[tuple[int, int], list[int]] = defaultdict(lambda: [0] * len(energies))
    count: dict[int, list[int]] = defaultdict(lambda: [0] * len(energies))
    own = [r for r in rocks if r[:2] == source]
    for _, _, line, _, places in own:
        for place_, energy in places.items():
            for k, e in enumerate(energies):
                if energy >= e:
                    count[place_][k] += 1
                    per_line[place_, line][k] += 1
    square: dict[int, list[int]] = defaultdict(lambda: [0] * len(energies))
    for (place_, _), numbers in per_line.items():
        square[place_] = [a + b * b for a, b in zip(square[place_], numbers, strict=True)]
    return count, square, len(own)


def make(folder: Path, **settings: dict[str, object]) -> tuple[Case, Zoned]:
    case = two_areas(folder, terrain={"path": "fall_line"}, **settings)
    # Two houses, one of them on its corner, and people at a point in the gully.
    corner = shapely.affinity.rotate(box(60.3, 33.2, 4.7, 3.1), 30.0)
    case.expose(
        "houses", "building", {"corner": corner, "upper": box(50.0, 30.0, 3.0, 6.0)},
        {"value": [1e5, 2e5], "persons": [2.0, 3.0]}, presence=0.6,
    )  # fmt: skip
    bench = {"bench": shapely.Point(*place(45.2, 35.4))}
    case.expose("people", "people", bench, persons=1, presence=0.1, radius_m=5.0)
    case.sections["release"] |= {"spacing_m": 4.5, "rocks_per_point": 6}
    # With the turning ellipse the centre steps by centimetres where rolling ends; with others only
    # where a block lands softly: with this spacing none does so at the rim of a window.
    case.sections["engine"] = {"readings": "1986"}
    # A second round of rocks, which is never enough.
    case.sections["hazard"] |= {"blocks": "auto", "changed_share_max": 0.0001, "blocks_max": 700}
    case.write()
    return case, zoned(case.config, folder / "work")


@pytest.fixture(
    scope="module",
    params=[pytest.param(2.0, marks=pytest.mark.battery), 5.0],
    ids=["one cell", "5 m"],
)
def both(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Zoned, list[Rock], list[Rock]]:
    """A run; its rocks with the cells they touch; with those for which they count."""
    _, zoned = make(tmp_path_factory.mktemp("counted"), hazard={"ref_width_m": request.param})
    rocks, chords = rocks_one_by_one(zoned)
    grid = zoned.done.run.grid
    radius = 0.5 * request.param / grid.cell_size
    return zoned, rocks, in_windows(rocks, chords, *grid.shape, radius)


def test_there_is_something_to_count(both) -> None:
    zoned, rocks, _ = both
    assert len({r[:2] for r in rocks}) == 4
    assert len(rocks) == sum(s.source.rocks for s in zoned.found.hazard.sampled) > 300
    assert (zoned.done.run.release.rocks_per_point, zoned.done.run.repetitions) == (6, 2)
    assert max(max(r[4].values()) for r in rocks if r[4]) > 300.0
    # Rocks of both areas meet in the gully.
    north, south = ({c for r in rocks if r[0] == name for c in r[4]} for name in ("north", "south"))
    assert len(north & south) > 20


def test_counts_are_the_same(both) -> None:
    zoned, _, rocks = both
    energies = zoned.curves.energies_kj.tolist()
    for s in zoned.found.hazard.sampled:
        count, square, n = counted(rocks, (s.source.area, s.source.scenario), energies)
        assert n == s.source.rocks
        assert s.cells.places.tolist() == sorted(count)
        assert s.cells.count.tolist() == [count[c] for c in sorted(count)]
        assert s.cells.square.tolist() == [square[c] for c in sorted(count)]


def test_rates_are_the_same_to_machine_precision(both) -> None:
    zoned, _, rocks = both
    curves = zoned.curves
    energies = curves.energies_kj.tolist()
    terms: dict[int, list[list[float]]] = defaultdict(lambda: [[] for _ in energies])
    yearly = {"frequent": 0.4, "rare": 0.03}
    for area in ("north", "south"):
        for scenario, frequency in yearly.items():
            count, _, n = counted(rocks, (area, scenario), energies)
            for cell, numbers in count.items():
                for k, number in enumerate(numbers):
                    terms[cell][k].append(frequency * number / n)
    assert curves.places.tolist() == sorted(terms)
    wanted = np.array([[math.fsum(t) for t in terms[c]] for c in sorted(terms)])
    np.testing.assert_allclose(curves.rate, wanted, rtol=4 * np.finfo(float).eps)


def test_objects_are_hit_by_the_rocks_that_come_to_their_cells(both) -> None:
    """Whatever the reference width: an object is as wide as it is drawn."""
    zoned, rocks, _ = both
    grid = zoned.done.run.grid
    n_rows, n_cols = grid.shape
    shapes = zoned.rules.placed.geometries
    touched: list[set[int]] = []
    for shape in shapes:
        cells = set()
        for row in range(n_rows):
            for col in range(n_cols):
                if shape.intersection(box(col, row, 1, 1)).area > 1e-6:
                    cells.add(row * n_cols + col)
        touched.append(cells)
    hits = on_objects(rocks, touched)
    energies = zoned.curves.energies_kj.tolist()
    assert sum(bool(h[4]) for h in hits) > 10
    table = zoned.found.risk
    assert table is not None
    for i, s in enumerate(zoned.found.hazard.sampled):
        count, square, n = counted(hits, (s.source.area, s.source.scenario), energies)
        assert s.objects.places.tolist() == sorted(count)
        assert s.objects.count.tolist() == [count[c] for c in sorted(count)]
        assert s.objects.square.tolist() == [square[c] for c in sorted(count)]
        for thing in range(len(shapes)):
            k = [count[thing][energies.index(e)] for e in (0.0, 30.0, 300.0)]
            low, mean, high = k[0] - k[1], k[1] - k[2], k[2]
            per_rock = s.source.frequency / n
            np.testing.assert_allclose(
                table.hits[i, thing], per_rock * np.array([low, mean, high]), rtol=1e-14
            )
            # Loss: vulnerabilities 0.01, 0.1 and 0.5 of the value.
            value = (1e5, 2e5, 0.0)[thing]
            loss = per_rock * value * (0.01 * low + 0.1 * mean + 0.5 * high)
            assert table.values["loss"][i, thing] == pytest.approx(loss, rel=1e-12)
