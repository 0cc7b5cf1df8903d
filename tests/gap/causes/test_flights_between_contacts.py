"""Flights between recorded contacts: what contacts that are in no table may not be taken for."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers.simulated_slope import with_observed
from numpy.typing import NDArray

from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.forward.released_rocks import configured_model
from sassgis.gap.residuals.residual_table import (
    MODEL_FLIGHT,
    ResidualTable,
    StepTable,
    residuals_of,
)
from sassgis.gap.verdict.verdict import fingerprints

STRUCK = "energy lost at once, on few flights"
SCALE = "speeds against the falls between contacts, all rocks alike"
ROCKS, EACH = 24, 25
FALL_M, SPEED2, ERROR = 4.0, 200.0, 0.02


@pytest.fixture(scope="module")
def base(problem: SiteData) -> ResidualTable:
    return residuals_of(problem.case, configured_model(problem.case), seed=5, replicates=4)


def flights(rise_m: NDArray[np.float64], kept: NDArray[np.float64], scale: float) -> StepTable:
    """Each rock falls on each flight; ``kept``: share of the energy that it comes with."""
    n = ROCKS * EACH
    rng = np.random.default_rng(11)
    fell = np.full(n, 9.81 * FALL_M)
    out, into = 0.5 * SPEED2, (0.5 * SPEED2 + fell) * kept
    noisy = [v * (scale * (1.0 + ERROR * rng.standard_normal(n))) ** 2 for v in (out, into)]
    predicted = noisy[0] + fell
    given = {
        "rock": np.repeat(np.arange(ROCKS), EACH), "step": np.array("flight"),
        "quantity": np.array("energy_jpkg"), "observed": noisy[1], "predicted": predicted,
        "sd": 2.0 * ERROR * np.hypot(out, into), "ground": -1, "station": -1,
        "radius_m": 0.4, "reach": 1.0 / scale, "way_m": 10.0, "clear_m": rise_m, "fell_jpkg": fell,
    }  # fmt: skip
    return StepTable(
        *(np.broadcast_to(np.asarray(given.get(f.name, np.nan)), n) for f in fields(StepTable))
    )


def z_of(
    problem: SiteData, base: ResidualTable, seen: StepTable, filmed: bool = False
) -> dict[str, float]:
    case = problem.case
    if not filmed:
        case = with_observed(case, trajectories=case.observations.trajectories.take([]))
    # Flights of the model itself would set what a null site shows; here there are none.
    other = base.steps.where(~np.isin(base.steps.step, ("flight", MODEL_FLIGHT)))
    joined = StepTable(
        *(np.concatenate([getattr(t, f.name) for t in (other, seen)]) for f in fields(StepTable))
    )
    found = fingerprints(case, replace(base, steps=joined))
    return {one.statistic: one.z for one in found if one.observable}


def some(share: float) -> NDArray[np.bool_]:
    return np.random.default_rng(7).random(ROCKS * EACH) < share


@pytest.mark.parametrize(("rise_m", "tree"), [(0.25, False), (2.0, True)])
def test_what_is_lost_on_low_hops_is_no_tree(
    problem: SiteData, base: ResidualTable, rise_m: float, tree: bool
) -> None:
    struck = some(0.06)
    rise = np.where(struck, rise_m, 2.0)
    z = z_of(problem, base, flights(rise, np.where(struck, 0.6, 1.0), 1.0))
    assert z[STRUCK] > 3.0 if tree else z[STRUCK] < 0.0


def test_low_hops_alone_say_nothing_of_trees(problem: SiteData, base: ResidualTable) -> None:
    low = np.full(ROCKS * EACH, 0.2)
    assert STRUCK not in z_of(problem, base, flights(low, np.where(some(0.5), 0.5, 1.0), 1.0))


@pytest.mark.parametrize(("scale", "lost", "found"), [
    (1.0, 0.0, False), (1.0, 0.3, False), (1.0, 0.7, False), (1.15, 0.0, True), (1.15, 0.05, True),
    (0.85, 0.0, True), (0.85, 0.2, True),
])  # fmt: skip
def test_a_scale_of_speeds_gains_more_or_less_than_the_fall_on_all_flights(
    problem: SiteData, base: ResidualTable, scale: float, lost: float, found: bool
) -> None:
    kept = np.where(some(lost), 0.7, 1.0)
    seen = flights(np.full(ROCKS * EACH, 2.0), kept, scale)
    z = z_of(problem, base, seen)[SCALE]
    assert z > 5.0 if found else z < 0.0
    if scale > 1.0 and lost == 0.0:
        per = np.array([(seen.observed - seen.predicted).sum() / seen.fell_jpkg.sum()])
        assert np.sqrt(1.0 + per[0]) == pytest.approx(scale, abs=0.01)
    # Where paths in time confirm the speeds it is none.
    assert SCALE not in z_of(problem, base, seen, filmed=True)
