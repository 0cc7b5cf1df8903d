"""From traced lines to what blocks are simulated on, on a plane where all is known."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.terrains import grid_of, middle, points_at

from sassgis.inputs.ground_map import built_in_table
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import ControlLine, TraceSet
from sassgis.settings.settings import EngineSettings, ReleaseSettings, TerrainSettings
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.prepare import LEAD_IN_M, draw_keys, drawn_lines, prepare_lines

pytestmark = pytest.mark.kernels

SLOPE = 0.8


def plane_run() -> MapRun:
    """A plane that falls to the south, with a station 30 m and a wall 12 m below its middle."""
    grid = grid_of(lambda x, y: 500.0 + SLOPE * y, 60, 80)
    x, y = middle(grid)
    across = np.array([[x - 50.0, y], [x + 50.0, y]])
    return MapRun(
        grid=grid,
        ground=np.zeros(grid.shape, np.int32),
        table=built_in_table(),
        areas=(),
        blocks=(BlockPopulation(),),
        control_lines=(
            (ControlLine("road", "station"), across - [0.0, 30.0]),
            (ControlLine("wall", "wall", 2.0), across - [0.0, 12.0]),
        ),
        engine=EngineSettings(),
        terrain=TerrainSettings(
            smoothing_m=0.0, energy_line_angle_deg=0.0, segment_tolerance_m=0.1, path="fall_line"
        ),
        release=ReleaseSettings(spacing_m=2.0, rocks_per_point=1),
        seed=1,
    )


def traced(run: MapRun, *starts: tuple[float, float]) -> TraceSet:
    points = points_at([s[0] for s in starts], [s[1] for s in starts])
    return trace(run.grid, fall_line_surface(run.grid, run.terrain), points, run.terrain)


def test_lines_are_flattened_and_go_on_behind_their_start() -> None:
    run = plane_run()
    lines = traced(run, middle(run.grid))
    prepared = prepare_lines(run, lines)
    assert prepared.good.tolist() == [True]
    s, z = prepared.flat.vertices(0)
    assert s[0] == 0.0 and np.allclose(np.diff(z), -SLOPE * np.diff(s), atol=1e-6)
    ahead, height = prepared.profiles.vertices(0)
    assert ahead[0] == -LEAD_IN_M
    assert height[0] == pytest.approx(z[0] + SLOPE * LEAD_IN_M)
    assert np.array_equal(ahead[1:], s) and prepared.length_m[0] == s[-1]


def test_control_lines_are_crossed_at_their_distance_in_rising_order() -> None:
    run = plane_run()
    crossed = prepare_lines(run, traced(run, middle(run.grid))).crossings
    assert np.allclose(crossed.chainage, [12.0, 30.0])
    assert [crossed.control_lines[k].name for k in crossed.control_line] == ["wall", "road"]


def test_lines_that_end_at_once_are_left_out_and_the_others_keep_their_places() -> None:
    run = plane_run()
    x, y = middle(run.grid)
    edge = run.grid.bounds[1] + 0.5
    lines = traced(run, (x, y), (x, edge), (x + 20.0, y))
    prepared = prepare_lines(run, lines)
    assert prepared.good.tolist() == [True, False, True]
    assert prepared.lines.point.tolist() == [0, 2] and len(prepared) == 2
    assert len(prepared.profiles) == 2 and prepared.crossings.offset.tolist() == [0, 2, 4]
    # All lines are drawn, with the numbers of their points in the plan.
    assert drawn_lines(lines, run.grid, np.array([5, 6, 7])).point.tolist() == [5, 6, 7]


def test_blocks_start_within_twice_the_shift_but_on_the_line() -> None:
    run = plane_run()
    prepared = prepare_lines(run, traced(run, middle(run.grid)))
    assert prepared.starts(np.array([1.5])).tolist() == [[0.0, 3.0]]
    assert prepared.starts(np.array([1e4])).tolist() == [[0.0, prepared.length_m[0]]]


def test_drawn_lines_are_straight_on_a_plane_and_know_their_drop() -> None:
    run = plane_run()
    lines = traced(run, middle(run.grid))
    drawn = drawn_lines(lines, run.grid, np.array([0]))
    assert drawn.x.size == 2 < lines.x.size
    assert drawn.length_m[0] == lines.s[-1]
    assert drawn.drop_m[0] == pytest.approx(SLOPE * drawn.length_m[0], abs=2.0 * SLOPE * 2.0)


def test_keys_of_draws_differ_by_point_and_scenario_alone() -> None:
    keys = points_at([0.0, 10.0], [0.0, 0.0]).key
    small, big = (draw_keys(keys, name) for name in ("small", "big"))
    assert np.unique(np.concatenate([small, big])).size == 4
    assert np.array_equal(draw_keys(keys[1:], "small"), small[1:])
