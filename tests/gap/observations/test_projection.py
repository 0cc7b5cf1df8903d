"""Observed points in the plane of their fall lines."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.observed_slope import NORTH, WEST, at, ground
from helpers.terrains import polyline

from sassgis.gap.observations.observed import Observations
from sassgis.gap.observations.projection import (
    nearest_lines,
    observed_release_points,
    project,
    project_observations,
    station_chainages,
)
from sassgis.gap.observations.tables import Stations
from sassgis.grid import Grid
from sassgis.inputs.observation_files import read_observations
from sassgis.settings.settings import TerrainSettings
from sassgis.terrain.cells import heights_at
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.prepare import take_lines
from sassgis.terrain.release import point_keys

MIDDLE = WEST + 100.0


def traced(grid, points):
    settings = TerrainSettings()
    return trace(grid, fall_line_surface(grid, settings), points, settings)


@pytest.fixture
def observed(folder, slope) -> Observations:
    return read_observations(folder(), slope)


def test_points_of_a_plane_slope(observed, slope):
    """On a plane the fall line runs straight down: all is known by hand."""
    points, rock = observed_release_points(observed)
    assert rock.tolist() == [0, 1, 2, 3, 4]
    traces = traced(slope, points)
    found = project_observations(observed, traces, rock, grid=slope)
    assert {k: v.line.size for k, v in found.items()} == {
        "rocks": 5,
        "passages": 10,
        "impacts": 5,
        "contacts": 0,
        "deposits": 7,
        "trajectories": 16,
    }
    number = np.arange(1, 6)
    np.testing.assert_allclose(found["rocks"].s, 0.0, atol=1e-6)
    np.testing.assert_allclose(found["passages"].s, np.tile([80.0, 180.0], 5), atol=0.02)
    # Lines run south from x = 2 i; rocks passed at x = 2.5 i. East is left, looking south.
    np.testing.assert_allclose(found["passages"].lateral_m, np.repeat(-0.5 * number, 2), atol=0.02)
    np.testing.assert_allclose(found["passages"].height_m, 0.8, atol=1e-6)
    np.testing.assert_allclose(found["deposits"].s[:4], 230.0 + number[:4], atol=0.02)
    np.testing.assert_allclose(found["deposits"].lateral_m[4], -(20.0 - 10.0), atol=0.02)
    np.testing.assert_allclose(found["deposits"].height_m, 0.0, atol=1e-6)
    assert (found["deposits"].beyond == 0).all()
    # The block of unknown origin is put on the line nearest to it: that of R1.
    assert found["deposits"].line[6] == 0
    np.testing.assert_allclose(found["deposits"].lateral_m[6], 22.0, atol=0.02)


def test_height_is_that_above_the_ground_below_the_point():
    """On a slope that also falls sideways, the ground under the line would be wrong."""
    x = (np.arange(60) + 0.5) * 2.0
    grid = Grid(np.repeat((100.0 - 0.5 * x)[None, :], 60, axis=0), 0.0, 120.0, 2.0)
    traces = polyline([(60.0, 100.0), (60.0, 20.0)])
    found = project(
        traces, np.array([0]), np.array([70.0]), np.array([60.0]), np.array([67.0]), grid=grid
    )
    assert found.s[0] == pytest.approx(40.0)
    assert found.lateral_m[0] == pytest.approx(-10.0)
    assert found.height_m[0] == pytest.approx(67.0 - 65.0)


def test_sign_of_the_side_and_chainage_round_a_corner():
    traces = polyline([(0.0, 0.0), (10.0, 0.0), (10.0, -10.0)])
    x, y = np.array([4.0, 4.0, 12.0, 8.0]), np.array([-2.0, 3.0, -5.0, -5.0])
    found = project(traces, np.zeros(4, int), x, y)
    np.testing.assert_allclose(found.s, [4.0, 4.0, 15.0, 15.0])
    np.testing.assert_allclose(found.lateral_m, [2.0, -3.0, -2.0, 2.0])
    assert np.isnan(found.height_m).all()


def test_beyond_the_ends_is_said():
    traces = polyline([(0.0, 0.0), (10.0, 0.0)], [(5.0, 5.0)])
    x = np.array([-2.0, 5.0, 12.0, 10.0, np.nan, 3.0])
    found = project(traces, np.array([0, 0, 0, 0, 0, 1]), x, np.zeros(6))
    assert found.beyond.tolist() == [-1, 0, 1, 0, 0, 0]
    np.testing.assert_allclose(found.s, [0.0, 5.0, 10.0, 10.0, np.nan, 0.0])
    assert found.line.tolist() == [0, 0, 0, 0, -1, 1]


def test_rocks_without_a_release_point_have_no_line(observed, slope):
    rocks = observed.rocks
    x = rocks.x.copy()
    x[1] = np.nan
    lost = dataclasses.replace(observed, rocks=dataclasses.replace(rocks, x=x))
    points, rock = observed_release_points(lost)
    assert points.area_names == ("R1", "R3", "R4", "R5") and rock.tolist() == [0, 2, 3, 4]
    # Draws hang on the name of the rock, not on its place in the table.
    assert points.key[1] == point_keys("R3", 1)[0]


def test_nearest_lines_are_those_of_brute_force():
    rng = np.random.default_rng(0)
    traces = polyline(*(np.cumsum(rng.normal(size=(6, 2)), axis=0) * 5 for _ in range(7)))
    x, y = rng.normal(size=(2, 40)) * 15
    x[3] = np.nan
    found = nearest_lines(traces, x, y)
    away = np.array(
        [np.abs(project(traces, np.full(40, i), x, y).lateral_m) for i in range(len(traces))]
    )
    expected = np.where(np.isnan(x), -1, np.argmin(np.nan_to_num(away), axis=0))
    assert found.tolist() == expected.tolist()
    none = take_lines(traces, np.zeros(len(traces), np.bool_))
    assert nearest_lines(none, x[:2], y[:2]).tolist() == [-1, -1]


def test_stations_on_lines(observed, slope):
    points, _ = observed_release_points(observed)
    traces = traced(slope, points)
    found = station_chainages(traces, observed.stations)
    np.testing.assert_allclose(found, np.tile([80.0, 180.0], (5, 1)), atol=0.02)


def test_stations_that_a_line_misses_or_crosses_twice():
    traces = polyline([(0.0, 0.0), (0.0, -50.0)], [(30.0, 0.0), (30.0, -50.0)])
    stations = Stations.of(
        station=["none", "short", "bent"],
        vertices=[
            [[0.0, 10.0], [5.0, 10.0]],
            [[-5.0, -20.0], [25.0, -20.0]],
            [[-5.0, -30.0], [5.0, -35.0], [-5.0, -40.0]],
        ],
    )
    found = station_chainages(traces, stations)
    np.testing.assert_allclose(found, [[np.nan, 20.0, 32.5], [np.nan, np.nan, np.nan]])
    longer = station_chainages(traces, stations, prolong_m=10.0)
    assert longer[1, 1] == pytest.approx(20.0)


def test_heights_of_the_dem(slope):
    x, y, z = np.array([at(3.3, 41.7), at(-7.0, 20.0)]).T
    np.testing.assert_allclose(heights_at(slope, x, y), z)
    off = heights_at(slope, np.array([WEST - 1.0, np.nan]), np.array([NORTH - 5.0, NORTH - 5.0]))
    assert np.isnan(off).all()
    assert heights_at(slope, np.float64(MIDDLE), np.float64(NORTH - 100.0)) == ground(100.0)
