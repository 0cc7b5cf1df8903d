"""Scores and tests against other libraries, closed forms and their definitions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from sassgis.gap.inference.distances import (
    energy_distance,
    energy_score,
    energy_scores,
    observed_scale,
)
from sassgis.gap.inference.intervals import bootstrap_interval, bootstrap_rows, share_interval
from sassgis.gap.inference.rock_tests import (
    false_discovery_adjusted,
    max_t_adjusted,
    mean_gap_tests,
    rock_means,
    t_statistics,
)
from sassgis.gap.which.ensemble import Scale, rock_scores

NAN = np.nan


def pairs_mean(a, b):
    """Mean distance of all pairs, as the definition has it."""
    return np.mean([[np.linalg.norm(p - q) for q in b] for p in a])


def samples(seed, n=23, m=31, p=3):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, p)), rng.normal(0.4, 1.5, size=(m, p)) * [1.0, 5.0, 0.2][:p]


# --- energy distance ------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_energy_distance_in_one_dimension_is_that_of_scipy(seed):
    x, y = (s[:, 0] for s in samples(seed))
    ours = energy_distance(x, y, scale=np.ones(1))
    assert ours == pytest.approx(scipy.stats.energy_distance(x, y) ** 2, rel=1e-10)


def test_energy_distance_by_its_definition():
    x, y = samples(7)
    s = x.std(axis=0, ddof=1)
    expected = 2 * pairs_mean(x / s, y / s) - pairs_mean(x / s, x / s) - pairs_mean(y / s, y / s)
    assert energy_distance(x, y) == pytest.approx(expected, rel=1e-12)


def test_energy_distance_is_that_of_dcor():
    dcor = pytest.importorskip("dcor", reason="dcor is not installed")
    x, y = samples(8)
    ours = energy_distance(x, y, scale=np.ones(3))
    assert ours == pytest.approx(dcor.energy_distance(x, y), rel=1e-12)
    unbiased = energy_distance(x, y, scale=np.ones(3), unbiased=True)
    other = dcor.energy_distance(x, y, estimation_stat="u_statistic")
    assert unbiased == pytest.approx(other, rel=1e-12)


def test_energy_distance_in_blocks_is_the_same(monkeypatch):
    x, y = samples(9)
    whole = energy_distance(x, y)
    monkeypatch.setattr("sassgis.gap.inference.distances.PAIRS", 50)
    assert energy_distance(x, y) == pytest.approx(whole, rel=1e-13)


def test_energy_distance_of_normals_has_a_closed_form():
    # E|N(d, 2)| for the cross term, 2/sqrt(pi) for those within.
    rng = np.random.default_rng(1)
    d = 1.3
    x, y = rng.normal(size=40_000), rng.normal(d, 1.0, size=40_000)
    cross = scipy.stats.foldnorm(d / np.sqrt(2), scale=np.sqrt(2)).mean()
    expected = 2 * cross - 4 / np.sqrt(np.pi)
    assert energy_distance(x, y, scale=np.ones(1)) == pytest.approx(expected, rel=0.03)


def test_unbiased_energy_distance_is_centred_on_zero_and_the_other_is_not():
    rng = np.random.default_rng(2)
    one = np.ones(2)
    unbiased, biased = [], []
    for _ in range(400):
        x, y = rng.normal(size=(8, 2)), rng.normal(size=(12, 2))
        unbiased.append(energy_distance(x, y, scale=one, unbiased=True))
        biased.append(energy_distance(x, y, scale=one))
    error = np.std(unbiased) / np.sqrt(len(unbiased))
    assert abs(np.mean(unbiased)) < 3 * error
    # As documented: E|X − X'| (1/n + 1/m), which is sqrt(pi) for two standard normals.
    assert np.mean(biased) == pytest.approx(np.sqrt(np.pi) * (1 / 8 + 1 / 12), rel=0.1)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(-50, 50), st.floats(0.01, 100))
def test_energy_distance_does_not_depend_on_place_or_unit(seed, shift, unit):
    x, y = samples(seed, 6, 7)
    assert energy_distance(x * unit + shift, y * unit + shift) == pytest.approx(
        energy_distance(x, y), rel=1e-6, abs=1e-9
    )
    assert energy_distance(x, x) == pytest.approx(0.0, abs=1e-12)


def test_ragged_rows_compare_what_they_have():
    x = np.array([[1.0, 2.0], [3.0, NAN], [5.0, NAN]])
    y = np.array([[2.0, 2.0], [4.0, 1.0]])
    one = np.ones(2)

    def squared(a, b):
        return 2 * pairs_mean(a, b) - pairs_mean(a, a) - pairs_mean(b, b)

    both = squared(x[:1], y)
    first = np.sqrt(2.0) * squared(x[:, :1], y[:, :1])
    assert energy_distance(x, y, scale=one) == pytest.approx((both + 2 * first) / 3)


def test_ragged_rows_missing_by_chance_leave_equal_samples_near():
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(400, 3)), rng.normal(size=(400, 3))
    x[rng.random(x.shape) < 0.3] = NAN
    near = energy_distance(x, y)
    assert 0.0 <= near < 0.06
    assert energy_distance(x, y + 1.0) > 10 * near


def test_ragged_distance_is_not_fooled_by_what_is_missing():
    # The speed of the slow rocks was not taken; the others agree with the simulation.
    y = np.column_stack([np.arange(10.0), np.arange(10.0)])
    x = np.column_stack([np.arange(10.0), np.full(10, NAN)])
    assert energy_distance(x, y) == pytest.approx(0.0, abs=1e-12)


def test_quantities_without_a_counterpart_are_left_out():
    x, y = samples(4)
    y2 = y.copy()
    y2[:, 2] = NAN
    expected = np.sqrt(3 / 2) * energy_distance(x[:, :2], y[:, :2])
    assert energy_distance(x, y2) == pytest.approx(expected)
    assert np.isnan(energy_distance(x[:, :1], np.full((4, 1), NAN)))
    with pytest.raises(ValueError, match="3 and 2"):
        energy_distance(x, y[:, :2])


def test_scale_of_constant_or_single_values_is_one():
    x = np.array([[0.1, 5.0, NAN], [0.1, NAN, NAN], [0.1, 7.0, 3.0]])
    assert observed_scale(x) == pytest.approx([1.0, np.sqrt(2.0), 1.0])


# --- energy score and CRPS -----------------------------------------------------------------------


@pytest.mark.parametrize("fair", [False, True])
def test_energy_score_by_its_definition(fair):
    y, x = samples(11)
    m = len(y)
    pairs = sum(np.linalg.norm(a - b) for a, b in itertools.permutations(y, 2))
    expected = pairs_mean(y, x[:1]) - 0.5 * pairs / (m * (m - 1) if fair else m * m)
    assert energy_score(y, x[0], fair=fair) == pytest.approx(expected, rel=1e-12)


def test_scores_are_those_of_scoringrules():
    rules = pytest.importorskip("scoringrules", reason="scoringrules is not installed")
    y, x = samples(12)
    ours = energy_score(y, x[0], fair=False)
    assert ours == pytest.approx(float(rules.es_ensemble(x[0], y)), rel=1e-9)
    for fair, estimator in ((False, "nrg"), (True, "fair")):
        other = float(rules.crps_ensemble(x[0, 0], y[:, 0], estimator=estimator))
        assert energy_score(y[:, 0], x[0, :1], fair=fair) == pytest.approx(other, rel=1e-9)
    replicas = np.random.default_rng(8).normal(size=(6, len(x), x.shape[1]))
    fair = rules.es_ensemble(x, np.moveaxis(replicas, 0, 1), estimator="fair")
    np.testing.assert_allclose(rock_scores(x, replicas), fair, rtol=1e-9)


def test_crps_is_the_integral_over_the_step():
    y = np.array([0.3, 2.0, 2.5, -1.0])
    seen = 0.9
    t = np.linspace(-3, 5, 800_001)
    cdf = (y[:, None] <= t).mean(axis=0)
    squared = (cdf - (t >= seen)) ** 2
    integral = squared.sum() * (t[1] - t[0])
    assert energy_score(y, [seen], fair=False) == pytest.approx(integral, rel=1e-4)


def test_crps_of_a_normal_has_a_closed_form():
    y = scipy.stats.norm.ppf((np.arange(4000) + 0.5) / 4000)
    for z in (-1.5, 0.0, 0.7):
        expected = z * (2 * scipy.stats.norm.cdf(z) - 1) + 2 * scipy.stats.norm.pdf(z)
        assert energy_score(y, [z], fair=False) == pytest.approx(
            expected - 1 / np.sqrt(np.pi), abs=2e-3
        )


def test_crps_takes_ragged_ensembles_row_by_row():
    ensembles = np.array([[1.0, 4.0, NAN], [2.0, 2.0, 5.0], [NAN, NAN, NAN]])[:, :, None]
    seen = np.array([3.0, NAN, 1.0])
    result = energy_scores(ensembles, seen, scale=np.ones(1), fair=False)
    assert result[0] == pytest.approx(energy_score([1.0, 4.0], [3.0], fair=False))
    assert np.isnan(result[1:]).all()
    assert np.isnan(energy_score([2.0], [1.0], fair=True))
    assert energy_score([2.0], [1.0], fair=False) == 1.0


def test_energy_score_leaves_out_what_was_not_measured():
    y, x = samples(13)
    seen = np.array([x[0, 0], NAN, x[0, 2]])
    expected = np.sqrt(3 / 2) * energy_score(y[:, [0, 2]], x[0, [0, 2]])
    assert energy_score(y, seen) == pytest.approx(expected)
    assert np.isnan(energy_score(y, np.full(3, NAN)))
    gone = y.copy()
    gone[:, 0] = NAN
    assert np.isnan(energy_score(gone, seen))


@pytest.mark.parametrize("wrong", [(0.6, 1.0), (0.0, 1.6), (0.0, 0.5)])
def test_energy_score_is_proper(wrong):
    """The truth scores best in the mean, against shift, too much and too little scatter."""
    rng = np.random.default_rng(5)
    truth = rng.normal(size=(600, 2))
    right = energy_scores(rng.normal(size=(600, 40, 2)), truth, scale=np.ones(2))
    other = energy_scores(rng.normal(*wrong, size=(600, 40, 2)), truth, scale=np.ones(2))
    difference = other - right
    assert difference.mean() > 3 * difference.std() / np.sqrt(difference.size)


def test_fair_energy_score_does_not_depend_on_the_size_of_the_ensemble():
    rng = np.random.default_rng(6)
    small = [energy_score(rng.normal(size=(3, 1)), rng.normal(size=1)) for _ in range(6000)]
    expected = 1 / np.sqrt(np.pi)  # E|Y − y| / 2 for standard normals
    assert np.mean(small) == pytest.approx(expected, abs=4 * np.std(small) / np.sqrt(6000))


def test_a_model_in_which_no_rock_arrives_does_not_escape():
    # A rock without a speed at the station, and twenty replicas with and without one.
    scale = Scale(("S0:speed",), np.array([10.0]), np.array([2.0]))
    seen = scale.rows({"S0:speed": np.array([11.0])})
    none = scale.rows({"S0:speed": np.full(20, NAN)})
    some = scale.rows({"S0:speed": np.linspace(8, 14, 20)})
    assert energy_score(none, seen[0]) > 2 * energy_score(some, seen[0])
    assert energy_score(none, seen[0]) == pytest.approx(np.hypot(0.5, 1.0))


# --- rocks as units ------------------------------------------------------------


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
    for rows, new in bootstrap_rows(rock, 50, np.random.default_rng(0)):
        for unit in np.unique(new):
            own = rows[new == unit]
            name = rock[own[0]]
            assert sorted(own.tolist()) == np.flatnonzero(rock == name).tolist()
        assert np.unique(new).size == 3


@pytest.mark.parametrize(
    ("method", "theirs"), [("percentile", "percentile"), ("basic", "basic"), ("BCa", "BCa")]
)
def test_bootstrap_of_single_rows_is_that_of_scipy(method, theirs):
    data = np.random.default_rng(3).gamma(2.0, size=30)
    ours = bootstrap_interval(
        lambda rows: data[rows].mean(),
        np.arange(30),
        draws=6000,
        rng=np.random.default_rng(1),
        method=method,
    )
    other = scipy.stats.bootstrap(
        (data,), np.mean, n_resamples=6000, method=theirs, random_state=np.random.default_rng(2)
    ).confidence_interval
    assert ours.value == data.mean()
    assert ours.low == pytest.approx(other.low, abs=0.04)
    assert ours.high == pytest.approx(other.high, abs=0.04)


def test_bootstrap_over_rocks_covers_where_one_over_rows_does_not():
    rng = np.random.default_rng(4)
    rock = np.repeat(np.arange(25), 6)
    rows_alone = np.arange(rock.size)
    inside = np.zeros(2)
    for _ in range(120):
        data = rng.normal(size=25)[rock] + 0.3 * rng.normal(size=rock.size)
        for k, unit in enumerate((rock, rows_alone)):
            found = bootstrap_interval(
                lambda rows, data=data: data[rows].mean(),
                unit,
                draws=200,
                rng=rng,
                method="percentile",
            )
            inside[k] += found.low <= 0.0 <= found.high
    assert inside[0] / 120 > 0.85
    assert inside[1] / 120 < 0.75


def test_bootstrap_of_one_rock_has_no_limits():
    found = bootstrap_interval(
        lambda rows: 1.0, np.zeros(3, int), draws=9, rng=np.random.default_rng(0)
    )
    assert found.value == 1.0
    assert np.isnan(found.low) and np.isnan(found.high)


# --- many comparisons ------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_benjamini_hochberg_is_that_of_scipy(seed):
    p = np.random.default_rng(seed).random(30) ** 2
    np.testing.assert_allclose(
        false_discovery_adjusted(p), scipy.stats.false_discovery_control(p), rtol=1e-12
    )
    with_gap = np.insert(p, 4, NAN)
    assert np.isnan(false_discovery_adjusted(with_gap)[4])
    np.testing.assert_allclose(
        np.delete(false_discovery_adjusted(with_gap), 4), false_discovery_adjusted(p)
    )


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


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_max_t_by_its_definition(seed):
    rng = np.random.default_rng(seed)
    observed = np.abs(rng.normal(0.5, 1.5, size=5))
    null = np.abs(rng.normal(size=(40, 5)))
    down = max_t_adjusted(observed, null)
    single = max_t_adjusted(observed, null, step_down=False)
    np.testing.assert_allclose(down, westfall_young(observed, null))
    expected = [((null.max(axis=1) >= o).sum() + 1) / 41 for o in observed]
    np.testing.assert_allclose(single, expected)
    assert (down <= single).all()


def test_max_t_leaves_missing_ones_out():
    null = np.array([[1.0, NAN, 3.0], [0.5, 9.0, NAN]])
    p = max_t_adjusted(np.array([2.0, NAN, 1.0]), null)
    np.testing.assert_allclose(p, [2 / 3, NAN, 2 / 3])


@pytest.mark.parametrize(("method", "limit"), [("sign_flip", 0.095), ("bootstrap", 0.11)])
def test_headline_keeps_its_level_and_finds_the_one_gap(method, limit):
    rng = np.random.default_rng(6)
    false, found, unadjusted = 0, 0, 0
    for _ in range(200):
        rocks = rng.normal(size=(25, 8)) + rng.normal(size=(25, 1))  # correlated quantities
        rocks[rng.random(rocks.shape) < 0.2] = NAN
        _, p, adjusted = mean_gap_tests(rocks, draws=199, rng=rng, method=method)
        false += np.nanmin(adjusted) <= 0.05
        unadjusted += np.nanmin(p) <= 0.05
        rocks[:, 3] += 2.0
        _, _, adjusted = mean_gap_tests(rocks, draws=199, rng=rng, method=method)
        found += np.nanargmin(adjusted) == 3 and adjusted[3] <= 0.05
    assert false / 200 < limit
    assert unadjusted / 200 > 0.12
    assert found / 200 > 0.9


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


# --- shares ------------------------------------------------------------


@pytest.mark.parametrize(("hits", "trials"), [(0, 12), (3, 12), (12, 12), (77, 200), (1, 1)])
@pytest.mark.parametrize(("method", "theirs"), [("wilson", "wilson"), ("exact", "exact")])
def test_share_intervals_are_those_of_scipy(hits, trials, method, theirs):
    ours = share_interval(hits, trials, method=method, level=0.9)
    other = scipy.stats.binomtest(hits, trials).proportion_ci(0.9, method=theirs)
    assert ours.low == pytest.approx(other.low, abs=1e-9)
    assert ours.high == pytest.approx(other.high, abs=1e-9)
    assert ours.value == hits / trials


def test_share_without_trials_is_unknown():
    assert share_interval(0, 0).high == 1.0
    with pytest.raises(ValueError, match="5 hits in 4"):
        share_interval(5, 4)
