"""Design values of barriers: what is exceeded once in so many years, by hand."""

from __future__ import annotations

import math

import numpy as np

from sassgis.hazard.design import Arrivals, quantile, rocks_beyond, value_at_rate

#: Ten, four and one rocks a year at 0, 10 and 20 m or more; none above 23 m.
CURVE = Arrivals(
    np.array([0.0, 10.0, 20.0, 30.0]),
    np.array([10.0, 4.0, 1.0, 0.0]),
    np.array([100, 40, 10, 0]),
    23.0,
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
    nothing = Arrivals(CURVE.edges, np.zeros(4), np.zeros(4, np.int64), math.nan)
    assert math.isnan(value_at_rate(nothing, 0.01)) and math.isnan(quantile(nothing, 0.95))


def test_quantiles_are_those_of_the_rocks_that_arrive() -> None:
    # 5 % of 10 a year: 0.5 a year, half way between 20 and 30 m, but for the largest.
    assert quantile(CURVE, 0.95) == 23.0
    assert quantile(CURVE, 0.3) == 5.0
