"""Power laws of block volumes: closed forms, known exponents, coverage of the intervals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, poisson

from sassgis.errors import InputError
from sassgis.hazard.volume_frequency import BlockSurvey, fit_power_law, fit_test, higher_thresholds

V0, B = 0.05, 0.8
EDGES = np.array([V0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, math.inf])


def listed(volumes: np.ndarray) -> BlockSurvey:
    return BlockSurvey(volumes, volumes, np.ones(volumes.size))


def counted(volumes: np.ndarray) -> BlockSurvey:
    return BlockSurvey(EDGES[:-1], EDGES[1:], np.histogram(volumes, EDGES)[0].astype(float))


def drawn(n: int, seed: int, up_to: float = math.inf) -> np.ndarray:
    """Volumes of the law, by its distribution turned round."""
    u = np.random.default_rng(seed).random(n)
    top = 0.0 if math.isinf(up_to) else (up_to / V0) ** -B
    return V0 * (1.0 - u * (1.0 - top)) ** (-1.0 / B)


def test_exponent_of_a_list_is_that_of_the_closed_form() -> None:
    v = drawn(200, 1)
    found = fit_power_law(listed(v), V0).exponent
    assert found.value == pytest.approx(v.size / np.log(v / V0).sum(), rel=1e-6)
    # 2 n b over its estimate is chi-square with 2 n degrees of freedom.
    exact = found.value * chi2.ppf([0.025, 0.975], 2 * v.size) / (2 * v.size)
    assert [found.lower, found.upper] == pytest.approx(exact, rel=0.005)


def test_blocks_below_the_volume_of_completeness_do_not_count() -> None:
    v = drawn(200, 2)
    lost = np.concatenate([v, np.full(500, 0.5 * V0)])
    assert fit_power_law(listed(lost), V0).exponent == fit_power_law(listed(v), V0).exponent


def test_a_table_with_counts_is_the_list_of_its_blocks() -> None:
    v, n = np.array([0.06, 0.1, 0.3, 2.0]), np.array([5.0, 4.0, 2.0, 1.0])
    one = fit_power_law(BlockSurvey(v, v, n), V0).exponent
    every = fit_power_law(listed(np.repeat(v, n.astype(int))), V0).exponent
    assert one.value == pytest.approx(every.value) and one.upper == pytest.approx(every.upper)


def test_a_largest_volume_that_is_far_away_changes_nothing() -> None:
    v = drawn(100, 4)
    far = fit_power_law(listed(v), V0, 1e30).exponent.value
    assert far == pytest.approx(fit_power_law(listed(v), V0).exponent.value, rel=1e-6)


@pytest.mark.parametrize(("survey", "up_to"), [(listed, math.inf), (counted, 20.0)])
def test_intervals_hold_the_truth_as_often_as_they_say(survey, up_to: float) -> None:
    mean, low, high, n = 40, 1.0, 5.0, 200
    counts = poisson.rvs(mean, size=n, random_state=5)
    exponent = frequency = 0
    for seed, count in enumerate(counts):
        law = fit_power_law(survey(drawn(count, 100 + seed, up_to)), V0, up_to)
        exponent += law.exponent.lower <= B <= law.exponent.upper
        found = law.frequency(low, high, float(count), True)
        truth = mean * float(law.share(low, high, B))
        frequency += found.lower <= truth <= found.upper
    # Binomial with 95 %: outside 0.90 to 0.99 once in some thousand.
    assert 0.90 * n <= exponent <= 0.99 * n
    assert 0.90 * n <= frequency <= 0.99 * n


def test_share_is_that_of_many_draws() -> None:
    law = fit_power_law(listed(drawn(60, 6, 20.0)), V0, 20.0)
    many = drawn(200_000, 7, 20.0)
    for low, high in ((V0, 0.1), (0.1, 1.0), (1.0, 20.0)):
        seen = ((many >= low) & (many < high)).mean()
        assert float(law.share(low, high, B)) == pytest.approx(seen, abs=0.004)
    assert float(law.share(V0, 20.0, B)) == pytest.approx(1.0)


def test_rate_that_is_stated_has_no_error_of_its_own() -> None:
    law = fit_power_law(listed(drawn(60, 8)), V0)
    stated, counted_ = (law.frequency(1.0, 5.0, 60.0, own) for own in (False, True))
    assert stated.value == counted_.value
    assert counted_.lower < stated.lower < stated.upper < counted_.upper
    whole = law.frequency(V0, math.inf, 60.0, False)
    assert whole.lower == pytest.approx(60.0) == whole.upper
    # A Poisson count of 60 by its likelihood ratio.
    count = law.frequency(V0, math.inf, 60.0, True)
    for end in (count.lower, count.upper):
        assert 2 * (end - 60.0 - 60.0 * math.log(end / 60.0)) == pytest.approx(3.8415, abs=2e-3)


def test_p_tells_a_power_law_from_another() -> None:
    # Of four samples of the law few have a p below 0.1.
    low = [fit_test(fit_power_law(listed(drawn(60, 20 + k)), V0))[1] < 0.1 for k in range(4)]
    assert sum(low) <= 1
    other = np.exp(np.random.default_rng(9).normal(-1.5, 0.5, 200))
    assert fit_test(fit_power_law(listed(other[other > V0]), V0))[1] < 0.02
    assert fit_test(fit_power_law(counted(other[other > V0]), V0))[1] < 0.02


def test_fits_from_larger_volumes_on() -> None:
    law = fit_power_law(listed(drawn(300, 10)), V0)
    higher = list(higher_thresholds(law))
    assert [h.complete_from for h in higher] == pytest.approx([2 * V0, 4 * V0, 8 * V0])
    assert all(h.survey.blocks >= 20 and h.exponent.lower < B < h.exponent.upper for h in higher)
    few = replace(law, survey=listed(drawn(20, 11)))
    assert not list(higher_thresholds(few))


@pytest.mark.parametrize(
    ("volumes", "complete_from", "up_to", "problem"),
    [
        ([0.1] * 4, V0, math.inf, "too few blocks"),
        ([V0] * 9, V0, math.inf, "no power law fits"),
        ([0.9] * 9, V0, 1.0, "no power law fits"),
        ([0.1] * 9, V0, V0, "is not below the largest"),
        ([0.1] * 8 + [3.0], V0, 1.0, "larger blocks"),
    ],
)
def test_what_cannot_be_fitted(volumes, complete_from, up_to, problem) -> None:
    with pytest.raises(InputError, match=problem):
        fit_power_law(listed(np.array(volumes)), complete_from, up_to)


def test_completeness_within_a_class() -> None:
    with pytest.raises(InputError, match=r"0\.1 or 0\.2"):
        fit_power_law(counted(drawn(100, 12)), 0.15)
