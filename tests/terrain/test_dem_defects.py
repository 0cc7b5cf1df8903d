"""Terraces, spikes, pits and holes in heights, each put in on purpose."""

from __future__ import annotations

import heapq

import numpy as np
import pytest

from sassgis.terrain.dem_defects import (
    bumps_m,
    contour_interval,
    depression_depth,
    equal_neighbours,
    height_step,
    inner_holes,
)
from sassgis.terrain.slope_units import slopes_deg

pytestmark = pytest.mark.kernels


def hills(seed: int = 2, shape: tuple[int, int] = (60, 80)) -> np.ndarray:
    """A slope of 35 degrees over cells of 2 m, with waves and dents of a few centimetres."""
    row, col = np.indices(shape)
    waves = 3.0 * np.sin(row / 9.0) + 2.0 * np.cos(col / 7.0 + row / 15.0)
    rough = np.random.default_rng(seed).normal(0.0, 0.03, shape)
    return 900.0 - 2.0 * np.tan(np.radians(35.0)) * col + waves + rough


def test_nothing_is_found_in_hills() -> None:
    values = hills()
    assert height_step(values) == 0.0 and contour_interval(values) == (0.0, 0.1)
    assert equal_neighbours(values, 2.0, 2.0) == 0.0
    assert np.abs(bumps_m(values)).max() < 0.5
    assert not inner_holes(values).any() and depression_depth(values).max() < 0.2


def test_slopes_of_cells_that_are_not_square() -> None:
    row, col = np.indices((9, 9))
    slopes = slopes_deg(3.0 * row + 1.0 * col, dx_m=1.0, dy_m=3.0)
    assert slopes == pytest.approx(np.degrees(np.arctan(np.sqrt(2.0))))


@pytest.mark.parametrize("step", [1.0, 0.5, 0.3048, 0.1])
@pytest.mark.parametrize("kind", ["float64", "float32"])
def test_the_step_of_rounded_heights(step: float, kind: str) -> None:
    values = (np.rint(hills() / step) * step).astype(kind).astype(float)
    assert height_step(values) == step
    values[3, 3] += 0.37 * step
    assert height_step(values) != step


def test_contour_lines_show_and_a_lake_does_not() -> None:
    values = hills()
    lake = np.where(values < 880.0, 880.0, values)
    assert contour_interval(lake) == (0.0, 0.1)
    # Between lines 10 m apart the heights hug the line, as thin splines through lines do.
    levels = values / 10.0
    part = levels - np.rint(levels)
    hugged = 10.0 * (np.rint(levels) + np.sign(part) * 0.5 * np.abs(2.0 * part) ** 3)
    interval, crowding = contour_interval(hugged)
    # |2 part|³ < 0.1 where |part| < 0.232: 46 % of the heights within a tenth.
    assert interval == 10.0 and crowding == pytest.approx(0.46, abs=0.08)


def test_repeated_cells_are_equal_neighbours() -> None:
    coarse = hills(shape=(30, 40))
    fine = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)
    assert equal_neighbours(fine, 1.0, 1.0) == pytest.approx(0.5, abs=0.03)
    # Along a contour line neighbours may be equal.
    plane = np.broadcast_to(2.0 * np.arange(50.0), (40, 50))
    assert equal_neighbours(plane, 2.0, 2.0) == 0.0


def test_a_spike_and_a_pit_stand_out_and_a_ridge_does_not() -> None:
    values = hills()
    values[20, 30] += 4.0
    values[40, 50] -= 3.0
    bumps = bumps_m(values)
    assert np.argwhere(np.abs(bumps) > 2.0).tolist() == [[20, 30], [40, 50]]
    assert bumps[20, 30] == pytest.approx(4.0, abs=0.4)
    assert bumps[40, 50] == pytest.approx(-3.0, abs=0.4)
    ridge = np.tile(-np.abs(np.arange(21.0) - 10.0), (15, 1))
    step = np.where(np.arange(20) < 10, 0.0, 8.0) + np.zeros((15, 1))
    assert not bumps_m(ridge).any() and not bumps_m(step).any()
    # A rough face is uneven all over.
    rough = hills() + np.random.default_rng(3).normal(0.0, 2.0, (60, 80))
    assert (np.abs(bumps_m(rough)) > 2.0).mean() < 0.02


def test_holes_are_inside() -> None:
    values = hills()
    values[:5, :9] = np.nan
    values[30:33, 40:42] = np.nan
    holes = inner_holes(values)
    assert holes.sum() == 6 and holes[31, 41]


def flooded(values: np.ndarray) -> np.ndarray:
    """Lowest level of the highest point on the way out, by a search from each cell (slow)."""
    out = values.copy()
    rows, cols = values.shape
    for start in np.ndindex(rows, cols):
        if np.isnan(values[start]):
            continue
        best = {start: values[start]}
        heap = [(values[start], start)]
        while heap:
            level, (i, j) = heapq.heappop(heap)
            near = [(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
            inside = [(a, b) for a, b in near if 0 <= a < rows and 0 <= b < cols]
            if len(inside) < 8 or any(np.isnan(values[c]) for c in inside):
                out[start] = level
                break
            for cell in inside:
                height = max(level, values[cell])
                if height < best.get(cell, np.inf):
                    best[cell] = height
                    heapq.heappush(heap, (height, cell))
    return out


def test_depressions_are_filled_to_their_outlet() -> None:
    values = np.random.default_rng(7).normal(0.0, 1.0, (14, 17))
    values[6:8, 9] = np.nan
    want = np.nan_to_num(flooded(values) - values)
    assert want.max() > 1.0
    assert depression_depth(values) == pytest.approx(want, abs=1e-12)
