"""The rocks of a case move as blocks do on the map, along followed paths and along fall lines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.made_diagnosis import write_observations, write_slope
from helpers.simulated_slope import BASE, ERRORS, STATIONS, TABLE, observed, slope

from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.gap.forward.observation_operator import campaigns, with_release
from sassgis.gap.forward.released_rocks import ReleaseError, all_rocks, move, with_stations_at
from sassgis.gap.forward.rock_lines import control_lines_of, rock_lines_of
from sassgis.gap.observations.case import Campaign, Case, station_traces
from sassgis.grid import Grid
from sassgis.inputs.config import load_config
from sassgis.runs.calibrate import read_case
from sassgis.runs.inputs import read_map_run
from sassgis.settings.results import ReleasePoints
from sassgis.settings.settings import EngineSettings
from sassgis.terrain.flatten import chainage_to_xy
from sassgis.terrain.prepare import placed_points

COUNT = 60


def followed(case: Case) -> Case:
    grid, kind = slope()
    return replace(case, terrain=PathTerrain(grid, kind, 0.05, station_traces(case)))


@pytest.fixture(scope="module")
def case() -> Case:
    """On a slope that is the same all across, blocks without tilt and drift keep to fall lines."""
    engine = EngineSettings(side_tilt_deg=0.0, drift_deg=0.0)
    return replace(observed(12, 3, tables=("passages", "deposits")), engine=engine)


def made(case: Case, number: int = 2) -> list[Campaign]:
    return campaigns(case, rock_lines_of(case), BASE, count=COUNT, seed=1, number=number)


@pytest.fixture(scope="module")
def both(case: Case) -> tuple[list[Campaign], list[Campaign]]:
    return made(case), made(followed(case))


def test_stops_are_those_of_fall_lines(case: Case, both) -> None:
    for one in both[1]:
        assert np.abs(one.deposits.lateral_m).max() < 5.0 * ERRORS["position_error_m"]
    # Blocks of one place differ in size and speed: each is compared with itself. One that is
    # nearly round rolls, and each vertex costs it: those of the two flattenings differ.
    long = case.observations.rocks.semi_axis_a_m > 1.05 * case.observations.rocks.semi_axis_b_m
    assert long.sum() > 8
    s = [np.array([one.deposits.s[np.argsort(one.deposits.rock)] for one in m]) for m in both]
    scatter = np.sqrt(s[0].var(axis=0) / COUNT + s[1].var(axis=0) / COUNT)
    assert (np.abs(s[0].mean(axis=0) - s[1].mean(axis=0)) < 4.0 * scatter)[long].all()
    assert s[1].std(axis=0).min() > 0.0


def test_stations_are_passed_as_often_and_on_the_fall_line(both) -> None:
    counts = []
    for one in both:
        rows = [c.passages for c in one]
        counts.append(
            np.sum([np.bincount(r.station, minlength=len(STATIONS)) for r in rows], axis=0)
        )
    released_rocks = COUNT * 12
    assert (counts[1] > 0).all() and counts[1][0] <= released_rocks
    assert np.abs(counts[0] - counts[1]).max() < 4.0 * np.sqrt(0.5 * released_rocks)
    beside = np.concatenate([c.passages.lateral_m for c in both[1]])
    assert np.abs(beside).max() < 5.0 * ERRORS["position_error_m"]


def test_campaigns_of_another_number_are_other_draws(case: Case, both) -> None:
    again, other = (made(followed(case), number) for number in (2, 3))
    assert np.array_equal([c.deposits.s for c in again], [c.deposits.s for c in both[1]])
    assert not np.array_equal([c.deposits.s for c in other], [c.deposits.s for c in both[1]])


def test_rocks_move_as_blocks_do_from_their_release_points() -> None:
    """The very stops of the map's own call, with tilt and drift, in the plane of the fall line."""
    case = followed(observed(12, 3))
    lines = rock_lines_of(case)
    found = move(case, lines, all_rocks(case, lines), BASE, seed=4, count=30)
    rocks, n = case.observations.rocks, case.n_rocks
    points = ReleasePoints(
        rocks.x, rocks.y, np.arange(n, dtype=np.int64), lines.keys, case.observations.rock_names
    )
    on_map = follow(
        case.terrain, points, TABLE, case.blocks, case.engine, seed=4, rocks_per_point=30,
        point_keys=lines.keys,
    )  # fmt: skip
    # Fall lines of this slope run straight to the south.
    start_x, start_y = (np.repeat(v, 30) for v in (rocks.x, rocks.y))
    assert found.lateral_m == pytest.approx(start_x - on_map.x, abs=0.3)
    assert found.rocks["runout_m"] == pytest.approx(start_y - on_map.y, abs=0.3)
    assert found.lateral_m.std() > 1.0
    passed = found.passages
    assert found.passed_lateral_m == pytest.approx(rocks.x[passed["line"]] - passed["x_m"], abs=0.3)
    assert passed["y_m"] == pytest.approx(
        rocks.y[passed["line"]] - np.array(STATIONS)[passed["control_line"]], abs=3.0
    )


def test_a_start_further_down_moves_all_that_follows() -> None:
    case = followed(observed(6, 3))
    lines = rock_lines_of(case)
    rocks = all_rocks(case, lines)
    ahead = replace(rocks, start=np.column_stack([np.full(6, 10.0), np.full(6, 20.0)]))
    found = move(case, lines, ahead, BASE, seed=4, count=20)
    assert found.rocks["line"].tolist() == np.repeat(np.arange(6), 20).tolist()
    assert found.rocks["rock"].tolist() == np.tile(np.arange(20), 6).tolist()
    assert found.rocks["runout_m"].min() > 9.0


@pytest.mark.parametrize("path", ["fall_line", "followed"])
def test_rocks_start_further_down_or_up_the_slope_than_stated(path: str) -> None:
    case = observed(6, 3) if path == "fall_line" else followed(observed(6, 3))
    near = with_stations_at(case, np.array([20.0]))
    lines = replace(rock_lines_of(case), control_lines=control_lines_of(near))
    energy = []
    for ahead in (-12.0, 0.0, 12.0):
        wrong = with_release(near, ReleaseError(ahead_m=ahead), lines.end)
        expected = np.sort([0.5 * ahead, 1.5 * ahead])
        assert wrong.start - case.start == pytest.approx(np.tile(expected, (6, 1)))
        found = move(near, lines, all_rocks(wrong, lines), BASE, seed=4, count=40)
        energy.append(np.mean(found.passages["speed_mps"] ** 2))
    # Each metre of way more is a fall more.
    assert energy[0] > 1.3 * energy[1] > 1.3**2 * energy[2]


def test_other_stations_are_where_they_are_asked_for() -> None:
    case = followed(observed(6, 3))
    there = with_stations_at(case, np.array([30.0, 60.0]))
    assert there.station_s == pytest.approx(np.tile([30.0, 60.0], (6, 1)), abs=0.5)
    lines = replace(rock_lines_of(case), control_lines=control_lines_of(there))
    (one, *_) = campaigns(there, lines, BASE, count=2, seed=1, tables=frozenset({"passages"}))
    assert set(one.passages.station.tolist()) == {0, 1}


@pytest.mark.parametrize("path", ["fall_line", "followed"])
def test_rocks_of_unknown_release_start_around_the_release_points(
    tmp_path: Path, slope: Grid, path: str
) -> None:
    """As blocks of a run do: half the spacing up and down the slope, not all of them above."""
    config = load_config(write_slope(tmp_path, slope), {"terrain.path": path})
    folder = write_observations(tmp_path / "observed", 12, passages=False)
    rocks = pd.read_csv(folder / "rocks.csv").drop(columns=["x", "y", "z"])
    rocks.to_csv(folder / "rocks.csv", index=False)
    case = read_case(config, folder)
    points = placed_points(read_map_run(config))
    for end, aside in enumerate((5.0, -5.0)):
        _, y = chainage_to_xy(case.traces, case.line, case.start[:, end])
        # Fall lines of this slope run straight to the south; the spacing is 10 m in plan.
        assert np.unique(y.round(3)) == pytest.approx(np.unique(points.y) + aside, abs=1e-3)
