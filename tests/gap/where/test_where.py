"""Where the gap lies, on observations that the engine made: the truth is known."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from helpers.simulated_slope import STATIONS, TABLE, observed

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.engine.ellipse import frame_of, inertia
from sassgis.engine.impact import SCALE, impact
from sassgis.gap.diagnosis import GapFinding
from sassgis.gap.inference.rock_tests import mean_gap_tests
from sassgis.gap.residuals.free_run import RunModel, free_run, observed_at_stations
from sassgis.gap.residuals.impact_step import impact_draws, orientation_at_contact
from sassgis.gap.residuals.residuals import Residual, beyond, mean_of_draws, only_above, spread
from sassgis.gap.where.findings import LEAST_ROCKS, locate, reach_edges, where
from sassgis.model.effects import EffectSettings
from sassgis.model.ground import GroundTable


def changed(name: str, **values: float) -> GroundTable:
    """The table with other values of one class."""
    return GroundTable(
        tuple(dataclasses.replace(c, **values) if c.name == name else c for c in TABLE.classes)
    )


def found(case: Any, **kwargs: Any) -> tuple[GapFinding, ...]:
    return where(case, TABLE, seed=3, draws=499, **kwargs)


def one(findings: tuple[GapFinding, ...], place: str, quantity: str, test: str) -> GapFinding:
    (own,) = (
        f
        for f in findings
        if (f.place, f.quantity, f.test) == (place, quantity, test) and f.phase != "release"
    )
    return own


# ---------------------------------------------------------------------------------------------
# Steps


def test_an_impact_of_a_sphere_is_that_of_the_law():
    """A sphere has no orientation: with an even slope nothing is left to chance."""
    r, dip = 0.4, math.radians(35.0)
    rows = np.array([[dip, 9.0, -4.0, 15.0, 0.5, 0.7, 1.0]])
    draws = np.zeros((1, 3, 3))
    draws[0, :, 0] = 0.1, 1.0, 2.0
    out = np.empty((1, 3, 3))
    impact_draws(rows, np.full((1, 3, 3), r), draws, 9.81, 0.1, SCALE, out)
    expected = impact(0.0, r, inertia(r, r), 9.0, -4.0, 15.0, 0.5, SCALE, 0.7)
    np.testing.assert_allclose(out[0], np.tile(expected, (3, 1)), rtol=1e-12)


def test_the_slope_that_is_met_is_flatter_by_the_variation():
    """Half of the tangent: the velocity is taken apart along the met ground and put back."""
    r, dip = 0.4, math.radians(40.0)
    rows = np.array([[dip, 12.0, -5.0, 20.0, 1.0, 0.7, 1.0]])
    draws = np.zeros((1, 1, 3))
    draws[0, 0, 1] = 0.5
    out = np.empty((1, 1, 3))
    impact_draws(rows, np.full((1, 1, 3), r), draws, 9.81, 0.1, SCALE, out)
    met = math.atan(0.5 * math.tan(dip))

    def apart(vx: float, vz: float, angle: float) -> tuple[float, float]:
        c, s = math.cos(angle), math.sin(angle)
        return vx * c - vz * s, vx * s + vz * c

    vx = 12.0 * math.cos(dip) + -5.0 * math.sin(dip)
    vz = -12.0 * math.sin(dip) + -5.0 * math.cos(dip)
    vt, vn = apart(vx, vz, met)
    wt, wn, spin = impact(0.0, r, inertia(r, r), vt, vn, 20.0, 1.0, SCALE, 0.7)
    ux = wt * math.cos(met) + wn * math.sin(met)
    uz = -wt * math.sin(met) + wn * math.cos(met)
    np.testing.assert_allclose(out[0, 0], (*apart(ux, uz, dip), spin), rtol=1e-12)


def test_soft_landings_are_left_to_rolling():
    rows = np.array([[0.5, 5.0, -0.3, 10.0, 0.5, 0.7, 0.0]])
    out = np.empty((1, 4, 3))
    impact_draws(rows, np.full((1, 4, 3), 0.5), np.zeros((1, 4, 3)), 9.81, 0.1, SCALE, out)
    assert np.isnan(out).all()


@pytest.mark.parametrize("omega", [0.0, 8.0, 40.0, -25.0])
def test_at_contact_the_ellipse_touches_and_approaches(omega):
    a, b, vn = 0.6, 0.4, -3.0
    for phase in np.linspace(0.0, math.pi, 37):
        theta = orientation_at_contact(a, b, phase, vn, omega)
        _, y, _ = frame_of(a, b, math.sin(theta), math.cos(theta))
        if omega:
            t = (phase - theta) / omega
            assert a + vn * t == pytest.approx(y, abs=1e-6)
            # And not before.
            for earlier in np.linspace(0.0, t, 50)[:-1]:
                angle = phase - omega * earlier
                assert (
                    a + vn * earlier >= math.hypot(a * math.sin(angle), b * math.cos(angle)) - 1e-3
                )
        else:
            assert theta == phase


def test_scatter_of_exchangeable_draws_is_as_expected():
    rng = np.random.default_rng(1)
    for m in (7, 20):
        values = rng.gamma(2.0, size=(20_000, m + 1))
        away, usual, score = spread(values[:, 0], values[:, 1:])
        assert score.mean() == pytest.approx(0.0, abs=4.0 * score.std() / 141.0)
        assert away.mean() == pytest.approx(usual.mean(), rel=0.03)
        _, _, wide = spread(3.0 * (values[:, 0] - 2.0) + 2.0, values[:, 1:])
        assert wide.mean() > 0.05
    away, usual, score = spread(np.array([1.0, np.nan]), np.array([[1.0, np.nan], [1.0, 2.0]]))
    assert np.isnan(score).all()


def test_tolerances():
    np.testing.assert_allclose(beyond(np.array([1.0, 3.0, np.nan]), 0.5)[:2], [0.5, 2.5])
    np.testing.assert_allclose(beyond(np.array([-0.1, 0.3]), 0.5).mean(), 0.0, atol=1e-15)
    assert (only_above(np.array([-1.0, 0.5])) == 0.0).all()
    np.testing.assert_allclose(only_above(np.array([-0.1, 0.5])), [-0.1, 0.5])
    assert np.isnan(mean_of_draws(np.array([[1.0, np.nan, np.nan]]))).all()


def test_weights_of_residuals():
    """The tested values have the weighted mean; rocks without one count for nothing."""
    weight = np.array([1.0, 3.0, 9.0])
    seen = np.array([1.0, 2.0, np.nan])
    r = Residual(
        "S1", "flight", "speed_mps", "one step", seen, np.zeros(3), 0.0, 0.0, weight=weight
    )
    assert np.nanmean(r.tested()) == pytest.approx((1.0 + 3.0 * 2.0) / 4.0)
    assert r.unit == "m/s"
    assert dataclasses.replace(r, quantity="rebound_angle_deg_spread").unit == "°"
    assert dataclasses.replace(r, quantity="energy_kept").unit == "1"
    assert dataclasses.replace(r, quantity="runout_m").unit == "m"
    assert dataclasses.replace(r, quantity="acceleration_mps2").unit == "m/s²"


def test_missing_values_keep_the_level_of_the_tests():
    """Rocks that lack a quantity neither help nor hurt it: p-values stay uniform."""
    rng = np.random.default_rng(8)
    p, largest = [], []
    for _ in range(300):
        values = rng.standard_normal((24, 6))
        values[rng.random((24, 6)) < 0.4] = np.nan
        values[:, 5] = np.nan
        values[:2, 5] = 1.0
        _, own, adjusted = mean_gap_tests(values, draws=199, rng=rng)
        assert np.isnan(own[5]) and np.isnan(adjusted[5])
        p.append(own[:5])
        largest.append(np.nanmin(adjusted))
    assert 0.03 < np.mean(np.concatenate(p) <= 0.05) < 0.07
    assert np.mean(np.array(largest) <= 0.05) < 0.09
    values = np.tile([1.0, 0.0, np.nan], (12, 1))
    t, _, adjusted = mean_gap_tests(values, draws=199, rng=rng)
    assert np.isinf(t[0]) and adjusted[0] < 0.05 and t[1] == 0.0 and adjusted[1] == 1.0


# ---------------------------------------------------------------------------------------------
# Rocks


def test_rocks_that_stop_or_pass_are_told_apart():
    case = observed(12, 1, tables=("passages", "deposits"))
    seen = observed_at_stations(case)
    assert seen.speed_mps.shape == (12, 4)
    np.testing.assert_array_equal(seen.came == 1.0, np.isfinite(seen.speed_mps))
    # A rock seen further down has passed, also where nobody looked.
    passages = case.observations.passages
    first = passages.take(passages.station != "S2")
    hidden = dataclasses.replace(
        case,
        observations=dataclasses.replace(case.observations, passages=first),
        projected={**case.projected, "passages": _taken(case, passages.station != "S2")},
    )
    np.testing.assert_array_equal(observed_at_stations(hidden).came, seen.came)


def _taken(case: Any, which: Any) -> Any:
    put = case.projected["passages"]
    return type(put)(*(getattr(put, f.name)[which] for f in dataclasses.fields(put)))


def test_runs_from_the_release_are_those_of_the_engine():
    case = observed(8, 2, tables=("deposits",))
    run = free_run(case, RunModel.of(case, TABLE, None, None, 4), 6)
    assert run.runout_m.shape == (8, 6) and run.axes_m.shape == (8, 6, 3)
    assert (run.stops == 1.0).all() and (run.largest == 1.0).all()
    came = run.at.came == 1.0
    np.testing.assert_array_equal(came, run.runout_m[:, :, None] >= case.station_s[:, None, :])
    np.testing.assert_array_equal(came, np.isfinite(run.at.speed_mps))
    edges = reach_edges(case, run)
    np.testing.assert_allclose(edges[1:, 0], STATIONS, atol=0.1)
    np.testing.assert_array_equal(edges[1:, 0], edges[:-1, 1])


def test_softer_ground_shows_on_its_reaches_and_class():
    """Debris lies between 50 and 110 m: it keeps less energy than the model thinks."""
    f = found(observed(40, 11, table=changed("debris", eta_max=0.37)))
    assert f == tuple(sorted(f, key=lambda x: x.p_adjusted))
    kept = one(f, "ground:debris", "energy_kept", "one step")
    assert kept.p_adjusted < 0.01 and kept.gap == pytest.approx(0.37 - 0.62, abs=0.04)
    assert kept.ci95[0] < kept.gap < kept.ci95[1] < -0.15
    assert kept.observed - kept.predicted == pytest.approx(kept.gap)
    for place in ("ground:rock", "ground:talus", "ground:meadow"):
        own = [x for x in f if x.place == place and x.quantity == "energy_kept"]
        assert all(x.p_adjusted > 0.05 for x in own)
    slow = one(f, "S1-S2", "speed_mps", "reach")
    assert slow.p_adjusted < 0.01 and slow.gap < -3.0 and slow.unit == "m/s"
    # From the release it is carried on; above, nothing is wrong.
    assert one(f, "S2", "speed_mps", "free run").p_adjusted < 0.01
    assert one(f, "S1", "speed_mps", "free run").p_adjusted > 0.05
    assert not [x for x in f if x.phase == "release" and x.p_adjusted < 0.05]
    phase, reaches = locate(f)
    assert phase == "impact" and set(reaches) <= {"S1-S2", "S2-S3"} and reaches
    # On the map the reach lies between its stations, which run across at these heights.
    assert slow.s0_m == pytest.approx(STATIONS[0], abs=0.1)
    assert slow.s1_m == pytest.approx(STATIONS[1], abs=0.1)
    assert slow.y == pytest.approx(330.0 - 20.0 - 0.5 * sum(STATIONS[:2]), abs=0.5)


def test_softer_ground_shows_without_impacts():
    case = observed(40, 12, table=changed("debris", eta_max=0.37), tables=("passages", "deposits"))
    f = found(case)
    assert {x.test for x in f} == {"free run", "reach"}
    phase, reaches = locate(f, ("impact",))
    assert phase == "impact" and reaches[0] == "S1-S2" and "release-S1" not in reaches


def test_drag_shows_in_flight():
    drag = EffectSettings(AirDrag(drag_coefficient=10.0, air_density_kgm3=2.0))
    f = found(observed(50, 13, effects=drag))
    for quantity, sign in (
        ("speed_change_mps", -1.0),
        ("horizontal_acceleration_mps2", -1.0),
        ("vertical_acceleration_mps2", 1.0),
    ):
        own = one(f, "all", quantity, "one step")
        assert own.phase == "flight" and sign * own.gap > 0.0 and own.p_adjusted < 0.05
    assert not [x for x in f if x.phase == "impact" and x.p_adjusted < 0.05]
    assert locate(f)[0] == "flight"
    # The same effect in the model: nothing is left to say about flights.
    assert "flight" not in {
        x.phase for x in found(observed(20, 13), effects=drag) if x.test == "one step"
    }


def test_stems_show_where_they_stand():
    trees = EffectSettings(Trees(efficiency=1.0, height_m=10.0))
    f = found(
        observed(
            40, 14, effects=trees, stand=(85.0, 115.0, 1500.0, 0.35),
            tables=("passages", "deposits"),
        )
    )  # fmt: skip
    assert one(f, "S2-S3", "speed_mps", "reach").gap < -5.0
    phase, reaches = locate(f, ("flight", "rolling"))
    assert phase in ("flight", "rolling") and "S2-S3" in reaches
    assert not {"release-S1", "S1-S2"} & set(reaches)


def test_a_wrong_release_leaves_the_reaches_right():
    """Rocks that start much faster than stated come to the first station otherwise."""
    f = found(observed(80, 15, faster_mps=12.0, tables=("passages", "deposits")))
    assert min(x.p_adjusted for x in f if x.place == "S1") < 0.01
    below = [x for x in f if x.test == "reach" and x.place != "release-S1"]
    assert below and all(x.p_adjusted > 0.05 for x in below)
    assert locate(f)[1] == ("release-S1",)


def test_stops_alone_say_where_rocks_come_to_rest():
    case = observed(40, 16, table=changed("meadow", mu_0=0.4), tables=("deposits",))
    f = found(case)
    own = one(f, "all", "runout_m", "free run")
    assert own.p_adjusted < 0.05 and own.gap > 3.0 and own.phase == "stopping"
    assert {x.quantity for x in f if x.test == "reach"} == {"arrived"}
    assert locate(f)[0] == "stopping"


def test_effects_in_impacts_are_not_compared_with_a_law_without_them():
    soft = EffectSettings(SoftGround(classes=("talus",)))
    case = observed(20, 17, effects=soft, tables=("passages", "impacts"))
    f = found(case, effects=soft)
    steps = {x.quantity for x in f if x.phase == "impact" and x.test == "one step"}
    assert steps == {"turn_deg", "turn_deg_spread"}


def test_few_rocks_and_nothing():
    assert found(observed(LEAST_ROCKS - 1, 18)) == ()
    f = found(observed(8, 19, tables=()))
    assert f == () and locate(f) == ("", ())


def test_the_same_seed_gives_the_same_findings():
    case = observed(15, 20, tables=("passages", "deposits", "impacts"))
    assert found(case) == found(case)


@pytest.mark.battery
def test_nothing_is_found_where_nothing_is():
    """False findings among all of them in about one case of twenty."""
    false = 0
    for seed in range(40):
        f = where(observed(40, 3000 + seed), TABLE, seed=seed, draws=299)
        assert len(f) > 80
        false += f[0].p_adjusted < 0.05
    # More than this has a chance of 3 in 1000 at the level of 5 %.
    assert false <= 6
