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
from sassgis.runs.run import run
from sassgis.runs.zone import zone

UNKNOWN = -9999.0


def release(case: Case, *shapes: shapely.Geometry) -> None:
    """Release areas in place of those of the case."""
    names = [f"area {k}" for k in range(len(shapes))]
    case.write_layer("release.gpkg", shapes, {"name": names})


def without(case: Case, rows: slice, cols: slice, *known: tuple[int, int]) -> None:
    """Cells without a height, but for some."""
    heights = gully()
    unknown = np.zeros(heights.shape, bool)
    unknown[rows, cols] = True
    for cell in known:
        unknown[cell] = False
    case.write_dem(np.where(unknown, UNKNOWN, heights))


def hole(case: Case) -> None:
    """No height on the cells of one release point."""
    without(case, slice(23, 26), slice(5, 8))


def one_known(case: Case) -> None:
    """Below each release area the height of a single cell is known."""
    without(case, slice(15, 60), slice(0, 13), (24, 11), (44, 11))
    case.set("release.spacing_m", 1.5)


def beside_unknown(case: Case) -> None:
    """The terrain ends right below the release areas."""
    without(case, slice(0, 70), slice(13, 90))


def rim(case: Case) -> None:
    """On the outermost cells."""
    release(case, box(0.0, 0.0, 90.0, 1.0), box(89.0, 0.0, 1.0, 70.0))


def level(case: Case) -> None:
    """One area in a basin, where no block starts."""
    heights = gully()
    heights[40:55, 3:14] = heights[40:55, 3:14].min()
    case.write_dem(heights)


def shapes(case: Case) -> None:
    """A point, a line half on known ground, and a polygon smaller than a cell."""
    without(case, slice(0, 70), slice(0, 5))
    line = shapely.LineString([place(1.0, 30.0), place(12.0, 30.0)])
    release(case, shapely.Point(place(8.0, 40.0)), line, box(8.2, 20.2, 0.3, 0.3))


def at_random(case: Case) -> None:
    """Points at random, some of them where no height is known."""
    without(case, slice(20, 26), slice(4, 8))
    case.set("release.placement", "random")


def nothing(case: Case) -> None:
    """No release point has a height, though a cell of each area has one."""
    without(case, slice(0, 70), slice(0, 20), (24, 7), (44, 7))


@pytest.mark.parametrize("path", ["followed", pytest.param("fall_line", marks=pytest.mark.battery)])
@pytest.mark.parametrize(
    ("situation", "ready"),
    [
        (hole, True), (one_known, True), (beside_unknown, True), (rim, True), (level, True),
        (shapes, True), (at_random, True), (nothing, False),
    ],
)  # fmt: skip
def test_what_is_ready_is_finished(
    tmp_path: Path, situation: Callable[[Case], None], ready: bool, path: str
) -> None:
    case = two_areas(tmp_path, terrain={"path": path}, output={"paths_max": 20})
    situation(case)
    config = load_config(case.config)
    if not ready:
        for stopped in (check_inputs, lambda own: run(own, tmp_path / "run")):
            with pytest.raises(InputError, match="no block could be simulated"):
                stopped(config)
        return
    report = check_inputs(config)
    assert {own.task for own in report.ready if not (own.missing or own.problem)} >= {"run", "zone"}
    zone(config, tmp_path / "zones", jobs=1)
    assert (tmp_path / "zones" / "map.html").is_file()
