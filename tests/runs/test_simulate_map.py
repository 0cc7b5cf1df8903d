"""The sums of a run do not hang on threads, chunks or company, and they are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from helpers.map_sums_state import assert_same

from sassgis.outputs.layers.maps import map_layers
from sassgis.settings.results import LineEnd, StopReason
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.accumulators import Progress, joined_rows, line_ends, sample_of
from sassgis.simulation.loop import simulate_map
from sassgis.simulation.map_sums import MapSums
from sassgis.terrain.prepare import plan


@pytest.fixture(scope="module")
def whole(job, planned) -> Progress:
    return simulate_map(job, planned)


@pytest.mark.parametrize(("jobs", "chunk_points"), [(2, 5), (1, 1), (1, 1000)])
def test_sums_are_the_same_bits_for_any_jobs_and_chunks(
    job, planned, whole, jobs: int, chunk_points: int
) -> None:
    assert_same(simulate_map(job, planned, jobs=jobs, chunk_points=chunk_points), whole)


def test_another_seed_gives_other_rocks(job, planned, whole) -> None:
    other = replace(job, seed=job.seed + 1)
    mine = joined_rows(simulate_map(other, plan(other)).stops).rocks
    theirs = joined_rows(whole.stops).rocks
    assert mine.size == theirs.size
    assert (mine["mass_kg"] != theirs["mass_kg"]).all()


def test_maps_agree_with_each_rock_looked_at_alone(job, monkeypatch: pytest.MonkeyPatch) -> None:
    """One rock per line and one line per chunk: what is added is then the values of one rock."""
    one = replace(job, release=replace(job.release, rocks_per_point=1, spacing_m=5.0))
    planned = plan(one)
    extreme = {"energy": "max", "height": "max", "speed": "max", "arrival": "min"}
    seen: dict[str, list[tuple[int, float]]] = {name: [] for name in extreme}
    stopped: list[int] = []
    add = MapSums.add

    def listen(self, cells, columns, *more) -> None:
        came = columns["reach"] > 0
        assert columns["reach"].max(initial=0) <= 1
        for name, values in seen.items():
            own = columns[f"{name}_{extreme[name]}"][came]
            values += zip(cells[came].tolist(), own.tolist(), strict=True)
        stopped.extend(cells[columns["stops"] > 0].tolist())
        add(self, cells, columns, *more)

    monkeypatch.setattr(MapSums, "add", listen)
    progress = simulate_map(one, planned, chunk_points=1)
    bins = bins_of(one).edges
    layers = map_layers(
        progress.sums, one.grid.shape, sample_of(one, progress), bins, one.grid.cell_size
    )
    band = {(a.stem, b.name): b.values.ravel() for a in layers for b in a.bands}
    counts = np.bincount([c for c, _ in seen["energy"]], minlength=one.grid.values.size)
    assert np.array_equal(np.nan_to_num(band["passages", "passages"]), counts)
    assert np.array_equal(
        np.nan_to_num(band["stops", "stops"]), np.bincount(stopped, minlength=counts.size)
    )
    assert counts.max() >= 8
    above = ((0.5, "q50"), (0.9, "q90"), (0.95, "q95"), (0.99, "q99"))
    for name, stem, bands in (
        ("energy", "energy", above),
        ("height", "passing_height", above),
        ("speed", "speed", above),
        ("arrival", "arrival_time", ((0.05, "q5"), (0.5, "q50"))),
    ):
        values: dict[int, list[float]] = {}
        for cell, value in seen[name]:
            values.setdefault(cell, []).append(value)
        edges = bins[name]
        for cell, own in values.items():
            own.sort()
            end = extreme[name]
            assert band[stem, end][cell] == np.float32(own[-1 if end == "max" else 0])
            for p, q in bands:
                # The smallest value that p of the rocks do not exceed: in the same bin.
                exact = own[int(np.ceil(p * len(own) - 1e-9)) - 1]
                i = min(int(np.searchsorted(edges, exact, side="right")) - 1, edges.size - 2)
                found = float(band[stem, q][cell])
                assert edges[i] * (1 - 1e-6) <= found <= edges[i + 1] * (1 + 1e-6)
            if name == "energy":
                assert band[stem, "mean"][cell] == pytest.approx(np.mean(own), rel=1e-5, abs=1e-3)


def test_rocks_that_cannot_be_followed_are_counted(job) -> None:
    """On nodata, and in the last column of the terrain model where it falls outwards."""
    x, y = job.areas[0].geometry.representative_point().coords[0]
    values = job.grid.values.copy()
    hole = job.grid.cell_of(np.array([x + 30.0]), np.array([y]))[0]
    row, col = divmod(int(hole), job.grid.shape[1])
    values[row - 3 : row + 4, col - 3 : col + 4] = np.nan
    areas = (
        replace(job.areas[0], name="good", geometry=shapely.Point(x, y)),
        replace(job.areas[0], name="hole", geometry=shapely.Point(x + 30.0, y)),
    )
    some = replace(job, areas=areas, grid=replace(job.grid, values=values))
    planned = plan(some)
    progress = simulate_map(some, planned)
    assert progress.lost == 6 and progress.reasons.sum() == 6
    assert planned.blocks_of_point(some).sum() == progress.lost + progress.reasons.sum()
    never = progress.reasons[StopReason.NEVER_STARTED]
    assert sample_of(some, progress).started == 6 - never


def test_rocks_leave_a_terrain_model_that_ends_too_early(job) -> None:
    x, _ = job.areas[0].geometry.representative_point().coords[0]
    cut = int((x + 60.0 - job.grid.west) / job.grid.cell_size)
    grid = replace(job.grid, values=np.ascontiguousarray(job.grid.values[:, :cut]))
    short = replace(
        job, grid=grid, ground=np.ascontiguousarray(job.ground[:, :cut]), areas=job.areas[:1],
        control_lines=(),
    )  # fmt: skip
    progress = simulate_map(short, plan(short))
    assert progress.reasons[StopReason.LEFT_PROFILE] > 0
    ends = line_ends(progress)
    assert sum(ends.values()) == len(plan(short).points)
    assert ends[LineEnd.LEFT_DEM] > 0
