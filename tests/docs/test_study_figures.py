"""Figures that only the studies draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.figure_parts import find, texts
from helpers.scripts import load
from runout_figure import quantile_rows, runout_gap_figure

from sassgis.grid import Grid


@pytest.fixture
def studies(repository: Path) -> Path:
    return repository / "docs" / "studies"


def test_fig9_has_a_surface_for_each_shape(studies: Path) -> None:
    gamma, alpha = np.linspace(0.0, 180.0, 7), np.linspace(0.0, 90.0, 4)
    eta = np.outer(np.sin(np.radians(alpha)) ** 2, np.full(7, 70.0))
    figure = load(studies / "fig9.py").fig9_figure(gamma, alpha, [(0.76, eta), (0.40, eta / 2.0)])
    assert len(figure.axes) == 2
    words = texts(figure)
    for word in ("b/a = 0.76", "b/a = 0.40", "γ (°)", "α (°)", "(%)"):
        assert word in words
    surface = figure.axes[0].collections[0]
    assert surface.get_array().size == 6 * 3
    assert surface.get_array().max() == pytest.approx(70.0 * (1.0 + 0.75) / 2.0)


def test_observed_hops_take_the_time_between_the_contacts(studies: Path) -> None:
    grid = Grid(np.full((20, 40), 7.0), 0.0, 40.0, 2.0)
    contacts = pd.DataFrame(
        {"x": [10.0, 16.0, 16.5], "y": [20.0] * 3, "z": [7.1, 7.1, 7.1],
         "t_start_s": [0.0, 1.1, 1.12], "t_end_s": [0.1, 1.1, 1.2]}
    )  # fmt: skip
    s, height = load(studies / "fig11.py").hops(contacts, np.array([[4.0, 20.0], [1.0, 0.0]]), grid)
    # One hop of a second; the second lasts too short for one.
    assert (s[0], s[-1]) == (6.0, 12.0) and s.size == height.size
    assert height[[0, -1]] == pytest.approx(0.0, abs=1e-12)
    t = (s - 6.0) / 6.0
    assert height == pytest.approx(0.5 * 9.81 * t * (1.0 - t))


def test_convergence_is_sorted_with_intervals(studies: Path) -> None:
    tolerances = np.array([1.0, 0.1, 0.5])
    values = np.array([12.0, 10.0, 11.0])
    series = {"run-out, 95 % (m)": (values, values - 1.0, values + 2.0)}
    figure = load(studies / "discretisation.py").convergence_figure(tolerances, series)
    (ax,) = figure.axes
    line = ax.lines[0]
    np.testing.assert_allclose(line.get_xdata(), [0.1, 0.5, 1.0])
    np.testing.assert_allclose(line.get_ydata(), [10.0, 11.0, 12.0])
    bars = ax.containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose(bars[0][:, 1], [9.0, 12.0])
    assert ax.get_xscale() == "log"
    band = next(p for p in ax.patches if p.get_gid() == "finest")
    assert (band.get_y(), band.get_height()) == (9.0, 3.0)
    words = texts(figure)
    assert "run-out, 95 % (m)" in words and "segment tolerance (m)" in words


def test_gap_curves_table_and_stops() -> None:
    z = np.tile(1000.0 - 2.5 * np.arange(40.0)[:, None], (1, 60))
    grid = Grid(z, 2_700_000.0, 1_150_000.0, 5.0)
    corner = np.array([grid.west, grid.north])
    seen, made = np.array([60.0, 80.0, np.nan]), np.array([70.0, 90.0, 110.0, 130.0])
    seen_xy = np.array([[100.0, -60.0], [110.0, -80.0]]) + corner
    made_xy = np.array([[100.0, -70.0]]) + corner
    figure = runout_gap_figure(seen, made, grid=grid, observed_xy=seen_xy, predicted_xy=made_xy)
    np.testing.assert_allclose(find(figure, "observed")[0].get_data()[1], [0, 50, 100])
    np.testing.assert_allclose(find(figure, "observed")[0].get_data()[0], [60, 60, 80])
    np.testing.assert_allclose(find(figure, "stops-observed")[0].get_xydata(), seen_xy)
    np.testing.assert_allclose(find(figure, "stops-predicted")[0].get_xydata(), made_xy)
    words = texts(figure)
    assert "2 observed rocks, 4 predicted rocks" in words
    assert "median | 70 | 100 | +30" in words


def test_gap_table() -> None:
    rows = {row[0]: row[1:] for row in quantile_rows(np.array([20.0]), np.array([17.5]))}
    assert rows["median"] == ("20.0", "17.5", "\u22122.5")
    assert quantile_rows(np.empty(0), np.array([1.0]))[2][1:] == ("–", "1.0", "–")
    assert "no data" in texts(runout_gap_figure(np.empty(0), np.empty(0)))
