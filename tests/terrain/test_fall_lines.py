from __future__ import annotations

import numpy as np
import pytest
from helpers.terrains import grid_of, middle, points_at
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sassgis.grid import FloatArray, Grid
from sassgis.settings.results import LineEnd, TraceSet
from sassgis.settings.settings import TerrainSettings
from sassgis.terrain.fall_lines import _closes, fall_line_surface, trace
from sassgis.terrain.release import take

pytestmark = pytest.mark.kernels

SHARP = TerrainSettings(smoothing_m=0.0)


def run(grid: Grid, x: object, y: object, settings: TerrainSettings = SHARP) -> TraceSet:
    return trace(grid, fall_line_surface(grid, settings), points_at(x, y), settings)


def line(traces: TraceSet, i: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    own = slice(int(traces.offset[i]), int(traces.offset[i + 1]))
    return traces.x[own], traces.y[own], traces.s[own]


def headings(traces: TraceSet, i: int = 0) -> FloatArray:
    """Direction of each step (rad), counter-clockwise from east, without jumps of a full turn."""
    x, y, _ = line(traces, i)
    return np.unwrap(np.arctan2(np.diff(y), np.diff(x)))


@settings(max_examples=15)
@given(st.floats(0, 360), st.floats(21, 75), st.floats(-20, 20), st.floats(-20, 20))
def test_lines_on_planes_are_straight_and_long_enough(
    azimuth: float, slope: float, dx: float, dy: float
) -> None:
    east, north = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    tangent = np.tan(np.radians(slope))
    grid = grid_of(lambda x, y: 500 - tangent * (x * east + y * north))
    mx, my = middle(grid)
    x, y, s = line(traces := run(grid, mx + dx, my + dy))
    assert traces.end[0] == LineEnd.LEFT_DEM
    across = (x - x[0]) * north - (y - y[0]) * east
    along = (x - x[0]) * east + (y - y[0]) * north
    assert np.abs(across).max() < 1e-6
    assert np.allclose(along, s, atol=1e-6)
    # It reaches the edge of the DEM, and no further.
    west, south, right, top = grid.bounds
    gap = min(x[-1] - west, right - x[-1], y[-1] - south, top - y[-1])
    assert 0.0 <= gap < 1e-4 * grid.cell_size
    # Shifts of position are rounded to 2^-28 of a cell.
    assert np.diff(s).max() <= grid.cell_size * (1.0 + 1e-8)


def test_steps_do_not_matter() -> None:
    """The same smooth terrain on a grid twice as fine gives the same line."""

    def terrain(x: FloatArray, y: FloatArray) -> FloatArray:
        return 500 + 0.6 * y + 6 * np.sin(x / 25) * np.cos(y / 30)

    coarse, fine = grid_of(terrain), grid_of(terrain, 200, 200, cell=1.0)
    mx, my = middle(coarse)
    for dx in (-31.0, 0.0, 17.0):
        x1, y1, _ = line(run(coarse, mx + dx, my + 80.0))
        x2, y2, _ = line(run(fine, mx + dx, my + 80.0))
        order = np.argsort(y2)
        assert np.abs(x1 - np.interp(y1, y2[order], x2[order])).max() < 0.02


@pytest.mark.parametrize("turn", [0.0, 17.0, 45.0])
@pytest.mark.parametrize("axis_slope", [10.0, 35.0])
def test_a_gully_is_followed_without_zigzag(turn: float, axis_slope: float) -> None:
    """V with sides of 40° and a bottom 2 cells wide: lines join the axis and stay on it."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    fall = np.tan(np.radians(axis_slope))

    def terrain(x: FloatArray, y: FloatArray) -> FloatArray:
        across = y * c - x * s
        return 900 - fall * (x * c + y * s) + 0.84 * np.sqrt(across**2 + 2.0**2)

    grid = grid_of(terrain, 160, 160)
    settings = TerrainSettings(smoothing_m=2.0, energy_line_angle_deg=0.0)
    mx, my = middle(grid)
    for side in (-18.0, 23.5):
        along0 = -60.0
        start = mx + along0 * c - side * s, my + along0 * s + side * c
        traces = run(grid, *start, settings)
        x, y, _ = line(traces)
        across = (y - my) * c - (x - mx) * s
        along = (x - mx) * c + (y - my) * s
        assert along[-1] > 60.0
        inner = along < 90.0
        # It comes down its side, rounds into the axis once, and stays there.
        assert (across * np.sign(side))[inner].min() > -0.05 * grid.cell_size
        joined = inner & (along > along0 + 75.0)
        assert np.abs(across[joined]).max() < 0.05 * grid.cell_size
        assert np.abs(np.degrees(headings(traces))[joined[1:]] - turn).max() < 3.0


def test_the_dem_resolution_does_not_pull_lines_into_its_axes() -> None:
    """On a smooth dome all directions are equal."""
    grid = grid_of(lambda x, y: 900 - (x**2 + y**2) / 100, 120, 120)
    mx, my = middle(grid)
    azimuths = np.radians(np.arange(0.0, 360.0, 5.0))
    traces = run(grid, mx + 60 * np.cos(azimuths), my + 60 * np.sin(azimuths))
    for i, azimuth in enumerate(azimuths):
        # The last cells before the edge, where the spline lacks neighbours, are left out.
        x, y, _ = line(traces, i)
        inner = np.maximum(np.abs(x - mx), np.abs(y - my))[1:] < 110.0
        assert np.abs(headings(traces, i) - headings(traces, i)[0])[inner].max() < 1e-5
        assert np.cos(headings(traces, i)[0] - azimuth) > 1 - 1e-6


def valley(x: FloatArray, y: FloatArray) -> FloatArray:
    """A slope of 35° to the south, a floor 100 m wide falling by 0.8 % eastward, a counter-slope.

    A river runs along the floor in a shallow bed.
    """
    side = np.maximum(y, 0.0) * 0.7 + np.maximum(-100.0 - y, 0.0) * 0.5
    return 600 + side - 0.008 * x - 0.6 * np.exp(-(((y + 50.0) / 8.0) ** 2))


def test_a_line_runs_over_a_valley_floor_and_up_the_other_side() -> None:
    grid = grid_of(valley, 100, 240)
    mx, my = middle(grid)
    settings = TerrainSettings(smoothing_m=4.0)
    traces = run(grid, mx - 20.0, my + 150.0, settings)
    x, y, _ = line(traces)
    # 105 m of fall over 150 m + 100 m of floor: 14 m are left at 20° on the other side, which
    # rises by 0.5 against the 0.364 of the line.
    assert traces.end[0] == LineEnd.ENERGY_LINE
    left = 105.0 - 250.0 * np.tan(np.radians(20.0))
    assert my - 100.0 - y[-1] == pytest.approx(left / (0.5 + np.tan(np.radians(20.0))), abs=2.0)
    # It is hardly drawn along the floor, and not at all along the river.
    assert abs(x[-1] - x[0]) < 12.0


def test_a_line_crosses_a_bank_and_follows_the_descent_again() -> None:
    def terrain(x: FloatArray, y: FloatArray) -> FloatArray:
        return 900 + 0.6 * y + 12.0 * np.exp(-(((y - 0.0) / 12.0) ** 2)) + 0.0 * x

    grid = grid_of(terrain, 100, 240)
    mx, my = middle(grid)
    x, y, _ = line(traces := run(grid, mx, my + 150.0))
    assert traces.end[0] == LineEnd.LEFT_DEM
    assert y[-1] < grid.bounds[1] + 1e-3
    assert np.abs(x - x[0]).max() < 1e-3


def test_a_line_passes_through_a_pit() -> None:
    def terrain(x: FloatArray, y: FloatArray) -> FloatArray:
        return 900 + 0.6 * y - 9.0 * np.exp(-((x - 1.0) ** 2 + y**2) / 60.0)

    grid = grid_of(terrain, 100, 160)
    mx, my = middle(grid)
    traces = run(grid, [mx, mx + 3.0, mx - 4.0], my + np.array([120.0, 120.0, 120.0]))
    for i in range(3):
        _, y, s = line(traces, i)
        assert traces.end[i] == LineEnd.LEFT_DEM
        assert y[-1] < grid.bounds[1] + 1e-3
        assert s[-1] < 1.1 * (y[0] - y[-1])


def test_a_line_closes_where_it_comes_within_half_a_cell_of_itself() -> None:
    radius = 40.0
    s = np.arange(260.0)
    circle = np.column_stack([radius * np.cos(s / radius), radius * np.sin(s / radius), s])
    closed = [k for k in range(1, 261) if _closes(circle, k)]
    assert circle[closed[0] - 1, 2] == np.ceil(2.0 * np.pi * radius - 0.5)
    # A line that leads away never does.
    assert not _closes(np.column_stack([s, 0.0 * s, s]), 260)


def test_energy_line_ends_a_line_where_the_terrain_rises_above_it() -> None:
    def terrain(x: FloatArray, y: FloatArray) -> FloatArray:
        return 600 + np.where(y > 0, y, 0.15 * y) + 0.0 * x

    grid = grid_of(terrain, 60, 400)
    mx, my = middle(grid)
    for angle in (20.0, 25.0, 30.0):
        settings = TerrainSettings(smoothing_m=0.0, energy_line_angle_deg=angle)
        traces = run(grid, mx, my + 100.0, settings)
        _, _, s = line(traces)
        tangent = np.tan(np.radians(angle))
        # 100 m down over the first 100 m, then 0.15 per metre: s tan = 100 + 0.15 (s - 100).
        assert traces.end[0] == LineEnd.ENERGY_LINE
        assert s[-1] == pytest.approx(85.0 / (tangent - 0.15), abs=1e-6)


def test_a_shoulder_above_a_cliff_does_not_end_the_line() -> None:
    def terrain(x: FloatArray, y: FloatArray) -> FloatArray:
        return 600 + np.where(y > 0, 0.2 * y, 1.2 * y) + 0.0 * x

    grid = grid_of(terrain, 60, 160)
    mx, my = middle(grid)
    # The first 25 m are free, so that the cliff is reached from 20 m above it and not from 30 m.
    assert run(grid, mx, my + 20.0).end[0] == LineEnd.LEFT_DEM
    stopped = run(grid, mx, my + 30.0)
    assert stopped.end[0] == LineEnd.ENERGY_LINE
    assert stopped.s[-1] == pytest.approx(25.0, abs=1e-6)


def test_max_length_is_kept_exactly(rough_grid: Grid) -> None:
    settings = TerrainSettings(smoothing_m=0.0, max_line_length_m=77.7)
    mx, my = middle(rough_grid)
    traces = run(rough_grid, mx, my + 100.0, settings)
    assert traces.end[0] == LineEnd.MAX_LENGTH
    assert traces.s[-1] == pytest.approx(77.7, abs=1e-6)
    assert np.allclose(np.hypot(np.diff(traces.x), np.diff(traces.y)), np.diff(traces.s), atol=1e-9)


@settings(max_examples=15)
@given(st.floats(0, 360), st.integers(0, 2**31))
def test_lines_end_at_the_border_of_nodata(azimuth: float, seed: int) -> None:
    """However the nodata lies, no point of a line is in it, and the end touches it."""
    east, north = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    whole = grid_of(lambda x, y: 500 - 0.7 * (x * east + y * north))
    values = whole.values.copy()
    rng = np.random.default_rng(seed)
    values[rng.random(values.shape) < 0.01] = np.nan
    values[48:53, 48:53] = whole.values[48:53, 48:53]
    grid = Grid(values, whole.west, whole.north, whole.cell_size)
    mx, my = middle(grid)
    # Not on a border between cells: a line along one has the cells of both sides beside it.
    x, y, s = line(traces := run(grid, mx + 0.37, my + 0.21))
    known = np.isfinite(values).ravel()
    # Between its points too: a line could cut the corner of a cell.
    fine_s = np.linspace(0.0, s[-1], 20 * s.size)
    cells = grid.cell_of(np.interp(fine_s, s, x), np.interp(fine_s, s, y))
    assert (cells >= 0).all()
    assert known[cells].all()
    beyond = grid.cell_of(
        np.array([x[-1] + 1e-5 * grid.cell_size * east]),
        np.array([y[-1] + 1e-5 * grid.cell_size * north]),
    )[0]
    if traces.end[0] == LineEnd.LEFT_DEM:
        assert beyond == -1
    else:
        assert traces.end[0] == LineEnd.NODATA
        assert not known[beyond]


def test_release_points_without_ground_give_single_points() -> None:
    grid = grid_of(lambda x, y: 500 + 0.7 * y)
    grid.values[50, 50] = np.nan
    x, y = grid.cell_centres(np.array([50 * 100 + 50]))
    traces = run(grid, [x[0], grid.west - 1.0, x[0] + 30], [y[0], y[0], y[0]])
    assert list(traces.end) == [LineEnd.NODATA, LineEnd.LEFT_DEM, LineEnd.LEFT_DEM]
    assert list(np.diff(traces.offset)[:2]) == [1, 1]
    assert traces.x[1] == grid.west - 1.0
    assert np.diff(traces.offset)[2] > 50


def test_level_ground_gives_a_single_point() -> None:
    traces = run(grid_of(lambda x, y: 500 + 0 * x), 1100.0, 1900.0)
    assert traces.end[0] == LineEnd.CLOSED_LOOP
    assert traces.s.size == 1


def test_chunks_give_the_same_lines_to_the_last_bit(rough_grid: Grid) -> None:
    mx, my = middle(rough_grid)
    rng = np.random.default_rng(3)
    points = points_at(mx + rng.uniform(-60, 60, 40), my + rng.uniform(-50, 120, 40))
    settings = TerrainSettings()
    ground = fall_line_surface(rough_grid, settings)
    whole = trace(rough_grid, ground, points, settings)
    for chunk in (np.arange(0, 7), np.arange(7, 40), np.array([39, 4])):
        part = trace(rough_grid, ground, take(points, chunk), settings)
        for i in range(len(part)):
            j = int(chunk[i])
            for a, b in zip(line(part, i), line(whole, j), strict=True):
                assert np.array_equal(a, b)
            assert part.end[i] == whole.end[j]


def test_an_edge_is_felt_as_far_as_the_page_says() -> None:
    """docs/terrain.md: not beyond 4 smoothing_m and 48 cells, by 1 µm beyond 4 smoothing_m."""
    settings, rng = TerrainSettings(smoothing_m=5.0), np.random.default_rng(1)
    bumps = ndimage.gaussian_filter(rng.normal(size=(200, 80)), 3.0) * 20.0
    heights = 1000.0 - 1.4 * np.arange(200.0)[:, None] + bumps
    x, y = 2.7e6 + np.arange(60.0, 110.0, 8.0), np.full(7, 1.15e6 - 2.0 * 100.0)

    def cut(rows: int) -> TraceSet:
        """Lines from 200 m below the northern edge, of which so many rows of 2 m are cut off."""
        return run(Grid(heights[rows:], 2.7e6, 1.15e6 - 2.0 * rows, 2.0), x, y, settings)

    whole, enough, near, nearer = (cut(rows) for rows in (0, 100 - 58, 100 - 12, 100 - 4))
    for axis in ("x", "y", "s", "end"):
        assert np.array_equal(getattr(enough, axis), getattr(whole, axis))
    apart = [np.hypot(own.x[:20] - whole.x[:20], own.y[:20] - whole.y[:20]).max()
             for own in (near, nearer)]  # fmt: skip
    assert 0.0 < apart[0] < 1e-6 and apart[1] > 1e-3
