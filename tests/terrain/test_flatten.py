from __future__ import annotations

import numpy as np
import pytest
import shapely
from helpers.terrains import grid_of, middle, points_at, polyline, rough
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid
from sassgis.settings.results import ProfileSet, TraceSet
from sassgis.settings.settings import TerrainSettings
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.flatten import chainage_to_xy, crossings, profiles, xy_to_chainage

pytestmark = pytest.mark.kernels


@pytest.fixture(scope="module")
def traces(rough_grid: Grid) -> TraceSet:
    mx, my = middle(rough_grid)
    rng = np.random.default_rng(3)
    points = points_at(mx + rng.uniform(-80, 80, 12), my + rng.uniform(0, 120, 12))
    settings = TerrainSettings()
    return trace(rough_grid, fall_line_surface(rough_grid, settings), points, settings)


@pytest.fixture(scope="module")
def classes(rough_grid: Grid) -> NDArray[np.int32]:
    rows, cols = np.indices(rough_grid.shape)
    return ((rows // 17 + cols // 5) % 3).astype(np.int32)


def of(flat: ProfileSet, i: int) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    own = slice(int(flat.offset[i]), int(flat.offset[i + 1]))
    return flat.s[own], flat.z[own], flat.ground[own]


def stretches(flat: ProfileSet, i: int) -> tuple[FloatArray, NDArray[np.int64]]:
    first, last = int(flat.cell_offset[i]), int(flat.cell_offset[i + 1])
    return flat.cell_s[first + i : last + i + 1], flat.cell[first:last]


def bilinear(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """The textbook formula, for points amid known cells."""
    col, row = grid.col_row(x, y)
    j, i = np.floor(col).astype(int), np.floor(row).astype(int)
    t, r = col - j, row - i
    z = grid.values
    return np.asarray(
        (1 - r) * ((1 - t) * z[i, j] + t * z[i, j + 1])
        + r * ((1 - t) * z[i + 1, j] + t * z[i + 1, j + 1])
    )


@pytest.mark.parametrize("tolerance", [0.02, 0.2, 1.0])
def test_profiles_keep_within_the_tolerance(
    rough_grid: Grid, traces: TraceSet, classes: NDArray[np.int32], tolerance: float
) -> None:
    flat = profiles(rough_grid, traces, classes, tolerance)
    # Without a tolerance the samples themselves are the vertices.
    samples = profiles(rough_grid, traces, classes, 0.0)
    west, south, east, north = rough_grid.bounds
    for i in range(len(traces)):
        s, z, _ = of(flat, i)
        assert s[0] == 0.0
        assert s[-1] == traces.s[traces.offset[i + 1] - 1]
        assert (np.diff(s) > 0).all()
        sample_s, sample_z, _ = of(samples, i)
        assert np.abs(np.interp(sample_s, s, z) - sample_z).max() <= tolerance + 1e-6
        # And between the samples, by an independent formula.
        fine = np.linspace(0.0, s[-1], 5000)
        x, y = chainage_to_xy(traces, i, fine)
        amid = (np.abs(x - 0.5 * (west + east)) < 0.5 * (east - west) - 2.0) & (
            np.abs(y - 0.5 * (south + north)) < 0.5 * (north - south) - 2.0
        )
        z_dem = bilinear(rough_grid, x[amid], y[amid])
        assert np.abs(np.interp(fine[amid], s, z) - z_dem).max() <= tolerance + 0.01


@settings(max_examples=10)
@given(st.floats(0, 360), st.floats(25, 70))
def test_a_plane_is_one_segment(azimuth: float, slope: float) -> None:
    east, north = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    tangent = np.tan(np.radians(slope))
    grid = grid_of(lambda x, y: 500 - tangent * (x * east + y * north), 60, 60)
    mx, my = middle(grid)
    settings = TerrainSettings()
    lines = trace(grid, fall_line_surface(grid, settings), points_at(mx, my), settings)
    flat = profiles(grid, lines, np.zeros(grid.shape, np.int32), 0.01)
    s, z, _ = of(flat, 0)
    assert s.size == 2
    assert z[0] == pytest.approx(500.0, abs=1e-6)
    # Up to the very edge, half a cell beyond the last cell centre.
    assert (z[0] - z[1]) / (s[1] - s[0]) == pytest.approx(tangent, rel=1e-6)


def test_heights_next_to_nodata_continue_the_slope() -> None:
    grid = grid_of(lambda x, y: 500 + 0.7 * y + 0.2 * x, 40, 40)
    grid.values[20:24, 16:18] = np.nan
    grid.values[20:24, 20:] = np.nan
    mx, my = middle(grid)
    lines = polyline([(mx - 1.9, my + 30.0), (mx - 1.7, my - 30.0)])
    flat = profiles(grid, lines, np.zeros(grid.shape, np.int32), 0.001)
    s, z, _ = of(flat, 0)
    assert s.size == 2
    assert z[-1] == pytest.approx(500 - 0.7 * 30 - 0.2 * 1.7, abs=1e-6)


def test_ground_classes_change_at_borders_of_cells(
    rough_grid: Grid, traces: TraceSet, classes: NDArray[np.int32]
) -> None:
    flat = profiles(rough_grid, traces, classes, 5.0)
    changes = 0
    for i in range(len(traces)):
        s, _, ground = of(flat, i)
        border, cell = stretches(flat, i)
        middles = 0.5 * (border[:-1] + border[1:])
        segment = np.searchsorted(s, middles, side="right") - 1
        assert np.array_equal(ground[segment], classes.ravel()[cell])
        assert ground[-1] == ground[-2]
        changed = np.flatnonzero(np.diff(classes.ravel()[cell])) + 1
        assert np.abs(s[:, None] - border[changed]).min(axis=0).max() < 1e-9
        changes += changed.size
    assert changes > 50


def test_stretches_cover_the_line_and_agree_with_the_grid(
    rough_grid: Grid, traces: TraceSet, classes: NDArray[np.int32]
) -> None:
    flat = profiles(rough_grid, traces, classes, 0.2)
    assert flat.cell_s.size == flat.cell.size + len(traces)
    for i in range(len(traces)):
        border, cell = stretches(flat, i)
        s, _, _ = of(flat, i)
        assert border[0] == s[0]
        assert border[-1] == s[-1]
        assert (np.diff(border) > 0).all()
        assert (cell >= 0).all()
        assert (cell[1:] != cell[:-1]).all()
        x, y = chainage_to_xy(traces, i, 0.5 * (border[:-1] + border[1:]))
        assert np.array_equal(rough_grid.cell_of(x, y), cell)
        # None is passed over: each step goes to one of the eight neighbours.
        n_cols = rough_grid.shape[1]
        assert np.abs(np.diff(cell // n_cols)).max() <= 1
        assert np.abs(np.diff(cell % n_cols)).max() <= 1


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(-50, 50), st.integers(-50, 50)), min_size=2, max_size=6))
def test_stretches_of_lines_along_and_through_grid_lines(points: list[tuple[int, int]]) -> None:
    """Points on borders, corners and centres of cells; long segments; lines outside the grid."""
    places = [(1100.0 + x, 1900.0 + y) for x, y in points]
    places = [p for k, p in enumerate(places) if k == 0 or p != places[k - 1]]
    if len(places) < 2:
        return
    grid = grid_of(rough, 30, 30, west=1070.0, north=1930.0)
    lines = polyline(places)
    flat = profiles(grid, lines, np.zeros(grid.shape, np.int32), 0.1)
    border, cell = stretches(flat, 0)
    assert border[0] == 0.0
    assert border[-1] == lines.s[-1]
    assert (np.diff(border) > 1e-9).all()
    lengths = np.zeros(grid.values.size + 1)
    np.add.at(lengths, cell, np.diff(border))
    path = shapely.LineString(places)
    for k in np.unique(cell[cell >= 0]):
        x, y = grid.cell_centres(np.array([k]))
        box = shapely.box(x[0] - 1, y[0] - 1, x[0] + 1, y[0] + 1)
        assert shapely.distance(path, box) < 1e-9
    for a, b, k in zip(border[:-1], border[1:], cell, strict=True):
        s = a + (b - a) * np.array([0.31, 0.5, 0.67])
        x, y = chainage_to_xy(lines, 0, s)
        col, row = grid.col_row(x, y)
        on_border = (np.abs(col - np.floor(col) - 0.5) < 1e-7) | (
            np.abs(row - np.floor(row) - 0.5) < 1e-7
        )
        assert (on_border | (grid.cell_of(x, y) == k)).all()


def test_single_points_give_single_vertices() -> None:
    grid = grid_of(rough, 30, 30)
    mx, my = middle(grid)
    lines = polyline([(mx, my)], [(mx, my), (mx + 5.0, my - 3.0)], [(mx + 500.0, my)])
    flat = profiles(grid, lines, np.full(grid.shape, 4, np.int32), 0.1)
    assert list(np.diff(flat.cell_offset)) == [0, 4, 0]
    assert flat.cell_s.size == flat.cell.size + 3
    s, z, ground = of(flat, 0)
    assert (s.size, s[0], ground[0]) == (1, 0.0, 4)
    assert z[0] == pytest.approx(bilinear(grid, np.array([mx]), np.array([my]))[0])
    s, z, ground = of(flat, 2)
    assert (s.size, ground[0]) == (1, -1)
    assert np.isnan(z[0])


def test_map_and_chainage_both_ways(traces: TraceSet) -> None:
    rng = np.random.default_rng(5)
    lengths = traces.s[traces.offset[1:] - 1]
    line = rng.integers(0, len(traces), 2000)
    s = rng.uniform(0, lengths[line])
    x, y = chainage_to_xy(traces, line, s)
    for i in range(len(traces)):
        own = line == i
        back, offset = xy_to_chainage(traces, i, x[own], y[own])
        assert np.allclose(back, s[own], atol=1e-6)
        assert np.abs(offset).max() < 1e-6
    # One line with many chainages, and the ends themselves.
    x, y = chainage_to_xy(traces, 3, np.array([0.0, lengths[3]]))
    assert x[0] == traces.x[traces.offset[3]]
    assert y[1] == traces.y[traces.offset[4] - 1]


def test_chainages_off_the_line_are_not_moved_onto_it(traces: TraceSet) -> None:
    end = traces.s[traces.offset[1] - 1]
    x, y = chainage_to_xy(traces, 0, np.array([-0.01, end + 0.01, np.nan, end + 1e-9]))
    assert np.array_equal(np.isnan(x), [True, True, True, False])
    assert np.array_equal(np.isnan(y), np.isnan(x))
    with pytest.raises(IndexError):
        chainage_to_xy(traces, len(traces), 1.0)


def test_offsets_are_positive_to_the_right() -> None:
    lines = polyline([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
    s, offset = xy_to_chainage(lines, 0, np.array([4.0, 4.0, 13.0]), np.array([-2.0, 1.0, 5.0]))
    assert np.allclose(s, [4.0, 4.0, 15.0])
    assert np.allclose(offset, [2.0, -1.0, 3.0])


def test_crossings_agree_with_shapely(traces: TraceSet) -> None:
    control_line = np.array(
        [(1000.0, 1850.0), (1080.0, 1862.0), (1130.0, 1790.0), (1260.0, 1851.0)]
    )
    line, s = crossings(traces, control_line)
    assert line.size >= len(traces)
    assert (np.diff(line) >= 0).all()
    found = 0
    path = shapely.LineString(control_line)
    for i in range(len(traces)):
        own = slice(int(traces.offset[i]), int(traces.offset[i + 1]))
        meets = shapely.get_coordinates(
            shapely.intersection(shapely.LineString(np.c_[traces.x[own], traces.y[own]]), path)
        )
        expected = np.sort(xy_to_chainage(traces, i, meets[:, 0], meets[:, 1])[0])
        assert np.allclose(s[line == i], expected, atol=1e-6)
        found += expected.size
    assert found == line.size


def test_crossings_at_vertices_count_once_and_further_ones_follow() -> None:
    lines = polyline(
        [(0.0, 0.0), (5.0, 0.0), (10.0, 0.0)], [(0.0, 3.0), (10.0, 3.0)], [(0.0, 9.0), (10.0, 9.0)]
    )
    # Through the vertex at (5, 0) with a vertex of its own; then back across the first line.
    control_line = np.array([(5.0, -5.0), (5.0, 0.0), (5.0, 5.0), (8.0, 5.0), (8.0, -5.0)])
    line, s = crossings(lines, control_line)
    assert list(line) == [0, 0, 1, 1]
    assert np.allclose(s, [5.0, 8.0, 5.0, 8.0])
    line, s = crossings(lines, np.array([(20.0, 0.0), (30.0, 5.0)]))
    assert line.size == s.size == 0


def test_bad_inputs_are_named(rough_grid: Grid, traces: TraceSet) -> None:
    with pytest.raises(InputError, match="ground"):
        profiles(rough_grid, traces, np.zeros((3, 3), np.int32), 0.1)
    with pytest.raises(InputError, match="control_line"):
        crossings(traces, np.array([(0.0, 1.0)]))
