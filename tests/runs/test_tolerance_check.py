"""A sample at half and double the tolerance: blind where nothing depends on it, not elsewhere."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from sassgis.inputs.ground_map import built_in_table
from sassgis.settings.map_run import MapRun, Round
from sassgis.settings.settings import EngineSettings
from sassgis.simulation.loop import check_tolerance, plan_of_points, sampled_plan, simulate_map
from sassgis.terrain.prepare import Plan, plan


def on_waves(job: MapRun, height_m: float) -> MapRun:
    """The run on a slope of 35° with waves of 12 m, and a flatter one below the release areas."""
    n_rows, n_cols = job.grid.shape
    down = job.grid.cell_size * np.arange(n_rows)[:, None] + np.zeros(n_cols)
    foot = job.grid.north - min(a.geometry.bounds[1] for a in job.areas) + 60.0
    z = 2000.0 - 0.7 * np.minimum(down, foot) - 0.2 * np.maximum(down - foot, 0.0)
    z += height_m * np.sin(2.0 * np.pi * down / 12.0)
    # With the paper's readings corners of the ground cost most.
    engine = EngineSettings(readings="1986")
    grid = replace(job.grid, values=z)
    return replace(
        job, grid=grid, ground_heights=None, control_lines=(), engine=engine,
        table=built_in_table("1986"),
        terrain=replace(job.terrain, segment_tolerance_m=0.25, path="fall_line"),
    )  # fmt: skip


def test_on_a_plane_nothing_hangs_on_it(job: MapRun) -> None:
    flat = on_waves(job, 0.0)
    check = check_tolerance(flat, plan(flat), 1)
    assert check is not None and check.blocks > 0
    assert set(check.answers) == {0.125, 0.5}
    for found in check.answers.values():
        # The foot of the slope lies between samples of the heights: it alone may move.
        assert all(abs(answer.value) < 0.03 for answer in found.values())
    assert not check.warnings()


def test_waves_within_double_the_tolerance_are_seen(job: MapRun) -> None:
    # Within 0.5 m the waves of 0.3 m are gone, within 0.125 and 0.25 m they are not.
    wavy = on_waves(job, 0.3)
    wavy = replace(wavy, release=replace(wavy.release, rocks_per_point=20))
    check = check_tolerance(wavy, plan(wavy), 1)
    assert check is not None
    half, double = (check.answers[t]["energy_q95"].value for t in (0.125, 0.5))
    assert double > 0.5 and abs(half) < 0.2
    (warning,) = check.warnings()
    assert "segment_tolerance_m (0.25 m)" in warning and "at 0.5 m" in warning


def test_without_a_tolerance_there_is_nothing_to_check(job: MapRun, planned: Plan) -> None:
    exact = replace(job, terrain=replace(job.terrain, segment_tolerance_m=0.0))
    assert check_tolerance(exact, planned, 1) is None


@pytest.mark.parametrize("blocks", [60, 400, 10**6])
def test_the_sample_is_about_as_large_as_wanted(job: MapRun, planned: Plan, blocks: int) -> None:
    many = replace(job, release=replace(job.release, rocks_per_point=50), rounds=(Round(0, 3),))
    few, points = sampled_plan(many, planned, blocks, 10)
    n = int(points.blocks_of_point(few).sum())
    whole = int(planned.blocks_of_point(replace(many, rounds=(Round(),))).sum())
    assert n == pytest.approx(min(blocks, whole), rel=0.3)
    assert len(points.points) >= 10 and set(points.points.area) == set(planned.points.area)


def test_the_same_blocks_as_in_the_run(job: MapRun, planned: Plan) -> None:
    which = np.arange(0, len(planned.points), 3)
    some = simulate_map(job, plan_of_points(planned, which))
    rest = np.setdiff1d(np.arange(len(planned.points)), which)
    other = simulate_map(job, plan_of_points(planned, rest))
    whole = simulate_map(job, planned)
    assert np.array_equal(some.reasons + other.reasons, whole.reasons)
    width = whole.runout.shape[1]
    parts = [np.pad(p.runout, ((0, 0), (0, width - p.runout.shape[1]))) for p in (some, other)]
    assert np.array_equal(sum(parts), whole.runout)


def test_manifest_and_report_say_it(small) -> None:
    manifest = json.loads((small.folder / "manifest.json").read_text(encoding="utf-8"))
    check = manifest["checks"]["segment_tolerance"]
    assert check["tolerance_m"] == 0.05 and set(check["changes"]) == {"0.025 m", "0.1 m"}
    page = (small.folder / "report.html").read_text(encoding="utf-8")
    assert (
        "Change of the results at half and double this gap" in page
        and "0.025 m: median run-out" in page
    )
