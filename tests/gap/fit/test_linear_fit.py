"""Linear calibration against what is known in closed form: numbers that are linear in parameters.

A rock shows two quantities that are one parameter each and scatter by themselves; the numbers of a
site are the means of its rocks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from sassgis.gap.fit.linear_fit import FitBudget, ObservedNumbers, Seen, Trial, fit_linearly, joined
from sassgis.gap.fit.parameters import (
    RANGES,
    ClassParameter,
    Estimated,
    Misfits,
    contradicting,
    estimated_by,
    fitted_parameters,
    identified_combinations,
    posterior_of,
    small_sample_factor,
    together,
    trade_offs,
)
from sassgis.grid import FloatArray

BUDGET = FitBudget(3, 16, 2, 4, 6.0, 64)
SLOPES = np.array([[1.0, 0.0], [0.6, 0.3], [0.0, 0.0]])


def rocks(truth: Sequence[float], n: int, rng: np.random.Generator, alike: int = 0) -> FloatArray:
    """What rocks show, shape (n, 3 + alike): further quantities are the first one again."""
    shown = SLOPES @ np.array(truth) + 2.0 * rng.standard_normal((n, 3))
    return np.hstack([shown, np.repeat(shown[:, :1], alike, axis=1)])


def numbers_of(shown: FloatArray) -> ObservedNumbers:
    n, p = shown.shape
    error = shown.std(axis=0) / np.sqrt(n)
    return ObservedNumbers(shown.mean(axis=0), error, np.ones(p, np.bool_), n, 1)


def slopes_of(shown: FloatArray) -> FloatArray:
    return np.vstack([SLOPES, np.repeat(SLOPES[:1], shown.shape[1] - 3, axis=0)])


def estimates_of(sites: Sequence[FloatArray], rng: np.random.Generator) -> tuple[Estimated, ...]:
    """Calibrate on what the rocks of some sites show; the parts are two halves of the rocks."""
    each = [numbers_of(shown) for shown in sites]
    whole = joined(each)
    slopes = np.vstack([slopes_of(shown) for shown in sites])

    def run(trials: Sequence[Trial]) -> list[Seen]:
        made = []
        for one in trials:
            scatter = 0.3 / np.sqrt(one.count) * rng.standard_normal(len(slopes))
            shown = slopes @ one.at + scatter
            off = (shown - whole.observed) / whole.error
            made.append(Seen(shown, float(np.mean(off**2)) / whole.units))
        return made

    fit = fit_linearly(whole, np.zeros(2), run, BUDGET)
    misfits = []
    for shown, own in zip(sites, each, strict=True):
        n = own.units
        first = np.arange(n) < n // 2
        drawn = rng.multinomial(n, np.full(n, 1.0 / n), size=400)
        means = np.vstack([np.ones(n), ~first, first, drawn]).astype(float)
        means = means @ shown / means.sum(axis=1, keepdims=True)
        off = (means - slopes_of(shown) @ fit.best) / own.error
        misfits.append(Misfits(off[0], off[1:3], off[3:], n))
    return estimated_by(fit, misfits)


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
    estimated = estimates_of(shown, rng)
    at, covariance = together(estimated).estimate()
    mean, expected = exact(shown)
    sd = np.sqrt(np.diag(expected))
    assert np.abs((at - mean) / sd).max() < 0.35
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sd, rtol=0.25)
    # Each site has its own share in it.
    assert np.linalg.norm(estimated[0].estimate()[0] - exact(shown[:1])[0]) < 0.25
    # Both combinations are estimated, and more of the one makes up for less of the other.
    assert identified_combinations(covariance) == 2 and covariance[0, 1] < 0.0


def test_trade_offs_are_the_strongest_correlations() -> None:
    found = trade_offs("abc", np.array([[1.0, 0.5, 0.3], [0.5, 1.0, -1.2], [0.3, -1.2, 4.0]]))
    assert [(t.one, t.other, t.correlation) for t in found] == [("b", "c", -0.6), ("a", "b", 0.5)]


def test_rocks_that_are_left_out_do_not_count() -> None:
    rng = np.random.default_rng(6)
    halves = [rocks((at, 0.0), 40, rng) for at in (-1.0, 1.0)]
    (estimated,) = estimates_of([np.vstack(halves)], rng)
    for part, other in enumerate(halves[::-1]):
        # Weights are those of the scatter of all rocks.
        weight = SLOPES.T / (np.vstack(halves).var(axis=0) / 80)
        expected = np.linalg.solve(weight @ SLOPES + np.eye(2), weight @ other.mean(axis=0))
        assert estimated.estimate_without(part) == pytest.approx(expected, abs=0.15)


def test_a_quantity_that_is_counted_five_times_tells_no_more() -> None:
    rng = np.random.default_rng(7)
    shown = rocks((0.5, 0.0), 50, rng, alike=4)
    once, often = (estimates_of([own], rng)[0] for own in (shown[:, :3], shown))
    width = [np.sqrt(estimated.estimate()[1][0, 0]) for estimated in (once, often)]
    assert width[1] > 0.95 * width[0]
    naive = np.sqrt(np.linalg.inv(often.precision + np.eye(2))[0, 0])
    assert naive < 0.7 * width[1]


def test_intervals_hold_the_value_as_often_as_they_say() -> None:
    rng = np.random.default_rng(8)
    held = []
    for _ in range(60):
        truth = rng.standard_normal(2)
        (estimated,) = estimates_of([rocks(truth, 20, rng, alike=2)], rng)
        at, covariance = estimated.estimate()
        held.append(np.abs(truth - at) < 1.2816 * np.sqrt(np.diag(covariance)))
    # 80 %; two standard errors are 7 %.
    assert 0.72 < np.mean(held) < 0.92


@pytest.mark.parametrize(("second", "contradict"), [(0.4, False), (-2.5, True)])
def test_sites_contradict_if_common_parameters_suit_none(second: float, contradict: bool) -> None:
    rng = np.random.default_rng(4)
    estimated = estimates_of([rocks((at, 0.0), 40, rng) for at in (0.6, second)], rng)
    assert contradicting(estimated, [1.1] * 2, [1.0] * 2, 1) == contradict
    # Certain, but not worth telling; and one site alone contradicts nobody.
    assert not contradicting(estimated, [1.01] * 2, [1.0] * 2, 1)
    assert not contradicting(estimated[:1], [1.1], [1.0], 1)


def test_samples_are_shares_with_the_prior_of_the_parameters() -> None:
    parameters = [
        ClassParameter(name, "mu_0", RANGES["mu_0"], 0.45, sd)
        for name, sd in (("a", 0.1), ("b", 0.2))
    ]
    pull = np.array([8.0, 0.0])
    estimated = Estimated(np.zeros(2), np.diag(pull), pull, pull[None], np.diag(pull))
    found = posterior_of(parameters, estimated, 1)
    one, other = fitted_parameters(parameters, found)
    # Of the first the rocks know more than the prior: a third of its width, and a value above it.
    assert one.identified and one.narrowed == pytest.approx(1.0 / 3.0, abs=0.03)
    assert one.value == pytest.approx(0.45 + 0.88 * 0.1 * 8.0 / 9.0, abs=1e-3)
    assert not other.identified and other.narrowed == pytest.approx(1.0, abs=0.05)
    assert other.value == pytest.approx(0.45, abs=0.002) and one.limit == other.limit == ""


def test_small_samples_widen() -> None:
    assert small_sample_factor(3) == pytest.approx((4.3027 / 1.95996) ** 2 * 1.5, rel=1e-3)
    assert small_sample_factor(10_000) == pytest.approx(1.0, abs=1e-3)
