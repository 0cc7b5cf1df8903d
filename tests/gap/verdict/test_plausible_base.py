"""A base is wrong only if none of the calibrations that the rocks leave plausible is right."""

from __future__ import annotations

from dataclasses import replace

import pytest
from helpers.simulated_slope import BASE, table_with

from sassgis.gap.fit.hypothesis_fit import HypothesisFits
from sassgis.gap.fit.linear_fit import summary_of
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.verdict.evidence import first_adequate
from sassgis.gap.verdict.verdict import adequate, large_gaps
from sassgis.simulation.workers import task_map


@pytest.mark.parametrize("jobs", [1, 2])
def test_one_right_model_is_enough(problem: SiteData, jobs: int) -> None:
    wrong = [replace(BASE, table=table_with("debris", eta_max=eta)) for eta in (0.4, 0.85)]
    with task_map(summary_of(problem), jobs) as run:
        made = HypothesisFits(summary_of(problem), run, 8)
        assert first_adequate(made, wrong) is None
        left = first_adequate(made, [*wrong, BASE, BASE])
        assert left is not None and adequate(left)
        # What is told is where the gap lies with that model.
        assert left == first_adequate(made, [BASE])
        assert {f.place for f in left} and not large_gaps(left)
