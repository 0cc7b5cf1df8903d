"""Linear calibration against what is known in closed form: numbers that are linear in parameters.

A rock shows two quantities that are one parameter each and scatter by themselves; the numbers of a
site are the means of its rocks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from sassgis.gap.calibration.identifiability import (
    SiteFit,
    Told,
    contradicting,
    fitted_parameters,
    identified_combinations,
    posterior_of,
    small_sample_factor,
    together,
    told_by,
    trade_offs,
)
from sassgis.gap.calibration.linear_fit import FitBudget, LinearFit, Seen, Trial, fit_linearly
from sassgis.gap.calibration.parameters import RANGES, ClassParameter, Prior
from sassgis.gap.calibration.site_summary import ObservedNumbers, joined
from sassgis.model.grid import FloatArray

BUDGET = FitBudget(3, 16, 2, 4, 6.0, 64)
SLOPES = np.array([[1.0, 0.0], [0.6, 0.3], [0.0, 0.0]])


def rocks(truth: Sequence[float], n: int, rng: np.random.Generator, alike: int = 0) -> FloatArray:
    """What rocks show, shape (n, 3 + alike): further quantities are the first one again."""
    shown = SLOPES @ np.array(truth) + 2.0 * rng.standard_normal((n, 3))
    return np.hstack([shown, np.repeat(shown[:, :1], alike, axis=1)])


def numbers_of(shown: FloatArray, rng: np.random.Generator) -> ObservedNumbers:
    n, p = shown.shape
    drawn = rng.multinomial(n, np.full(n, 1.0 / n), size=400) @ shown / n
    used = np.ones(p, np.bool_)
    return ObservedNumbers(shown.mean(axis=0), drawn.std(axis=0), used, drawn, n, 1)


def fitted(sites: Sequence[ObservedNumbers], rng: np.random.Generator) -> LinearFit:
    whole = joined(sites)
    each = whole.observed.size // len(sites)
    slopes = np.vstack([SLOPES, np.repeat(SLOPES[:1], each - 3, axis=0)])

    def run(trials: Sequence[Trial]) -> list[Seen]:
        made = []
        for one in trials:
            scatter = 0.3 / np.sqrt(one.count) * rng.standard_normal((len(sites), each))
            shown = (slopes @ one.at + scatter).ravel()
            off = (shown - whole.observed) / whole.error
            made.append((shown, float(np.mean(off**2)) / whole.units))
        return made

    return fit_linearly(whole, np.zeros(2), run, BUDGET)


def exact(sites: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the posterior of independent numbers, by the formula."""
    precision, pull = np.eye(2), np.zeros(2)
    for shown in sites:
        weight = SLOPES.T / (shown.var(axis=0) / len(shown))
        precision, pull = precision + weight @ SLOPES, pull + weight @ shown.mean(axis=0)
    return np.linalg.solve(precision, pull), np.linalg.inv(precision)


def test_two_sites_give_the_posterior_of_the_formula() -> None:
    rng = np.random.default_rng(5)
    shown = [rocks((1.5, -0.5), n, rng) for n in (60, 25)]
    sites = [numbers_of(own, rng) for own in shown]
    fit = fitted(sites, rng)
    told = told_by(fit, sites)
    at, covariance = together(told).estimate()
    mean, expected = exact(shown)
    sd = np.sqrt(np.diag(expected))
    assert np.abs((at - mean) / sd).max() < 0.35
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sd, rtol=0.25)
    # The estimate is where the step of all numbers leads, and each site has its own share in it.
    whole = joined(sites)
    step = fit.step(whole.in_errors(whole.observed))
    np.testing.assert_allclose(at, fit.best + step)
    one, _ = told[0].estimate()
    assert np.linalg.norm(one - exact(shown[:1])[0]) < 0.25
    # One combination is told well by these rocks, the other is as before.
    assert identified_combinations(covariance) == 1
    assert [t.correlation < 0.0 for t in trade_offs("ab", covariance)] in ([], [True])


def test_rocks_that_are_left_out_do_not_count() -> None:
    rng = np.random.default_rng(6)
    low, high = rocks((-1.0, 0.0), 40, rng), rocks((1.0, 0.0), 40, rng)
    whole = numbers_of(np.vstack([low, high]), rng)
    fit = fitted([whole], rng)
    observed = whole.in_errors(whole.observed)
    for part, expected in ((low, -1.0), (high, 1.0)):
        instead = fit.moved(observed, whole.in_errors(part.mean(axis=0)))
        assert instead[0] == pytest.approx(fit.best[0] + expected, abs=0.45)
    np.testing.assert_array_equal(fit.moved(observed, observed), fit.best)


def test_a_quantity_that_is_counted_five_times_tells_no_more() -> None:
    rng = np.random.default_rng(7)
    shown = rocks((0.5, 0.0), 50, rng, alike=4)
    widths = []
    for own in (shown[:, :3], shown):
        site = numbers_of(own, rng)
        (told,) = told_by(fitted([site], rng), [site])
        widths.append(np.sqrt(told.estimate()[1][0, 0]))
    assert widths[1] > 0.95 * widths[0]
    naive = np.linalg.inv(told.precision + np.eye(2))[0, 0] ** 0.5
    assert naive < 0.7 * widths[1]


def test_intervals_hold_the_value_as_often_as_they_say() -> None:
    rng = np.random.default_rng(8)
    held = []
    for _ in range(60):
        truth = rng.standard_normal(2)
        site = numbers_of(rocks(truth, 20, rng, alike=2), rng)
        at, covariance = told_by(fitted([site], rng), [site])[0].estimate()
        held.append(np.abs(truth - at) < 1.2816 * np.sqrt(np.diag(covariance)))
    # 80 %; two standard errors are 7 %.
    assert 0.72 < np.mean(held) < 0.92


@pytest.mark.parametrize(("second", "contradict"), [(0.4, False), (-2.5, True)])
def test_sites_contradict_if_common_parameters_suit_none(second: float, contradict: bool) -> None:
    rng = np.random.default_rng(4)
    sites = [numbers_of(rocks((at, 0.0), 40, rng), rng) for at in (0.6, second)]
    told = told_by(fitted(sites, rng), sites)
    fits = [SiteFit(1.1, 1.0, np.zeros(2))] * 2
    assert contradicting(told, fits, 1) == contradict
    # Certain, but not worth telling; and one site alone contradicts nobody.
    assert not contradicting(told, [SiteFit(1.01, 1.0, np.zeros(2))] * 2, 1)
    assert not contradicting(told[:1], fits[:1], 1)


def test_samples_are_shares_with_the_prior_of_the_parameters() -> None:
    parameters = [
        ClassParameter(name, "mu_0", RANGES["mu_0"], 0.45, sd)
        for name, sd in (("a", 0.1), ("b", 0.2))
    ]
    told = Told(np.zeros(2), np.diag([8.0, 0.0]), np.array([8.0, 0.0]), np.diag([8.0, 0.0]))
    found = posterior_of(Prior.of(parameters), told, 1)
    one, other = fitted_parameters(parameters, found)
    # Of the first the rocks know more than the prior: a third of its width, and a value above it.
    assert one.identified and one.narrowed == pytest.approx(1.0 / 3.0, abs=0.03)
    assert one.value == pytest.approx(0.45 + 0.85 * 0.1 * 8.0 / 9.0, abs=1e-3)
    assert not other.identified and other.narrowed == pytest.approx(1.0, abs=0.05)
    assert other.value == pytest.approx(0.45, abs=0.002) and one.limit == other.limit == ""


def test_small_samples_widen() -> None:
    assert small_sample_factor(3) == pytest.approx((4.3027 / 1.95996) ** 2 * 1.5, rel=1e-3)
    assert small_sample_factor(10_000) == pytest.approx(1.0, abs=1e-3)
