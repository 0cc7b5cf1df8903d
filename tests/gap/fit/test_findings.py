"""What speaks against calibrated values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from sassgis.gap.fit.distances import Interval
from sassgis.gap.fit.fit_errors import findings_of, paired_gain
from sassgis.gap.fit.parameters import RANGES, ClassParameter, Fitted
from sassgis.report.figures.gap_figures import quantity_curves_figure


def fitted(name: str, parameter: str, before: float, after: float, limit: str = "") -> Fitted:
    one = ClassParameter(name, parameter, RANGES[parameter], before, 0.1)
    return Fitted(one, one.limits.share(after), after, after, after, True, 0.5, limit)


def kinds(*values: Fitted) -> list[str]:
    return [f.kind for f in findings_of(values, {})]


@pytest.mark.parametrize(
    ("parameter", "rock", "meadow", "wrong"),
    [
        ("restitution", 0.2, 0.3, True),
        ("restitution", 0.3, 0.2, False),
        ("mu_0", 0.5, 0.4, True),
        ("mu_0", 0.4, 0.5, False),
        # Nothing is stated of how η_max goes with hardness.
        ("eta_max", 0.5, 0.6, False),
    ],
)
def test_harder_ground_rebounds_no_less_and_rolls_no_worse(
    parameter: str, rock: float, meadow: float, wrong: bool
) -> None:
    values = [
        fitted("rock", parameter, rock, rock),
        fitted("soft_meadow", parameter, meadow, meadow),
    ]
    assert kinds(*values) == kinds(*values[::-1]) == ["order"] * wrong
    # A class of the user's own has no place in the order.
    assert not kinds(values[0], fitted("sand", parameter, meadow, meadow))


def test_values_at_a_limit_and_far_from_the_configured_one() -> None:
    assert kinds(fitted("rock", "mu_f", 0.7, 0.72)) == []
    # A share of 0.1 of the range, 1 m, is one standard deviation.
    assert kinds(fitted("rock", "mu_f", 0.7, 0.89)) == []
    assert kinds(fitted("rock", "mu_f", 0.7, 0.91)) == ["far"]
    assert kinds(fitted("rock", "mu_f", 0.7, 0.2, "low")) == ["limit", "far"]


def test_a_gain_clears_zero_or_is_a_finding() -> None:
    gains = {"a": Interval(0.1, 0.01, 0.2), "b": Interval(0.1, -0.01, 0.2)}
    gains["c"] = Interval(math.nan, math.nan, math.nan)
    assert [f.text[0] for f in findings_of((), gains)] == ["b", "c"]


def test_the_gain_is_paired_by_rock() -> None:
    rng = np.random.default_rng(2)
    before = rng.uniform(1.0, 3.0, 30)
    after = before - rng.normal(0.1, 0.05, 30)
    ours = paired_gain(np.r_[before, 0.0], np.r_[after, 0.0])
    own = stats.ttest_rel(before, after).confidence_interval(0.95)
    want = np.array([(before - after).mean(), own.low, own.high]) / before.mean()
    assert (ours.value, ours.low, ours.high) == pytest.approx(want)


def test_rocks_that_are_all_alike_are_drawn() -> None:
    """One block each, say: the axis needs some width, and a warning of matplotlib is an error."""
    made = {name: np.ones((4, 6)) for name in ("before", "left out", "after")}
    low, high = quantity_curves_figure([("stopped blocks", np.ones(6), made)]).axes[0].get_xlim()
    assert low < 1.0 < high
