from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.hazard_samples import BLUE, RED, RESIDUAL, YELLOW, curves_of, swiss
from hypothesis import given, settings
from hypothesis import strategies as st

from sassgis.hazard.curves import meets
from sassgis.hazard.levels import (
    deciding_energy,
    hazard_level,
    intensity_class,
    level_interval,
    rocks_factor,
    uncertain,
)
from sassgis.model.hazard import HazardCurves

PRESET = swiss()


@pytest.mark.parametrize(
    ("rates", "level", "column"),
    [
        # Once in 50 years a rock, always weak: low intensity, 30 to 100 years.
        ((1 / 50, 0, 0), BLUE, 0),
        ((1 / 200, 0, 0), YELLOW, 0),
        ((1 / 301, 0, 0), RESIDUAL, 0),
        # Limits belong to the class below them.
        ((1 / 300, 0, 0), YELLOW, 0),
        ((1 / 100, 0, 0), BLUE, 0),
        ((1 / 100, 1 / 300, 0), BLUE, 0),
        ((1 / 30, 1 / 30, 0), RED, 1),
        ((1 / 30, 1 / 31, 0), BLUE, 0),
        # Mean intensity once in 250 years beats low intensity once in 120.
        ((1 / 120, 1 / 250, 1 / 1000), BLUE, 1),
        ((1 / 20, 1 / 40, 1 / 299), RED, 2),
        ((10.0, 1.0, 1.0), RED, 1),
        ((10.0, 0.02, 1 / 301), BLUE, 0),
        ((1e-9, 1e-9, 1e-9), RESIDUAL, 0),
    ],
)
def test_level_by_hand(rates: tuple[float, ...], level: int, column: int) -> None:
    curves = curves_of([rates])
    assert hazard_level(curves, PRESET).tolist() == [level + 1]
    assert deciding_energy(curves, PRESET).tolist() == [column]


def test_places_without_rocks() -> None:
    curves = curves_of([[0.0, 0.0, 0.0]], 0.0, 0.0)
    assert hazard_level(curves, PRESET).tolist() == [0]
    assert intensity_class(curves, PRESET, None).tolist() == [0]
    assert deciding_energy(curves, PRESET).tolist() == [-1]
    assert [x.tolist() for x in level_interval(curves, PRESET)] == [[0], [0]]
    assert rocks_factor(curves, PRESET).tolist() == [1.0]
    nothing = curves_of(np.zeros((0, 3)))
    assert hazard_level(nothing, PRESET).shape == (0,)
    assert rocks_factor(nothing, PRESET).shape == (0,)


def test_intensity_by_hand() -> None:
    curves = curves_of([[1 / 20, 1 / 100, 1 / 1000], [1 / 31, 0, 0], [1 / 30, 1 / 30, 1 / 30]])
    assert intensity_class(curves, PRESET, 30.0).tolist() == [1, 0, 3]
    assert intensity_class(curves, PRESET, 100.0).tolist() == [2, 1, 3]
    assert intensity_class(curves, PRESET, 300.0).tolist() == [2, 1, 3]
    assert intensity_class(curves, PRESET, None).tolist() == [3, 1, 3]


rate = st.one_of(
    st.just(0.0), st.floats(1e-6, 1.0), st.sampled_from([1 / 30, 1 / 100, 1 / 300, 0.1])
)
falling = st.lists(rate, min_size=3, max_size=3).map(lambda r: sorted(r, reverse=True))


@given(falling, falling)
def test_level_does_not_fall_as_rates_rise(a: list[float], b: list[float]) -> None:
    high = np.maximum(a, b)
    levels = hazard_level(curves_of([a, high]), PRESET)
    assert levels[0] <= levels[1]


@given(falling, st.floats(1.0, 1e4), st.floats(1.0, 100.0))
def test_rarer_events_are_at_least_as_intense(r: list[float], years: float, by: float) -> None:
    curves = curves_of([r])
    often = intensity_class(curves, PRESET, years)
    rare = intensity_class(curves, PRESET, years * by)
    assert often[0] <= rare[0] <= intensity_class(curves, PRESET, None)[0]


fine = st.lists(rate, min_size=40, max_size=40).map(lambda r: sorted(r, reverse=True))


@given(fine)
def test_level_is_the_worst_that_a_fine_curve_crosses(r: list[float]) -> None:
    """Every point (e, λ(E >= e)) of the curve looked up in the matrix, one by one."""
    energies = np.unique([0.0, 30.0, 300.0, *np.geomspace(1.0, 2000.0, 37)])
    curves = curves_of([r[: energies.size]], energies=energies)
    worst = 0
    for energy, at in zip(energies, curves.rate[0], strict=True):
        if at == 0.0:
            continue
        i = 2 if energy >= 300.0 else 1 if energy >= 30.0 else 0
        j = next((j for j, t in enumerate((30.0, 100.0, 300.0)) if meets(at, t)), 3)
        worst = max(worst, PRESET.matrix[i][j] + 1)
    assert hazard_level(curves, PRESET).tolist() == [worst]


# ---------------------------------------------------------------------------------------------
# How sure it is


def counted(count: list[list[int]], w: float) -> HazardCurves:
    """Curves of rare rocks of one source, each of which stands for w."""
    k = np.array(count, np.float64)
    return curves_of(k * w, k * w * w, w)


def test_many_rocks_decide_few_do_not() -> None:
    # Low intensity 40 times in 1000 years: T = 25 years, 95 % interval 18 to 35 years, both blue.
    # Four times: the interval of the rate, 1.09 to 10.24, holds T = 98 to 918 years.
    w = 1 / 1000
    curves = counted([[40, 0, 0], [4, 0, 0]], w)
    lowest, highest = level_interval(curves, PRESET)
    # With no rock of 30 kJ, up to 3.69 in 1000 years might have it: T = 271 years: blue.
    assert lowest.tolist() == [BLUE + 1, RESIDUAL + 1]
    assert highest.tolist() == [RED + 1, RED + 1]  # 300 kJ within 300 years would be red
    assert uncertain(curves, PRESET).tolist() == [True, True]
    # With ten times the rocks at the same rate, 3.69 in 10000 years is beyond 300 years; 40 rocks
    # have the interval 28.6 to 54.5: T = 184 to 350 years, slight or residual.
    more = counted([[400, 0, 0], [40, 0, 0]], w / 10)
    assert [x.tolist() for x in level_interval(more, PRESET)] == [
        [BLUE + 1, RESIDUAL + 1],
        [BLUE + 1, YELLOW + 1],
    ]
    assert uncertain(more, PRESET).tolist() == [False, True]


def test_reached_is_at_least_residual_and_that_is_not_a_doubt() -> None:
    curves = counted([[1, 0, 0]], 1e-6)
    lowest, highest = level_interval(curves, PRESET)
    assert lowest.tolist() == highest.tolist() == [RESIDUAL + 1]
    assert rocks_factor(curves, PRESET).tolist() == [1.0]


def test_an_unknown_variance_leaves_everything_open() -> None:
    curves = curves_of([[0.02, 0.0, 0.0]], [[np.nan, 0.0, 0.0]], 1e-9)
    lowest, highest = level_interval(curves, PRESET)
    assert (lowest[0], highest[0]) == (RESIDUAL + 1, BLUE + 1)
    assert np.isnan(rocks_factor(curves, PRESET)[0])
    # Unless the matrix says the same of any rate.
    red = curves_of([[1.0, 1.0, 1.0]], [[np.nan, 0.0, 0.0]], 1e-9)
    assert not uncertain(red, PRESET)[0]


@given(
    st.lists(st.integers(0, 400), min_size=3, max_size=3).map(lambda c: sorted(c, reverse=True)),
    st.sampled_from([1e-2, 1e-3, 1e-4, 1e-5]),
    st.floats(0.5, 0.99),
)
def test_level_lies_in_its_interval(count: list[int], w: float, confidence: float) -> None:
    curves = counted([count], w)
    lowest, highest = level_interval(curves, PRESET, confidence)
    level = hazard_level(curves, PRESET)
    assert lowest[0] <= level[0] <= highest[0]
    wider = level_interval(curves, PRESET, 0.5 + 0.5 * confidence)
    assert wider[0][0] <= lowest[0] <= highest[0] <= wider[1][0]


@settings(max_examples=40)
@given(
    st.lists(st.integers(0, 200), min_size=3, max_size=3).map(lambda c: sorted(c, reverse=True)),
    st.sampled_from([1e-2, 1e-3, 1e-4]),
)
def test_the_factor_of_rocks_is_the_least_that_decides(count: list[int], w: float) -> None:
    curves = counted([count], w)
    factor = float(rocks_factor(curves, PRESET)[0])

    def with_rocks(times: float) -> bool:
        more = replace(
            curves, variance=curves.variance / times, rate_of_a_rock=curves.rate_of_a_rock / times
        )
        return not uncertain(more, PRESET)[0]

    if not uncertain(curves, PRESET)[0]:
        assert factor == 1.0
    elif np.isinf(factor):
        assert not with_rocks(1e5)
    else:
        assert with_rocks(factor)
        assert not with_rocks(max(1.0, factor / 1.02))


def test_no_sample_decides_a_rate_on_a_limit() -> None:
    k = 10
    curves = counted([[k, 0, 0]], 1 / (300.0 * k))
    assert hazard_level(curves, PRESET).tolist() == [YELLOW + 1]
    assert rocks_factor(curves, PRESET).tolist() == [np.inf]


def test_the_factor_by_hand() -> None:
    # No rock of 30 kJ among those of one source: the upper limit −ln(0.025) w falls as 1/rocks and
    # has to come below 1/300. 3.6889 / 1000 · 300 = 1.1067.
    curves = counted([[20_000, 0, 0]], 1 / 1000)
    factor = rocks_factor(curves, PRESET)[0]
    assert 1.1067 <= factor <= 1.1067 * 1.014
