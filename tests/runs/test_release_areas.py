"""What a release area gives does not depend on where the lattice lies; what is uneven is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers.zone_slope import Case, box, place, two_areas, zoned

from sassgis.inputs.config import load_config
from sassgis.runs.check_inputs import check_inputs
from sassgis.runs.resumable_run import Workplace, read_job, simulate_job


def released(case: Case, **areas: shapely.Geometry) -> Case:
    """The case with other release areas."""
    case.write_layer("release.gpkg", list(areas.values()), {"name": list(areas)})
    return case


@pytest.mark.parametrize("path", ["followed", pytest.param("fall_line", marks=pytest.mark.battery)])
def test_a_band_reaches_as_much_wherever_the_lattice_lies(tmp_path: Path, path: str) -> None:
    rates = []
    # Columns of the lattice are 1.5 cells apart: on one, and between two.
    for col in (4.2, 5.2):
        own = {"rocks_per_point": 60, "spacing_m": 3.0}
        case = two_areas(tmp_path, terrain={"path": path}, release=own)
        released(case, band=box(col, 15.0, 0.6, 40.0))
        rates.append(zoned(case.config, tmp_path / f"{col}").rate(0.0).reshape(70, 90))
    at_foot = [rate[:, 40].sum() for rate in rates]
    assert at_foot[1] == pytest.approx(at_foot[0], rel=0.15)
    reached = [np.count_nonzero(rate[:, 30:50]) for rate in rates]
    assert reached[1] == pytest.approx(reached[0], rel=0.15)


def test_what_is_uneven_or_narrow_is_said_before_and_after(tmp_path: Path) -> None:
    steps = shapely.MultiPolygon([box(col, 40.0, 0.4, 0.4) for col in np.arange(4.0, 16.0, 2.0)])
    pieces = shapely.MultiLineString(
        [[place(col, 50.0), place(col + 0.2, 50.0)] for col in np.arange(4.0, 16.0, 2.0)]
    )
    case = two_areas(tmp_path, release={"rocks_per_point": 1})
    released(
        case, even=box(4.0, 20.0, 8.0, 9.0), thin=box(13.0, 10.0, 0.4, 50.0), steps=steps,
        pieces=pieces,
    )  # fmt: skip
    config = load_config(case.config)
    job = read_job(config, None, lambda _: None)
    done = simulate_job(job, Workplace(tmp_path / "work", 1, None, lambda _: None))
    for warnings in (check_inputs(config).warnings, done.warnings):
        (uneven,) = (text for text in warnings if "for their size" in text)
        # Six squares of 0.64 m2 and six lines of 0.4 m, each with a point; 36 m2 and 6 m have one.
        assert "steps (6, 0.11), pieces (6, 0.4)." in uneven and "even (" not in uneven
        (narrow,) = (text for text in warnings if "release areas" in text)
        # 80 m2 in two points.
        assert "one point): thin (5" in narrow and "steps" not in narrow


def test_areas_without_a_block_are_named(tmp_path: Path) -> None:
    case = two_areas(tmp_path, release={"rocks_per_point": 1})
    heights = np.broadcast_to(1500.0 - 1.6 * np.arange(90), (70, 90)).copy()
    heights[15:35, :20] = np.nan
    heights[24, 7] = 1490.0
    case.write_dem(heights)
    config = load_config(case.config)
    job = read_job(config, None, lambda _: None)
    done = simulate_job(job, Workplace(tmp_path / "work", 1, None, lambda _: None))
    for warnings in (check_inputs(config).warnings, done.warnings):
        (idle,) = (text for text in warnings if text.startswith("No block starts"))
        assert "known heights: north." in idle
