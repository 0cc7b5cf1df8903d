"""Paths in space are those of blocks of the run."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from helpers.zone_slope import two_areas
from scipy.interpolate import RegularGridInterpolator

from sassgis.runs.run import RunResult, run
from sassgis.simulation.path_sample import sample_paths

Result = tuple[RunResult, gpd.GeoDataFrame, gpd.GeoDataFrame]


@pytest.fixture(scope="module", params=["followed", "fall_line"])
def result(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = tmp_path_factory.mktemp(request.param)
    case = two_areas(folder, terrain={"path": request.param}, output={"paths_max": 12})
    done = run(case.config, folder / "out", jobs=1)
    paths, stops = (
        gpd.read_file(folder / "out" / "result.gpkg", layer=n) for n in ("paths", "stops")
    )
    return done, paths, stops


def test_paths_end_where_their_blocks_stop(result: Result) -> None:
    _, paths, stops = result
    assert 6 <= len(paths) <= 12 and set(paths["area"]) == {"north", "south"}
    assert set(paths["scenario"]) == {"frequent", "rare"}
    for path in paths.itertuples():
        own = (stops["area"] == path.area) & (stops["scenario"] == path.scenario)
        same = stops[own & (stops["runout_m"] == path.runout_m)]
        same = same[same["max_energy_kj"] == path.max_energy_kj]
        assert len(same) == 1, "not a block of the run"
        end = shapely.get_coordinates(path.geometry)[-1]
        assert np.hypot(*(end - same.geometry.iloc[0].coords[0])) < 0.02


def test_paths_fly_over_the_terrain(result: Result) -> None:
    done, paths, _ = result
    grid = done.run.heights
    rows, cols = (np.arange(n) for n in grid.shape)
    height = RegularGridInterpolator((rows, cols), grid.values, bounds_error=False)
    for path in paths.itertuples():
        x, y, z = shapely.get_coordinates(path.geometry, include_z=True).T
        col, row = grid.col_row(x, y)
        above = z - height(np.column_stack([row, col]))
        known = np.isfinite(above)
        # Segments lie within 0.05 m of the terrain; centres at least a semi-axis above it.
        assert known.mean() > 0.8 and above[known].min() > -0.1
        assert above[known].max() < path.max_height_m + 1.5
        # Blocks start some metres down a fall line.
        assert 0.9 * path.runout_m < shapely.length(path.geometry) < path.runout_m + 3.0


def test_contacts_lie_on_their_paths(result: Result) -> None:
    done, paths, _ = result
    contacts = pd.read_csv(done.folder / "tables" / "contacts.csv")
    assert set(contacts["path"]) == set(range(1, len(paths) + 1))
    for number, own in contacts.groupby("path"):
        path = paths.iloc[int(str(number)) - 1]
        assert set(own["area"]) == {path.area} and set(own["scenario"]) == {path.scenario}
        points = shapely.points(own[["x_m", "y_m"]].to_numpy())
        assert shapely.distance(points, shapely.force_2d(path.geometry)).max() < 0.05
        assert own["t_s"].is_monotonic_increasing and own["t_s"].iloc[-1] <= path.time_s + 0.01


def test_as_many_are_written_as_are_asked_for(
    result: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, _, stops = result
    assert sample_paths(done.run, done.planned, 0) == ()
    each = done.run.release.rocks_per_point
    entries = sum(len(done.planned.scenarios[a]) for a in done.planned.points.area)
    assert done.run.repetitions == 1 and each > 3 and len(stops) == each * entries
    for at_a_time in (100, 3):
        monkeypatch.setattr("sassgis.simulation.path_sample._PATHS", at_a_time)
        paths = sample_paths(done.run, done.planned, 10_000)
        # All blocks of the run, and none twice.
        for (area, scenario), own in stops.groupby(["area", "scenario"]):
            found = [p.runout_m for p in paths if (p.area, p.scenario) == (area, scenario)]
            assert sorted(found) == pytest.approx(sorted(own["runout_m"]), abs=0.006)
        # As many of each point.
        assert len(sample_paths(done.run, done.planned, 3 * entries + 1)) == 3 * entries


def test_paths_from_the_command_line(result: Result, tmp_path: Path, call, refusal) -> None:
    done, paths, _ = result
    file = tmp_path / "paths.kml"
    code, out, err = call("export", done.folder, "-o", file, "--layer", "paths")
    assert (code, err) == (0, "") and f"{len(paths)} paths" in out
    lines = list(ET.parse(file).iter("{http://www.opengis.net/kml/2.2}LineString"))
    assert len(lines) == len(paths)
    heights = re.findall(r",(\d+\.?\d*)\s", ET.tostring(lines[0], encoding="unicode"))
    wanted = shapely.get_coordinates(paths.geometry[0], include_z=True)[:, 2]
    assert np.allclose(np.array(heights, float), wanted, atol=1e-3)
    for more in (["--canton", "TI"], ["--validate"]):
        assert "are for .xtf" in refusal("export", done.folder, "-o", tmp_path / "a.kml", *more)
    err = refusal("export", done.folder, "-o", tmp_path / "a.xtf", "--layer", "paths")
    assert "holds zones" in err
    assert "no hazard zones" in refusal("export", done.folder, "-o", tmp_path / "a.kml")
