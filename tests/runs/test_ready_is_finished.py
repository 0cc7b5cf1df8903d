"""Whatever ``validate`` calls ready is finished by ``run`` and ``zone``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers.zone_slope import Case, box, gully, place, two_areas

from sassgis.errors import InputError
from sassgis.inputs.config import load_config
from sassgis.runs.check_inputs import check_inputs
from sassgis.runs.run import run, zone

UNKNOWN = -9999.0


def without(case: Case, rows: slice, cols: slice, *known: tuple[int, int]) -> None:
    """Cells without a height, but for some."""
    heights = gully()
    unknown = np.zeros(heights.shape, bool)
    unknown[rows, cols] = True
    for cell in known:
        unknown[cell] = False
    case.write_dem(np.where(unknown, UNKNOWN, heights))


def one_known(case: Case) -> None:
    """Below each release area the height of a single cell is known."""
    without(case, slice(15, 60), slice(0, 13), (24, 11), (44, 11))
    case.set("release.spacing_m", 1.5)


def beside_unknown(case: Case) -> None:
    """The terrain ends right below the release areas; points at random."""
    without(case, slice(0, 70), slice(13, 90))
    case.set("release.placement", "random")


def odd_areas(case: Case) -> None:
    """A basin, the rim of the terrain, half known lines, less than a cell, a hole at a point."""
    heights = gully()
    heights[40:55, 3:14] = heights[40:55, 3:14].min()
    heights[:, :2] = heights[23:26, 5:8] = UNKNOWN
    case.write_dem(heights)
    line = shapely.LineString([place(0.5, 30.0), place(12.0, 30.0)])
    areas = [
        box(4.0, 20.0, 8.0, 9.0), box(4.0, 42.0, 8.0, 9.0), box(0.0, 0.0, 90.0, 1.0),
        box(89.0, 0.0, 1.0, 70.0), shapely.Point(place(8.0, 60.0)), line, box(8.2, 34.2, 0.3, 0.3),
    ]  # fmt: skip
    case.write_layer("release.gpkg", areas, {"name": [f"area {k}" for k in range(len(areas))]})


@pytest.mark.parametrize("path", ["followed", pytest.param("fall_line", marks=pytest.mark.battery)])
@pytest.mark.parametrize("situation", [one_known, beside_unknown, odd_areas])
def test_what_is_ready_is_finished(
    tmp_path: Path, situation: Callable[[Case], None], path: str
) -> None:
    case = two_areas(tmp_path, terrain={"path": path}, output={"paths_max": 20})
    situation(case)
    config = load_config(case.config)
    report = check_inputs(config)
    assert {own.task for own in report.ready if not (own.missing or own.problem)} >= {"run", "zone"}
    zone(config, tmp_path / "zones", jobs=1)
    assert (tmp_path / "zones" / "map.html").is_file()


def test_without_a_point_of_known_height_nothing_is_ready(tmp_path: Path) -> None:
    """Though a cell of each area has a height."""
    case = two_areas(tmp_path)
    without(case, slice(0, 70), slice(0, 20), (24, 7), (44, 7))
    config = load_config(case.config)
    for stopped in (check_inputs, lambda own: run(own, tmp_path / "run")):
        with pytest.raises(InputError, match="no block could be simulated"):
            stopped(config)
