"""Parameters of ground classes, their ranges and priors."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.simulated_slope import TABLE

from sassgis.errors import InputError
from sassgis.gap.causes.cause import Range
from sassgis.gap.fit.parameters import (
    RANGES,
    ClassParameter,
    fitted_names,
    parameters_of,
    prior_shares,
    table_with,
)
from sassgis.settings.ground import EVERY_CLASS, RangeRule
from sassgis.settings.settings import EngineSettings


def test_shares_are_places_in_the_range() -> None:
    one, other = parameters_of(TABLE, ["debris"], ["mu_0", "rolling_threshold"], ())
    assert one.value(0.0) == pytest.approx(RANGES["mu_0"].low)
    assert one.value(one.start) == pytest.approx(0.45)
    # Half of a logarithmic range is its geometric mean.
    assert other.value(0.5) == pytest.approx(np.sqrt(0.02 * 2.0))
    assert other.value(other.start) == pytest.approx(0.1)


def test_a_table_changes_only_what_is_calibrated() -> None:
    parameters = parameters_of(TABLE, ["debris"], ["eta_max", "mu_f"], ())
    made = table_with(TABLE, parameters, np.array([1.0, 0.0]))
    changed = made.classes[made.index("debris")]
    assert (changed.eta_max, changed.mu_f) == (1.0, 0.2)
    assert changed.mu_0 == 0.45
    assert [c for c in made.classes if c.name != "debris"] == [
        c for c in TABLE.classes if c.name != "debris"
    ]


def test_what_the_engine_does_not_read_is_not_calibrated() -> None:
    assert set(fitted_names(None, [EngineSettings()])) == set(RANGES)
    paper = EngineSettings(readings="1986")
    assert set(fitted_names(None, [paper])) == {"eta_max", "mu_f", "mu_0"}
    with pytest.raises(InputError, match="restitution"):
        fitted_names(["restitution"], [paper])


def test_the_prior_is_as_wide_as_values_vary_between_sites() -> None:
    """The middle 90 % of a normal distribution is 3.29 standard deviations wide."""
    rules = (
        RangeRule(EVERY_CLASS, "mu_0", "factor", 0.8, 1.2),
        RangeRule(EVERY_CLASS, "rolling_threshold", "factor", 0.5, 2.0),
        RangeRule("debris", "mu_0", "value", 0.30, 0.62),
    )
    names = ["mu_0", "rolling_threshold", "eta_max"]
    friction, threshold, eta = parameters_of(TABLE, ["debris"], names, rules)
    assert friction.sd * (0.9 - 0.02) == pytest.approx(0.32 / 3.29)
    assert friction.spread == pytest.approx(0.32 / 3.29)
    # On a logarithmic scale half as much and twice as much are as likely.
    assert threshold.sd * np.log(2.0 / 0.02) == pytest.approx(np.log(4.0) / 3.29)
    # Of the third no spread is known.
    assert eta.sd == 0.5
    ends = 1.645 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    middle = prior_shares([friction, threshold], ends)
    assert friction.value(middle[:, 0]) == pytest.approx(0.45 + np.array([-0.16, 0.16]), abs=1e-3)
    assert threshold.value(middle[:, 1]) == pytest.approx([0.05, 0.2], rel=0.01)


def test_the_prior_stays_within_the_range() -> None:
    """Standard normal parameters are shares about the configured value, or the limit."""
    limits = Range(0.0, 1.0)
    parameters = [
        ClassParameter("debris", "eta_max", limits, configured, sd)
        for configured, sd in ((0.0, 0.5), (0.9, 0.1))
    ]
    at = np.array([[-3.0, -1.0], [0.0, 0.0], [1.0, 0.5], [40.0, 2.0]])
    expected = [[0.0, 0.8], [0.0, 0.9], [0.5, 0.95], [1.0, 1.0]]
    np.testing.assert_allclose(prior_shares(parameters, at), expected)
