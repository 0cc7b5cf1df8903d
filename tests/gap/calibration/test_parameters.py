"""Parameters of ground classes, their ranges and priors."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.simulated_slope import TABLE

from sassgis.gap.calibration.parameters import (
    RANGES,
    fitted_names,
    log_prior,
    parameters_of,
    prior_of_one,
    table_with,
)
from sassgis.model.errors import InputError
from sassgis.model.settings import EngineSettings


def test_shares_are_places_in_the_range() -> None:
    one, other = parameters_of(TABLE, ["debris"], ["mu_0", "rolling_threshold"])
    assert one.value(0.0) == pytest.approx(RANGES["mu_0"].low)
    assert one.value(one.start) == pytest.approx(0.45)
    # Half of a logarithmic range is its geometric mean.
    assert other.value(0.5) == pytest.approx(np.sqrt(0.02 * 2.0))
    assert other.value(other.start) == pytest.approx(0.1)


def test_a_table_changes_only_what_is_calibrated() -> None:
    parameters = parameters_of(TABLE, ["debris"], ["eta_max", "mu_f"])
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


def test_the_prior_stays_within_the_range() -> None:
    low, high, sd = prior_of_one(0.0)
    assert 0.0 <= low < high <= 1.0
    # Half of a normal distribution of sd 0.5, cut at two sd.
    rng = np.random.default_rng(1)
    drawn = np.abs(rng.normal(0.0, 0.5, 200_000))
    drawn = drawn[drawn <= 1.0]
    assert (low, high) == pytest.approx(tuple(np.quantile(drawn, [0.025, 0.975])), abs=0.01)
    assert sd == pytest.approx(drawn.std(), abs=0.01)
    assert log_prior(np.zeros(1), np.array([[-0.1]]))[0] == -np.inf
