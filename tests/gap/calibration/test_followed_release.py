"""Rocks of a site released again on followed paths: each from its own place, past its stations."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.simulated_slope import ERRORS, STATIONS, TABLE, observed, slope

from sassgis.gap.calibration.observed_release import Released, released, terrain_of
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.rock_lines import rock_lines_of
from sassgis.model.settings import EngineSettings

COUNT = 60


@pytest.fixture(scope="module")
def case() -> Case:
    """On a slope that is the same all across, blocks without tilt and drift keep to fall lines."""
    engine = EngineSettings(side_tilt_deg=0.0, drift_deg=0.0)
    return replace(observed(12, 3, tables=("passages", "deposits")), engine=engine)


def campaigns(case: Case, *, followed: bool, number: int = 2) -> list[Released]:
    grid, kind = slope()
    run: Any = SimpleNamespace(
        followed=followed, heights=grid, ground=kind, segment_tolerance_m=0.05, forest=None
    )
    return released(
        case, rock_lines_of(case), terrain_of(case, run), TABLE, count=COUNT, seed=1, number=number
    )


@pytest.fixture(scope="module")
def both(case: Case) -> tuple[list[Released], list[Released]]:
    return campaigns(case, followed=False), campaigns(case, followed=True)


def test_stops_are_those_of_fall_lines(case: Case, both) -> None:
    from_x = case.observations.rocks.x
    for one in both[1]:
        assert np.abs(one.x - from_x).max() < 5.0 * ERRORS["position_error_m"]
    # Blocks of one place differ in size and speed: each is compared with itself. One that is
    # nearly round rolls, and each vertex costs it: those of the two flattenings differ.
    long = case.observations.rocks.semi_axis_a_m > 1.05 * case.observations.rocks.semi_axis_b_m
    assert long.sum() > 8
    y = [np.array([one.y for one in made]) for made in both]
    scatter = np.sqrt(y[0].var(axis=0) / COUNT + y[1].var(axis=0) / COUNT)
    assert (np.abs(y[0].mean(axis=0) - y[1].mean(axis=0)) < 4.0 * scatter)[long].all()
    assert y[1].std(axis=0).min() > 0.0


def test_stations_are_passed_as_often(both) -> None:
    counts = []
    for made in both:
        rows = [one.campaign.passages for one in made]
        counts.append(
            np.sum([np.bincount(r.station, minlength=len(STATIONS)) for r in rows], axis=0)
        )
    released_rocks = COUNT * 12
    assert (counts[1] > 0).all() and counts[1][0] <= released_rocks
    assert np.abs(counts[0] - counts[1]).max() < 4.0 * np.sqrt(0.5 * released_rocks)


def test_campaigns_of_another_number_are_other_draws(case: Case, both) -> None:
    again, other = (campaigns(case, followed=True, number=n) for n in (2, 3))
    assert np.array_equal([one.y for one in again], [one.y for one in both[1]])
    assert not np.array_equal([one.y for one in other], [one.y for one in both[1]])
