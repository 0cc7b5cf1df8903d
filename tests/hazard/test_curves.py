from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.hazard_samples import curves_of, drawn_counts
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sassgis.hazard.curves import (
    at_energies,
    energy_at,
    hazard_curves,
    meets,
    rate_interval,
    source_rate,
)
from sassgis.settings.hazard_rules import Source, SourceCounts
from sassgis.simulation.map_sums import Sample, reach_probability, weighted_counts

ENERGIES = np.array([0.0, 30.0, 300.0])


def counts_of(places: list[int], count: list[list[int]], square: object = None) -> SourceCounts:
    c = np.array(count, np.int64)
    return SourceCounts(np.array(places), c, c if square is None else np.array(square, np.int64))


def test_rate_and_variance_worked_by_hand() -> None:
    # 0.5 blocks a year, 5 lines of 4 rocks. Cell 7: lines with 3, 2, 1, 0, 0 rocks.
    source = Source("A", "m", 0.5, 20, 4)
    counts = counts_of([7], [[6, 2, 0]], [[14, 2, 0]])
    curves = hazard_curves([source], [counts], ENERGIES)
    np.testing.assert_allclose(curves.rate, [[0.15, 0.05, 0.0]])
    # Σ k (n − k)/(n − 1) = (3·1 + 2·2 + 1·3)/3 = 10/3, two lines of one rock: 2·3/3 = 2.
    np.testing.assert_allclose(curves.variance, [[0.025**2 * 10 / 3, 0.025**2 * 2, 0.0]])
    assert curves.rate_of_a_rock == pytest.approx([0.025])
    # Random points: L/(L − 1) · (Σ k² − K²/L) = 5/4 · (14 − 36/5) = 8.5; 5/4 · (2 − 4/5) = 1.5.
    drawn = hazard_curves([replace(source, random_points=True)], [counts], ENERGIES)
    np.testing.assert_allclose(drawn.variance, [[0.025**2 * 8.5, 0.025**2 * 1.5, 0.0]])


@pytest.mark.parametrize(
    ("rocks", "per_line", "random_points"), [(5, 1, False), (5, 5, True)], ids=["n = 1", "L = 1"]
)
def test_a_sample_that_cannot_tell_its_error_says_so(
    rocks: int, per_line: int, random_points: bool
) -> None:
    source = Source("A", "m", 1.0, rocks, per_line, random_points)
    curves = hazard_curves([source], [counts_of([0], [[2, 1, 0]])], ENERGIES)
    assert np.isnan(curves.variance).tolist() == [[True, True, False]]
    lower, upper = rate_interval(curves)
    assert np.isnan(lower).tolist() == np.isnan(upper).tolist() == [[True, True, False]]
    assert np.all(np.isfinite(curves.rate))


def random_area(seed: int, area: str) -> tuple[list[Source], list[SourceCounts]]:
    rng = np.random.default_rng(seed)
    sources, counts = [], []
    for scenario in ("small", "large"):
        source = Source(area, scenario, float(rng.uniform(0.001, 3.0)), 7 * 11, 7)
        places = np.sort(rng.choice(60, 40, replace=False))
        chance = np.sort(rng.uniform(0.0, 1.0, (40, 11, 3)))[:, :, ::-1]
        sources.append(source)
        counts.append(drawn_counts(rng, source, chance, places))
    return sources, counts


@pytest.mark.parametrize("seed", range(5))
def test_two_areas_together_are_bit_for_bit_the_sum_of_each(seed: int) -> None:
    north, south = random_area(2 * seed, "north"), random_area(2 * seed + 1, "south")
    # The scenarios of the areas come mixed: what counts is the area.
    order = [0, 2, 1, 3]
    sources = [(north[0] + south[0])[i] for i in order]
    counts = [(north[1] + south[1])[i] for i in order]
    both = hazard_curves(sources, counts, ENERGIES)
    summed = {name: np.zeros((60, 3)) for name in ("rate", "variance")}
    for alone in (hazard_curves(*north, ENERGIES), hazard_curves(*south, ENERGIES)):
        for name, total in summed.items():
            total[alone.places] += getattr(alone, name)
    assert np.array_equal(both.rate, summed["rate"][both.places])
    assert np.array_equal(both.variance, summed["variance"][both.places])
    everywhere = np.concatenate([c.places for c in counts])
    assert np.array_equal(both.places, np.unique(everywhere))


def test_one_rock_stands_for_the_areas_that_come_to_the_place() -> None:
    rare, often = Source("A", "l", 0.01, 100, 10), Source("A", "s", 4.0, 100, 10)
    other = Source("B", "s", 0.5, 100, 10)
    curves = hazard_curves(
        [rare, often, other],
        [
            counts_of([1, 2], [[1, 0, 0], [3, 0, 0]]),
            counts_of([2, 3], [[1, 0, 0], [0, 0, 0]]),
            counts_of([3, 4, 2], [[0, 0, 0], [2, 0, 0], [1, 0, 0]]),
        ],
        ENERGIES,
    )
    assert curves.places.tolist() == [1, 2, 3, 4]
    # At place 1 the frequent scenario of A might come as well; B is not known to come there.
    np.testing.assert_allclose(curves.rate_of_a_rock, [0.04, 0.04, 0.0, 0.005])


def test_a_rock_that_counts_several_times_is_one_rock() -> None:
    """Half of the points have an eighth of the blocks, which count 8 times: limits hold."""
    source = Source("A", "m", 1.0, 2 * 1024, 8, heaviest=8)
    rng, chance, samples, missed = np.random.default_rng(3), 0.003, 500, 0
    for _ in range(samples):
        light, heavy = rng.binomial(8, chance, 128), rng.binomial(8, chance, 16)
        count, square = weighted_counts(heavy.sum(), (heavy**2).sum(), 8, 8)
        own = counts_of([0], [[light.sum() + count]], [[(light**2).sum() + square]])
        curves = hazard_curves([source], [own], [0.0])
        # Where no block came there is no place with limits.
        missed += curves.rate[0, 0] > 0.0 and rate_interval(curves)[1][0, 0] < chance
    assert missed / samples < 0.025 + 0.02


def test_no_source_no_curve() -> None:
    for curves in (
        hazard_curves([], [], ENERGIES),
        hazard_curves([Source("A", "m", 1.0, 10, 5)], [SourceCounts.none(3)], ENERGIES),
    ):
        assert curves.places.size == 0
        assert curves.rate.shape == curves.variance.shape == (0, 3)
        assert energy_at(curves, 100.0).shape == (0,)
        assert rate_interval(curves)[1].shape == (0, 3)


def test_curves_refuse_energies_that_do_not_fit() -> None:
    source, counts = Source("A", "m", 1.0, 10, 5), SourceCounts.none(3)
    for energies in ([1.0, 2.0, 3.0], [0.0, 2.0, 2.0], [0.0, 1.0]):
        with pytest.raises(ValueError, match=r"energ"):
            hazard_curves([source], [counts], energies)
    with pytest.raises(ValueError, match=r"none of the energies"):
        at_energies(curves_of([[1, 1, 1]]), (0.0, 40.0))


# ---------------------------------------------------------------------------------------------
# Return periods


@given(st.integers(1, 1000), st.sampled_from([7.0, 10.0, 30.0, 100.0, 300.0]))
def test_rounding_does_not_decide_whether_a_return_period_is_met(rocks: int, years: float) -> None:
    # Every rock comes and the source releases once in T: once in T it is, by definition.
    source = Source("A", "m", 1.0 / years, rocks, 1)
    rate = source_rate(source, counts_of([0], [[rocks]]))
    assert meets(rate, years).all()
    assert meets(sum(rate * 0.1 for _ in range(10)), years).all()
    assert not meets(rate * (1.0 - 1e-9), years).any()


def test_energy_at_a_return_period_by_hand() -> None:
    curves = curves_of([[1.0, 0.1, 0.001]], energies=(0, 10, 1000))
    # A power law from (10 kJ, 0.1) to (1000 kJ, 0.001): e = 1/λ.
    np.testing.assert_allclose(energy_at(curves, 10.0), 10.0)
    np.testing.assert_allclose(energy_at(curves, 50.0), 50.0)
    np.testing.assert_allclose(energy_at(curves, 300.0), 300.0)
    # The first bracket: e is linear, log λ goes from 0 to −1.
    np.testing.assert_allclose(energy_at(curves, np.sqrt(10.0)), 5.0)
    # More often than rocks come; beyond the end of the curve.
    assert np.isnan(energy_at(curves, 0.5))
    np.testing.assert_allclose(energy_at(curves, 1e5), 1000.0)
    # Up to where no rock comes λ falls evenly: half is left at half the logarithm of the way.
    curves = curves_of([[1.0, 0.1, 0.0]], energies=(0, 10, 1000))
    np.testing.assert_allclose(energy_at(curves, 20.0), 100.0)


rising = st.lists(st.floats(0.1, 1e4), min_size=2, max_size=6, unique=True).map(sorted)


@given(rising, st.data())
def test_energy_grows_with_the_return_period_and_agrees_with_the_curve(
    energies: list[float], data: st.DataObject
) -> None:
    energies = [0.0, *energies]
    rates = data.draw(
        st.lists(
            st.one_of(st.just(0.0), st.floats(1e-5, 10.0)),
            min_size=len(energies),
            max_size=len(energies),
        ).map(lambda r: sorted(r, reverse=True))
    )
    curves = curves_of([rates], energies=energies)
    periods = [0.05, 1.0, 30.0, 100.0, 300.0, 1e6]
    at = [float(energy_at(curves, t)[0]) for t in periods]
    came = [e for e in at if not np.isnan(e)]
    assert all(b >= a * (1 - 1e-12) for a, b in pairwise(came))
    for t, e in zip(periods, at, strict=True):
        met = [x for x, r in zip(energies, rates, strict=True) if meets(r, t)]
        if not met:
            assert np.isnan(e)
        else:
            beyond = [x for x in energies if x > met[-1]]
            assert met[-1] * (1 - 1e-12) <= e <= (beyond or met)[0] * (1 + 1e-9) or not beyond


# ---------------------------------------------------------------------------------------------
# Intervals


@pytest.mark.parametrize("count", [0, 1, 3, 20])
def test_interval_of_counts_with_one_weight_is_the_poisson_interval(count: int) -> None:
    # With one rock in a line at most, and many rocks a line, the variance is the count.
    w = 0.02
    lower, upper = rate_interval(curves_of([[w * count]], w * w * count, w, (0.0,)))
    exact = stats.chi2.ppf([0.025, 0.975], [2 * max(count, 1), 2 * count + 2]) / 2
    assert upper[0, 0] == pytest.approx(w * exact[1])
    assert lower[0, 0] == pytest.approx(w * exact[0] if count else 0.0)


def test_interval_without_variance() -> None:
    lower, upper = rate_interval(curves_of([[0.2]], 0.0, 0.01, (0.0,)))
    assert lower[0, 0] == 0.2
    assert 0.2 < upper[0, 0] < 0.3
    lower, upper = rate_interval(curves_of([[0.0]], 0.0, 0.0, (0.0,)))
    assert lower[0, 0] == upper[0, 0] == 0.0
    with pytest.raises(ValueError, match="confidence"):
        rate_interval(curves_of([[1.0, 1.0, 1.0]]), 1.0)


@given(
    st.floats(1e-6, 10.0),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.floats(0.01, 0.99),
    st.floats(1.0, 1e4),
)
def test_interval_holds_the_rate_and_narrows_with_more_rocks(
    rate: float, spread: float, of_a_rock: float, confidence: float, factor: float
) -> None:
    v, w = spread * rate**2, of_a_rock * rate
    curves = curves_of([[rate, rate]], [[v, v / factor]], 0.0, (0, 1))
    lower, upper = rate_interval(replace(curves, rate_of_a_rock=np.array([w])), confidence)
    assert np.all((lower <= rate) & (rate <= upper))
    more = curves_of([[rate, rate]], v / factor, w / factor, (0, 1))
    if confidence >= 0.5:
        l_more, u_more = rate_interval(more, confidence)
        assert l_more[0, 0] >= lower[0, 0] * (1 - 1e-9)
        assert u_more[0, 0] <= upper[0, 0] * (1 + 1e-9)


SEVERAL = [
    Source("A", "small", 0.8, 60 * 10, 10),
    Source("A", "large", 0.05, 60 * 10, 10),
    Source("B", "large", 0.2, 25 * 20, 20),
]


def several_chances(rng: np.random.Generator, scale: float) -> list[np.ndarray]:
    """Lines that differ: some come often, most hardly ever. Places x lines x energies."""
    factors = np.array([0.1, 0.3, 1.0])[:, None, None] * np.array([1.0, 0.3])
    return [
        scale * factors * rng.beta(0.5, 1.5, (1, s.rocks // s.rocks_per_line, 1)) for s in SEVERAL
    ]


@pytest.mark.parametrize("scale", [0.2, 0.8], ids=["rare", "frequent"])
def test_standard_errors_tell_the_spread_of_samples_and_intervals_hold_the_rate(
    scale: float,
) -> None:
    rng = np.random.default_rng(11)
    chances = several_chances(rng, scale)
    true = sum(s.frequency * c.mean(axis=1) for s, c in zip(SEVERAL, chances, strict=True))
    energies = np.array([0.0, 30.0])
    rates, variances, held, missed_low, missed_high = [], [], [], [], []
    samples = 800
    for _ in range(samples):
        counts = [drawn_counts(rng, s, c) for s, c in zip(SEVERAL, chances, strict=True)]
        curves = hazard_curves(SEVERAL, counts, energies)
        lower, upper = rate_interval(curves)
        rates.append(curves.rate)
        variances.append(curves.variance)
        held.append((lower <= true) & (true <= upper))
        missed_low.append(upper < true)
        missed_high.append(lower > true)
    # Unbiased rates and variances, within four of their own errors over the samples.
    spread = np.var(rates, axis=0, ddof=1)
    np.testing.assert_array_less(
        np.abs(np.mean(rates, axis=0) - true), 4.0 * np.sqrt(spread / samples) + 1e-15
    )
    np.testing.assert_allclose(np.mean(variances, axis=0), spread, rtol=0.25)
    # At least 95 %, less what 800 samples may be off by chance (four times 0.8 %).
    assert np.mean(held, axis=0).min() > 0.95 - 0.031
    # A rate is never taken for too low more often than is said.
    assert np.mean(missed_low, axis=0).max() < 0.025 + 0.022
    assert np.mean(missed_high, axis=0).max() < 0.025 + 0.022


def test_blocks_that_never_start_are_in_no_denominator():
    # 20 simulated, 5 never started, 6 arrive: 6/15 of the onset frequency; the same of the map.
    source = Source("A", "m", 3.0, 20, 4, never_started=5)
    counts = SourceCounts(np.array([7]), np.array([[6]]), np.array([[12]]))
    assert source_rate(source, counts)[0, 0] == pytest.approx(3.0 * 6 / 15)
    p, _ = reach_probability(np.array([6]), np.array([12]), Sample(15, 4, 5, False))
    assert p[0] == pytest.approx(6 / 15)
    assert Source("A", "m", 3.0, 20, 4, never_started=20).rate_per_rock == 0.0
