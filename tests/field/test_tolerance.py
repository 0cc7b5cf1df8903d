"""Run-out on a fine terrain at block scale: settled at small tolerances, and at usual ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import authume
import pytest

from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run
from sassgis.settings.map_run import MapRun
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.loop import check_tolerance, simulate_map
from sassgis.simulation.response import LARGEST_CHANGE, outcome_of
from sassgis.terrain.prepare import Plan, plan

pytestmark = pytest.mark.battery


@pytest.fixture(scope="module")
def quarry(shared_data: Path, tmp_path_factory) -> tuple[MapRun, Plan]:
    data = shared_data / authume.FOLDER
    if not data.is_dir():
        pytest.skip("the data of the Authume quarry are not in the folder of the field data")
    observed = authume.read_observed(data)
    path = authume.write_inputs(tmp_path_factory.mktemp("in"), data, observed, 20, 1.0, {})
    run = read_map_run(load_config(path, {"engine.readings": "hazard"}))
    return run, plan(run)


def test_run_out_settles_at_small_tolerances(quarry: tuple[MapRun, Plan]) -> None:
    run, planned = quarry
    assert run.ground_heights is not None and run.grid.cell_size < run.block_scale_m
    found = []
    for tolerance in (0.02, 0.05, 0.1):
        fine = replace(run, terrain=replace(run.terrain, segment_tolerance_m=tolerance))
        outcome = outcome_of(simulate_map(fine, planned, jobs=1), bins_of(fine))
        found.append(outcome.runout_m(0.5, 0.9))
    for one in found[1:]:
        assert one == pytest.approx(found[0], rel=0.2)


def test_half_and_double_of_usual_tolerances_change_little(quarry: tuple[MapRun, Plan]) -> None:
    """The check of each run finds nothing to report here, from 5 cm to half a metre.

    That a change is reported is shown on a slope with waves (tests/runs/map).
    """
    run, planned = quarry
    for tolerance in (0.1, 0.25):
        rough = replace(run, terrain=replace(run.terrain, segment_tolerance_m=tolerance))
        check = check_tolerance(rough, planned, 1)
        assert check is not None and check.blocks > 200
        assert set(check.answers) == {0.5 * tolerance, 2.0 * tolerance}
        for found in check.answers.values():
            assert all(abs(answer.value) < LARGEST_CHANGE for answer in found.values())
        assert not check.warnings()
