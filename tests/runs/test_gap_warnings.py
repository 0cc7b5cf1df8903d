"""What a diagnosis warns of: rocks that leave the terrain or have no stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers.simulated_slope import BASE, observed, with_observed

from sassgis.runs.calibrate import edge_warnings, limit_warnings, stop_warnings
from sassgis.settings.ground import GroundTable


def test_rocks_that_leave_the_terrain_are_told() -> None:
    assert edge_warnings(0.0, 0.009) == ()
    (said,) = edge_warnings(0.94, 0.0)
    assert said.startswith(
        "94 % of the rocks of the configured model and 0 % of those of the calibrated"
    )


def test_rocks_that_passed_the_last_station_and_have_no_stop_are_told() -> None:
    case = observed(20, 3)
    assert stop_warnings(case) == ()
    last = case.observations.passages.station == case.station_names[-1]
    passed = np.unique(case.observations.passages.rock_id[last])[:2]
    stops = case.observations.deposits
    lost = with_observed(case, deposits=stops.take(~np.isin(stops.rock_id, passed)))
    (said,) = stop_warnings(lost)
    assert said.startswith("Rocks that passed the last station and have no stop: 2.")
    # Nothing is said where no stops were observed at all.
    assert stop_warnings(observed(20, 3, tables=("passages",))) == ()


def test_values_at_their_limit_are_told() -> None:
    case = replace(observed(20, 3), met=("debris",))
    usual = tuple(replace(c, restitution=0.4) for c in BASE.table.classes)
    assert limit_warnings(case, replace(BASE, table=GroundTable(usual))) == ()
    slippery = tuple(replace(c, mu_f=0.06) if c.name == "debris" else c for c in usual)
    (said,) = limit_warnings(case, replace(BASE, table=GroundTable(slippery)))
    assert said.startswith("Values at the limit of all known grounds: debris mu_f 0.06.")
    # One that the user states is not a finding.
    stated = replace(case, table=GroundTable(slippery))
    assert limit_warnings(stated, replace(BASE, table=GroundTable(slippery))) == ()
    losing = tuple(replace(c, mu_v=0.05) if c.name == "debris" else c for c in usual)
    (said,) = limit_warnings(case, replace(BASE, table=GroundTable(losing)))
    assert said.startswith("Values at the limit of all known grounds: debris mu_v 0.05.")
