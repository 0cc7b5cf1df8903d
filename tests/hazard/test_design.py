"""Design values of barriers: what is exceeded once in so many years, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sassgis.hazard.design import Arrivals, rocks_beyond, value_at_rate, value_limits

#: Ten, four and one rocks a year at 0, 10 and 20 m or more; none above 23 m. Each simulated one is
#: a tenth of a rock a year.
CURVE = Arrivals(
    np.array([0.0, 10.0, 20.0, 30.0]),
    np.array([10.0, 4.0, 1.0, 0.0]),
    np.array([1.0, 0.4, 0.1, 0.0]),
    np.array([100, 40, 10, 0]),
    23.0,
    0.1,
)


def test_values_lie_between_the_edges_as_if_rocks_were_spread_evenly() -> None:
    # From 4 to 1 a year over 10 m: 2.5 a year are exceeded half way.
    assert value_at_rate(CURVE, 2.5) == 15.0
    assert value_at_rate(CURVE, 7.0) == 5.0
    assert rocks_beyond(CURVE, 2.5) == 10


def test_no_value_lies_above_the_largest_that_was_seen() -> None:
    assert value_at_rate(CURVE, 0.1) == 23.0


def test_where_rocks_come_less_often_there_is_no_design_value() -> None:
    assert math.isnan(value_at_rate(CURVE, 10.0))
    assert math.isnan(value_at_rate(CURVE, 12.0))


def test_where_no_rock_comes_there_is_none_either() -> None:
    none = np.zeros(4)
    nothing = Arrivals(CURVE.edges, none, none, none.astype(int), math.nan, 0.0)
    assert math.isnan(value_at_rate(nothing, 0.01))
    assert all(math.isnan(v) for v in value_limits(nothing, 0.01, 0.95))


def test_limits_hold_the_value_of_all_blocks() -> None:
    """Energies of an exponential law: limits of 90 % hold the truth in some 90 % of samples."""
    rng, edges, rate, years = np.random.default_rng(4), np.arange(0.0, 200.5, 0.5), 0.5, 100.0
    truth = 10.0 * math.log(rate * years)
    blocks, inside = 400, 0
    for _ in range(300):
        came = rng.poisson(blocks)
        counts, _ = np.histogram(rng.exponential(10.0, came), edges)
        above = np.append(np.cumsum(counts[::-1])[::-1], 0)
        w = rate / blocks
        curve = Arrivals(edges, w * above, w * w * above, above, 1e3, w)
        low, high = value_limits(curve, 1.0 / years, 0.9)
        assert low <= value_at_rate(curve, 1.0 / years) <= high
        inside += low <= truth <= high
    assert 0.87 <= inside / 300 <= 0.97


def test_limits_end_where_the_sample_does() -> None:
    low, high = value_limits(CURVE, 2.5, 0.95)
    assert 10.0 < low < 15.0 < high < 20.0
    # Less than four blocks beyond a value do not say where it ends.
    assert math.isnan(value_limits(CURVE, 0.3, 0.95)[1])
    # Blocks may come less often than ten times a year.
    assert value_limits(CURVE, 9.9, 0.95)[0] == 0.0
    # Weights of two blocks each, half as many: wider.
    coarse = replace(CURVE, variance=2.0 * CURVE.variance, of_a_rock=0.2)
    assert value_limits(coarse, 2.5, 0.95)[0] < low and value_limits(coarse, 2.5, 0.95)[1] > high
