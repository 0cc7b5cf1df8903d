"""Ways that leave the fall line: their width on a plane, in a gully, and on the map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from sassgis.hazard.map_sums import reach_probability
from sassgis.hazard.progress import sample_of
from sassgis.io.read.config import load_config
from sassgis.model.effects import EffectSettings
from sassgis.model.grid import Grid
from sassgis.model.profiles import ReleasePoints
from sassgis.model.release_areas import FallLineSettings
from sassgis.model.settings import LateralDeflection
from sassgis.runs.inputs import read_map_run
from sassgis.runs.map import chunks_of, simulate_map
from sassgis.terrain.fall_lines import fall_line_surface
from sassgis.terrain.plan import plan
from sassgis.terrain.spread import trace_random_paths

SETTINGS = FallLineSettings(smoothing_m=0.0)


def terrain(cell=2.0, bend=0.0, slope=35.0, length=400.0, width=400.0):
    """A plane that falls to the south, hollow towards its middle column."""
    n_rows, n_cols = round(length / cell), round(width / cell)
    y = (np.arange(n_rows) + 0.5) * cell
    x = (np.arange(n_cols) + 0.5) * cell - 0.5 * width
    z = 1500.0 - math.tan(math.radians(slope)) * y[:, None] + bend * x[None, :] ** 2
    return Grid(z, 1000.0, 2000.0, cell)


def paths(grid, lateral, n=600, seed=1, repetition=0, x=None):
    west, _, east, north = grid.bounds
    point = ReleasePoints(
        np.array([0.5 * (west + east) if x is None else x]), np.array([north - 20.0]),
        np.zeros(1, np.int64), np.array([7], np.uint64), ("a",),
    )  # fmt: skip
    return trace_random_paths(
        grid, fall_line_surface(grid, SETTINGS), point, SETTINGS, lateral, n, seed, repetition
    )


def sideways(grid, traces, down):
    """Offset of each line from the fall line at a way down it (m), east positive."""
    out = np.empty(len(traces))
    for i in range(len(traces)):
        own = slice(traces.offset[i], traces.offset[i + 1])
        x, y = traces.x[own], traces.y[own]
        out[i] = np.interp(down, y[0] - y, x - x[0])
    return out


@pytest.mark.parametrize(("cell", "hop"), [(2.0, 10.0), (5.0, 10.0), (5.0, 3.0), (2.0, 40.0)])
def test_kicks_spread_as_a_random_walk(cell, hop):
    # Hops l ~ Exp(h), angles θ ~ N(0, σ): per metre of way the variance across grows by
    # E[l² sin²θ] / E[l] = 2 h E[sin²θ], the last hop being looked at half way; per metre down the
    # slope by that over E[cos θ].
    grid = terrain(cell)
    sigma, down, n = 12.0, 250.0, 1500
    traces = paths(grid, LateralDeflection("kicks", sigma, hop), n)
    across = sideways(grid, traces, down)
    variance = (math.radians(sigma)) ** 2
    sine2 = 0.5 * (1.0 - math.exp(-2.0 * variance))
    way = down / math.exp(-0.5 * variance)
    # Var of a velocity with correlation exp(-s/h): 2 σ² h (L - h (1 - exp(-L/h))).
    expected = 2.0 * sine2 * hop * (way - hop * (1.0 - math.exp(-way / hop)))
    assert across.var() == pytest.approx(expected, rel=4.0 * math.sqrt(2.0 / n))
    assert abs(across.mean()) < 4.0 * math.sqrt(expected / n)


def test_constant_deviations_are_uniform_within_the_width():
    grid = terrain()
    down, percent = 250.0, 20.0
    traces = paths(grid, LateralDeflection("constant", width_percent=percent), 800)
    across = sideways(grid, traces, down)
    half = 0.5 * percent / 100.0 * down
    assert stats.kstest(across, "uniform", (-half, 2.0 * half)).pvalue > 1e-3
    # On a plane the offset is the fan times the way down.
    assert np.abs(across) == pytest.approx(np.abs(traces.fan) * down, abs=0.05)


def test_without_angle_or_width_all_ways_are_the_fall_line():
    grid = terrain()
    for lateral in (
        LateralDeflection("kicks", angle_deg=0.0), LateralDeflection("constant", width_percent=0.0)
    ):  # fmt: skip
        traces = paths(grid, lateral, 5)
        assert np.abs(sideways(grid, traces, 250.0)).max() < 1e-6


def test_ways_depend_on_seed_round_and_number_alone():
    grid = terrain()
    lateral = LateralDeflection()
    one, again, fewer = (paths(grid, lateral, n) for n in (20, 20, 5))
    assert one.x.tobytes() == again.x.tobytes()
    assert fewer.x.tobytes() == one.x[: fewer.x.size].tobytes()
    base = sideways(grid, one, 250.0)
    for other in (paths(grid, lateral, 20, seed=2), paths(grid, lateral, 20, repetition=1)):
        assert (sideways(grid, other, 250.0) != base).all()
    assert np.unique(np.round(base, 6)).size == 20


def test_a_gully_holds_them():
    plane, gully = terrain(), terrain(bend=0.01)
    lateral = LateralDeflection("kicks", 15.0, 10.0)
    free, held = (sideways(g, paths(g, lateral, 300), 250.0) for g in (plane, gully))
    assert held.std() < 0.35 * free.std()


# --- on the map ---


@pytest.fixture(scope="module")
def job(make_valley):
    run = read_map_run(load_config(make_valley()))
    x, y = run.areas[0].geometry.centroid.coords[0]
    n_cols = run.grid.shape[1]
    row, col = divmod(int(run.grid.cell_of(np.array([x]), np.array([y]))[0]), n_cols)
    window = (slice(max(row - 60, 0), row + 90), slice(max(col - 30, 0), col + 160))
    grid = replace(
        run.grid,
        values=np.ascontiguousarray(run.grid.values[window]),
        west=run.grid.west + window[1].start * run.grid.cell_size,
        north=run.grid.north - window[0].start * run.grid.cell_size,
    )
    return replace(
        run, grid=grid, ground=np.ascontiguousarray(run.ground[window]), control_lines=(),
        areas=run.areas[:1], spacing_m=15.0, rocks_per_point=8,
        effects=EffectSettings(LateralDeflection(angle_deg=15.0)), path="fall_line",
    )  # fmt: skip


def test_the_map_grows_wider(job):
    plain = replace(job, effects=EffectSettings())
    wide, narrow = (simulate_map(j, plan(j)).sums.cells.size for j in (job, plain))
    assert wide > 1.3 * narrow
    assert job.lines_per_point == job.rocks_per_point and job.rocks_per_line == 1


def test_sums_do_not_hang_on_jobs_and_chunks(job):
    planned = plan(job)
    states = []
    for jobs, points in ((1, 32), (2, 3), (1, 1)):
        sums = simulate_map(job, planned, jobs=jobs, chunk_points=points).sums.state()
        order = np.argsort(sums["cells"])
        states.append({k: v[order].tobytes() for k, v in sums.items()})
    assert states[0] == states[1] == states[2]
    assert len(chunks_of(planned, 3)) > 1


def test_further_repetitions_take_other_paths(job):
    planned = plan(job)
    one, two = (simulate_map(replace(job, repetitions=n), planned) for n in (1, 2))
    assert two.reasons.sum() == 2 * one.reasons.sum()
    assert two.sums.cells.size > 1.1 * one.sums.cells.size


@pytest.mark.parametrize("form", ["kicks", "constant"])
def test_the_standard_error_is_the_scatter_over_seeds(job, form):
    """Scatter of 60 small runs against the error that each of them states, all cells together."""
    lateral = LateralDeflection(form, angle_deg=15.0)
    tiny = replace(job, effects=EffectSettings(lateral))
    size = tiny.grid.values.size
    total, square, stated = np.zeros(size), np.zeros(size), np.zeros(size)
    n = 60
    for seed in range(n):
        run = replace(tiny, seed=seed)
        planned = plan(run)
        progress = simulate_map(run, planned)
        p, error = reach_probability(
            progress.sums.column("reach").astype(np.int64),
            progress.sums.column("reach_square").astype(np.int64),
            sample_of(run, planned, progress),
        )
        total[progress.sums.cells] += p
        square[progress.sums.cells] += p**2
        stated[progress.sums.cells] += error**2
        assert p.max() <= 1.0
    scatter = (square - total**2 / n) / (n - 1)
    assert (total > 0).sum() > 1000
    assert np.sqrt(scatter.sum() / (stated.sum() / n)) == pytest.approx(1.0, abs=0.2)
