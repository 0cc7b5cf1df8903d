"""Ranges of ground classes: which rule counts, and what a class becomes."""

from __future__ import annotations

import pytest
from scipy.stats import norm

from sassgis.settings.ground import (
    GroundClass,
    GroundTable,
    RangeRule,
    acting,
    ranges_of,
    with_values,
)
from sassgis.settings.settings import EngineSettings

TABLE = GroundTable(
    (
        GroundClass(
            "a", eta_max=0.9, dp_min=0.2, dp_max=0.6, mu_f=0.8, mu_0=0.5, k=0.2, d_star_m=0.0
        ),
        GroundClass(
            "b", eta_max=0.3, dp_min=0.1, dp_max=0.4, mu_f=0.8, mu_0=0.6, k=0.2, d_star_m=0.3
        ),
    )
)


@pytest.mark.parametrize(
    ("kind", "low", "high", "limits"),
    [
        ("value", 0.4, 0.7, (0.4, 0.7)),
        ("offset", -0.1, 0.2, (0.4, 0.7)),
        ("factor", 0.5, 2.0, (0.25, 1.0)),
        ("value", 0.6, 0.7, (0.5, 0.7)),  # The value itself always lies within.
    ],
)
def test_limits(kind, low: float, high: float, limits: tuple[float, float]) -> None:
    rule = RangeRule("a", "mu_0", kind, low, high)
    assert rule.limits(0.5) == pytest.approx(limits)


def test_the_rule_of_the_class_goes_before_that_of_all_and_the_later_before_the_earlier() -> None:
    rules = [
        RangeRule("a", "mu_0", "value", 0.1, 0.9, "own", sites=2),
        RangeRule("*", "mu_0", "factor", 0.5, 2.0, "all"),
        RangeRule("b", "mu_0", "value", 0.1, 0.9, "old"),
        RangeRule("b", "mu_0", "value", 0.3, 0.9, "new"),
    ]
    found = ranges_of(TABLE, ["a", "b"], rules)
    assert [(r.label, r.source, r.low, r.sites) for r in found] == [
        ("a: mu_0", "own", 0.1, 2),
        ("b: mu_0", "new", 0.3, 0),
    ]
    # Of a normal distribution nine tenths lie within 1.645 standard deviations of its middle.
    assert norm.cdf(0.4 / found[0].sd) - norm.cdf(-0.4 / found[0].sd) == pytest.approx(
        0.9, abs=1e-4
    )


def test_ranges_stay_within_what_a_class_can_take_and_without_width_they_go() -> None:
    rules = [
        RangeRule("*", "eta_max", "offset", -0.3, 0.3),
        RangeRule("*", "d_star_m", "factor", 0.5, 2.0),
    ]
    found = {r.label: (r.low, r.high) for r in ranges_of(TABLE, ["a", "b"], rules)}
    assert found == {
        "a: eta_max": pytest.approx((0.6, 1.0)),
        "b: eta_max": pytest.approx((0.0, 0.6)),
        "b: d_star_m": pytest.approx((0.15, 0.6)),
    }


def test_other_values_and_the_spread_of_the_slope_together() -> None:
    changed = with_values(TABLE, {("b", "dp_max"): 0.8, ("b", "mu_f"): 0.7})
    assert changed.classes[0] == TABLE.classes[0]
    b = changed.classes[1]
    assert (b.dp_min, b.dp_max, b.mu_f, b.mu_0) == pytest.approx((0.2, 0.8, 0.7, 0.6))
    assert with_values(TABLE, {}) == TABLE


def test_parameters_that_the_readings_do_not_use_are_not_varied() -> None:
    new = {"restitution", "restitution_speed_mps", "rolling_threshold"}
    assert new <= set(acting(EngineSettings()))
    assert not new & set(acting(EngineSettings(readings="1986")))
    assert "rolling_threshold" not in acting(EngineSettings(rolling_threshold=0.2))
