from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.terrains import grid_of, rough
from hypothesis import given, settings
from hypothesis import strategies as st

from sassgis.errors import InputError
from sassgis.grid import Grid
from sassgis.terrain.surface import evaluate, smoothed, surface

pytestmark = pytest.mark.kernels


def holed(grid: Grid) -> Grid:
    """With a hole, a lone cell, a ragged side and a lone hole."""
    values = grid.values.copy()
    values[10:22, 15:30] = np.nan
    values[15, 20] = grid.values[15, 20]
    values[:, 0:3] = np.nan
    values[5:25, 3] = np.nan
    values[30, 40] = np.nan
    return Grid(values, grid.west, grid.north, grid.cell_size, grid.crs, grid.vertical_datum)


def test_surface_passes_through_cell_centres(rough_grid: Grid) -> None:
    cells = np.arange(rough_grid.values.size)
    x, y = rough_grid.cell_centres(cells)
    z, _, _ = evaluate(surface(rough_grid), x, y)
    assert np.allclose(z, rough_grid.values.ravel(), rtol=0, atol=1e-9)


def test_surface_and_gradient_of_a_smooth_function() -> None:
    grid = grid_of(rough, 120, 140)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-100, 100, 500), rng.uniform(-110, 110, 500)
    z, zx, zy = evaluate(surface(grid), x + 1120.0, y + 1860.0)
    h = 1e-4
    assert np.allclose(z, rough(x, y), atol=2e-3)
    assert np.allclose(zx, (rough(x + h, y) - rough(x - h, y)) / (2 * h), atol=5e-3)
    assert np.allclose(zy, (rough(x, y + h) - rough(x, y - h)) / (2 * h), atol=5e-3)


@settings(max_examples=15)
@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-500, 4000), st.floats(0.5, 15.0))
def test_planes_stay_planes_up_to_every_edge(a: float, b: float, c: float, scale: float) -> None:
    whole = grid_of(lambda x, y: a * x + b * y + c, 60, 50)
    grid = holed(whole)
    even = smoothed(grid, scale)
    assert np.array_equal(np.isnan(even.values), np.isnan(grid.values))
    assert np.nanmax(np.abs(even.values - grid.values)) < 1e-8
    west, south, east, north = grid.bounds
    rng = np.random.default_rng(0)
    x, y = rng.uniform(west, east, 400), rng.uniform(south, north, 400)
    z, zx, zy = evaluate(surface(even), x, y)
    known = np.isfinite(grid.values.ravel()[grid.cell_of(x, y)])
    assert np.array_equal(np.isfinite(z), known)
    mx, my = 0.5 * (west + east), 0.5 * (south + north)
    assert np.allclose(z[known], (a * (x - mx) + b * (y - my) + c)[known], atol=1e-8)
    assert np.allclose(zx[known], a, atol=1e-8)
    assert np.allclose(zy[known], b, atol=1e-8)


def test_points_outside_and_in_nodata_are_invalid() -> None:
    grid = holed(grid_of(rough, 60, 50))
    west, south, east, north = grid.bounds
    hole_x, hole_y = grid.cell_centres(np.array([30 * 60 + 40]))
    x = np.array([west - 0.1, east + 0.1, 0.5 * (west + east), np.nan, hole_x[0]])
    y = np.array([south + 40, south + 40, north + 0.1, north, hole_y[0]])
    assert np.isnan(evaluate(surface(grid), x, y)[0]).all()


def test_smoothing_is_a_gaussian_where_the_surroundings_are_complete() -> None:
    values = np.zeros((61, 61))
    values[30, 30] = 1.0
    sigma = 3.0
    even = smoothed(Grid(values, 0.0, 122.0, 2.0), 2.0 * sigma).values
    # A full spike in the middle: what returns is the kernel itself.
    ratio = even[30, 33] / even[30, 30]
    assert ratio == pytest.approx(np.exp(-0.5 * (3 / sigma) ** 2), rel=1e-9)
    assert even[33, 30] == pytest.approx(even[30, 33], rel=1e-9)
    assert even.sum() == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("scale_m", [3.0, 12.0])
def test_heights_far_from_nodata_do_not_hang_on_it(rough_grid: Grid, scale_m: float) -> None:
    """To the last bit, also along the edges: with nodata other cells are looked at."""
    values = rough_grid.values.copy()
    row, col = (n // 2 for n in values.shape)
    values[row, col] = np.nan
    whole, with_hole = (
        smoothed(g, scale_m).values for g in (rough_grid, replace(rough_grid, values=values))
    )
    reach = int(np.ceil(4.0 * scale_m / rough_grid.cell_size))
    assert min(values.shape) > 4 * reach
    far = np.ones(values.shape, bool)
    far[row - reach : row + reach + 1, col - reach : col + reach + 1] = False
    assert np.array_equal(whole[far], with_hole[far])
    assert not np.array_equal(whole[~far], with_hole[~far])


def test_bad_inputs_are_named() -> None:
    with pytest.raises(InputError, match="no height at all"):
        surface(Grid(np.full((3, 3), np.nan), 0.0, 6.0, 2.0))
