"""Scores and tests against other libraries, closed forms and their definitions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from sassgis.gap.fit.distances import (
    bootstrap_interval,
    bootstrap_rows,
    energy_scores,
)
from sassgis.gap.fit.site_data import Scale
from sassgis.gap.residuals.rock_residuals import (
    false_discovery_adjusted,
    max_t_adjusted,
    mean_gap_tests,
    rock_means,
    t_statistics,
)

NAN = np.nan


def pairs_mean(a, b):
    """Mean distance of all pairs, as the definition has it."""
    return np.mean([[np.linalg.norm(p - q) for q in b] for p in a])


def samples(seed, n=23, m=31, p=3):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, p)), rng.normal(0.4, 1.5, size=(m, p)) * [1.0, 5.0, 0.2][:p]


# --- energy score ---------------------------------------------------------------


def score_of(members, seen):
    """The score of one observation."""
    return energy_scores(np.atleast_2d(seen), np.asarray(members, float)[:, None, :])[0]


def test_energy_score_by_its_definition():
    x, y = samples(8)
    own = [np.linalg.norm(a - b) for a, b in itertools.permutations(y, 2)]
    expected = pairs_mean(x[:1], y) - 0.5 * np.mean(own)
    assert score_of(y, x[0]) == pytest.approx(expected, rel=1e-12)


def test_crps_of_a_normal_has_a_closed_form():
    y = scipy.stats.norm.ppf((np.arange(2000) + 0.5) / 2000)
    phi, cdf = scipy.stats.norm.pdf, scipy.stats.norm.cdf
    for z in (-1.5, 0.0, 0.7):
        assert score_of(y[:, None], [z]) == pytest.approx(
            z * (2 * cdf(z) - 1) + 2 * phi(z) - 1 / np.sqrt(np.pi), abs=1e-3
        )


def test_energy_score_leaves_out_what_was_not_measured():
    x, y = samples(12)
    seen = np.array([x[0, 0], NAN, x[0, 2]])
    expected = np.sqrt(3 / 2) * score_of(y[:, [0, 2]], x[0, [0, 2]])
    assert score_of(y, seen) == pytest.approx(expected)
    assert np.isnan(score_of(y, np.full(3, NAN)))
    # A member that lacks what was measured is left out; one that lacks the rest is not.
    less = y.copy()
    less[0, 1], less[1, 0] = NAN, NAN
    assert score_of(less, seen) == pytest.approx(score_of(np.delete(y, 1, axis=0), seen))
    less[2:, 2] = NAN
    assert np.isnan(score_of(less, seen))


@pytest.mark.parametrize("wrong", [(0.0, 0.6), (0.0, 1.6), (0.5, 1.0)])
def test_energy_score_is_proper(wrong):
    rng = np.random.default_rng(14)
    truth = rng.normal(size=(600, 2))
    right = energy_scores(truth, rng.normal(size=(40, 600, 2)))
    other = energy_scores(truth, rng.normal(*wrong, size=(40, 600, 2)))
    assert (other - right).mean() > 3 * (other - right).std() / np.sqrt(600)


def test_energy_score_does_not_depend_on_the_size_of_the_ensemble():
    rng = np.random.default_rng(3)
    small = energy_scores(rng.normal(size=(6000, 1)), rng.normal(size=(3, 6000, 1)))
    large = energy_scores(rng.normal(size=(6000, 1)), rng.normal(size=(30, 6000, 1)))
    assert abs(small.mean() - large.mean()) < 4 * small.std() / np.sqrt(6000)


def test_a_model_in_which_no_rock_arrives_does_not_escape():
    scale = Scale(("S0:speed",), np.array([2.0]), np.array([0.5]))
    seen = scale.rows({"S0:speed": np.array([2.25])})
    some = np.stack([scale.rows({"S0:speed": np.array([v])}) for v in (2.0, 2.3, 2.4)])
    none = np.stack([scale.rows({"S0:speed": np.array([NAN])})] * 3)
    assert score_of(none[:, 0], seen[0]) > 2 * score_of(some[:, 0], seen[0])
    assert score_of(none[:, 0], seen[0]) == pytest.approx(np.hypot(0.5, 1.0))


def test_rock_means_and_t():
    means, rocks = rock_means(np.array([1.0, 3.0, NAN, 5.0, NAN]), np.array([4, 4, 4, 2, 9]))
    assert rocks.tolist() == [2, 4, 9]
    np.testing.assert_allclose(means[:, 0], [5.0, 2.0, NAN])
    rng = np.random.default_rng(0)
    data = rng.normal(0.5, 1, size=(12, 3))
    data[3:5, 1] = NAN
    expected = scipy.stats.ttest_1samp(data, 0.0, nan_policy="omit").statistic
    np.testing.assert_allclose(t_statistics(data), np.asarray(expected, float), rtol=1e-10)
    assert np.isnan(t_statistics(data[:2])).all()
    assert np.isinf(t_statistics(np.full((5, 1), 0.1))).all()


def test_bootstrap_draws_whole_rocks():
    rock = np.array([7, 3, 7, 3, 3, 9])
    for rows in bootstrap_rows(rock, 50, np.random.default_rng(0)):
        times = np.bincount(rows, minlength=6)
        drawn = [np.unique(times[rock == name]) for name in (3, 7, 9)]
        assert all(own.size == 1 for own in drawn) and np.sum(drawn) == 3


def test_bootstrap_over_rocks_covers_where_one_over_rows_does_not():
    rng = np.random.default_rng(4)
    rock = np.repeat(np.arange(25), 6)
    rows_alone = np.arange(rock.size)
    inside = np.zeros(2)
    for _ in range(80):
        data = rng.normal(size=25)[rock] + 0.3 * rng.normal(size=rock.size)
        for k, unit in enumerate((rock, rows_alone)):
            found = bootstrap_interval(
                lambda rows, data=data: data[rows].mean(),
                unit,
                draws=100,
                rng=rng,
            )
            inside[k] += found.low <= 0.0 <= found.high
    assert inside[0] / 80 > 0.85
    assert inside[1] / 80 < 0.75


def test_bootstrap_of_one_rock_has_no_limits():
    found = bootstrap_interval(
        lambda rows: 1.0, np.zeros(3, int), draws=9, rng=np.random.default_rng(0)
    )
    assert found.value == 1.0
    assert np.isnan(found.low) and np.isnan(found.high)


# --- many comparisons ------------------------------------------------------------


def test_false_discoveries_leave_missing_ones_out():
    p = np.random.default_rng(0).random(30) ** 2
    found = false_discovery_adjusted(np.insert(p, 4, NAN))
    assert np.isnan(found[4])
    np.testing.assert_allclose(np.delete(found, 4), scipy.stats.false_discovery_control(p))


def test_sign_flips_are_those_of_scipy():
    data = np.random.default_rng(5).normal(0.6, 1.0, size=10)
    _, p, adjusted = mean_gap_tests(data, draws=20_000, rng=np.random.default_rng(1))

    def t(x, axis):
        return np.abs(x.mean(axis) / (x.std(axis, ddof=1) / np.sqrt(x.shape[axis])))

    # All 2^10 flips.
    exact = scipy.stats.permutation_test(
        (data,), t, permutation_type="samples", alternative="greater", vectorized=True
    ).pvalue
    assert p[0] == pytest.approx(exact, abs=0.01)
    assert adjusted[0] == p[0]


def westfall_young(observed, null):
    """Step-down adjustment written out rank by rank."""
    order = sorted(range(len(observed)), key=lambda k: -observed[k])
    p, worst = {}, 0.0
    for rank, k in enumerate(order):
        rest = order[rank:]
        count = sum(max(row[j] for j in rest) >= observed[k] for row in null)
        worst = max(worst, (count + 1) / (len(null) + 1))
        p[k] = worst
    return [p[k] for k in range(len(observed))]


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_max_t_by_its_definition(seed):
    rng = np.random.default_rng(seed)
    observed = np.abs(rng.normal(0.5, 1.5, size=5))
    null = np.abs(rng.normal(size=(40, 5)))
    np.testing.assert_allclose(max_t_adjusted(observed, null), westfall_young(observed, null))


def test_max_t_leaves_missing_ones_out():
    null = np.array([[1.0, NAN, 3.0], [0.5, 9.0, NAN]])
    p = max_t_adjusted(np.array([2.0, NAN, 1.0]), null)
    np.testing.assert_allclose(p, [2 / 3, NAN, 2 / 3])


def test_headline_keeps_its_level_and_finds_the_one_gap():
    rng = np.random.default_rng(6)
    false, found, unadjusted = 0, 0, 0
    for _ in range(200):
        rocks = rng.normal(size=(25, 8)) + rng.normal(size=(25, 1))  # correlated quantities
        rocks[rng.random(rocks.shape) < 0.2] = NAN
        _, p, adjusted = mean_gap_tests(rocks, draws=199, rng=rng)
        false += np.nanmin(adjusted) <= 0.05
        unadjusted += np.nanmin(p) <= 0.05
        rocks[:, 3] += 2.0
        _, _, adjusted = mean_gap_tests(rocks, draws=199, rng=rng)
        found += np.nanargmin(adjusted) == 3 and adjusted[3] <= 0.05
    assert false / 200 < 0.095
    assert unadjusted / 200 > 0.12
    assert found / 200 > 0.9


def test_rocks_of_a_group_are_tested_together():
    """Rocks of a day share its weather: as single ones they would be found too sure."""
    rng = np.random.default_rng(8)
    day = np.repeat(np.arange(6), 5)
    alone = together = 0
    for _ in range(200):
        values = rng.standard_normal(6)[day] + 0.3 * rng.standard_normal(30)
        alone += mean_gap_tests(values, draws=99, rng=rng)[1][0] <= 0.05
        together += mean_gap_tests(values, draws=99, rng=rng, unit=day)[1][0] <= 0.05
    assert alone / 200 > 0.3 and together / 200 < 0.1


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
