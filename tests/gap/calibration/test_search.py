"""Emulator and posterior against what is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.gap.calibration.emulator import fit
from sassgis.gap.calibration.identifiability import identified_combinations, site_fits
from sassgis.gap.calibration.parameters import RANGES, ClassParameter, Prior
from sassgis.gap.calibration.search import (
    SiteScores,
    first_design,
    minimum_without,
    posterior_of,
    small_sample_factor,
    surface_of,
)


def bowl(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Each rock's squared distance from its own centre along the first parameter."""
    return 1.0 + (points[:, :1] - centres) ** 2


def wide(d: int, sd: float = 0.5) -> Prior:
    return Prior(np.full(d, 0.5), np.full(d, sd))


def emulated(centres: np.ndarray, prior: Prior | None = None):
    prior = wide(2) if prior is None else prior
    points = first_design(prior, 128, 1)
    own = SiteScores(np.array([0, 1]), bowl(points, centres))
    return points, surface_of(points, [own], prior, 128)


def test_emulator_meets_a_smooth_score_and_any_sum_of_rocks() -> None:
    rng = np.random.default_rng(2)
    centres = rng.normal(0.5, 0.1, 30)
    points = first_design(wide(3), 128, 1)
    made = fit(points, bowl(points, centres) + 0.01 * rng.standard_normal((128, 30)), 128)
    new = rng.random((40, 3))
    # The best half is met; what lies far from the best is only told to be bad.
    near = new[np.abs(new[:, 0] - 0.5) < 0.15]
    expected = bowl(near, centres).sum(axis=1)
    np.testing.assert_allclose(made.rocks(near).sum(axis=1), expected, atol=0.15)
    weights = rng.integers(0, 3, 30).astype(float)
    np.testing.assert_allclose(
        made.weighted(weights).value(new), made.rocks(new) @ weights, rtol=1e-9
    )


def test_gradient_of_the_emulator() -> None:
    _, surface = emulated(np.linspace(0.3, 0.6, 10))
    own = surface.total.sums[0]
    at = np.array([0.37, 0.62])
    step = 1e-6
    for k in range(2):
        beyond = at + step * np.eye(2)[k]
        slope = (own.value(beyond[None]) - own.value(at[None]))[0] / step
        assert own.gradient(at)[k] == pytest.approx(slope, rel=1e-3, abs=1e-4)


@pytest.mark.battery
def test_posterior_is_as_wide_as_the_mean_of_rocks_scatters() -> None:
    """Squared distances: the best is the mean of the centres, which scatters by sd/√n."""
    rng = np.random.default_rng(3)
    n, sd = 40, 0.15
    centres = rng.normal(0.45, sd, n)
    points, surface = emulated(centres)
    found = posterior_of(surface, points, 1)
    scatter = centres.std(ddof=1) / np.sqrt(n) * np.sqrt(small_sample_factor(n) * (n - 1) / n)
    assert found.best[0] == pytest.approx(centres.mean(), abs=0.3 * scatter)
    assert found.samples[:, 0].std() == pytest.approx(scatter, rel=0.3)
    # Nothing is known of the second parameter: the prior is left.
    assert found.best[1] == pytest.approx(0.5, abs=0.05)
    assert found.samples[:, 1].std() > 0.2
    ranges = RANGES["mu_0"]
    parameters = [
        ClassParameter("a", "mu_0", ranges, 0.475),
        ClassParameter("b", "mu_0", ranges, 0.475),
    ]
    assert identified_combinations(parameters, found) == 1


def test_a_prior_as_sharp_as_the_rocks_counts_as_much_as_they_do() -> None:
    """Normal prior and normal mean of the rocks: precisions add, means are weighted by them."""
    rng = np.random.default_rng(6)
    n, sd = 40, 0.3
    centres = rng.normal(0.6, sd, n)
    scatter = centres.std(ddof=1) / np.sqrt(n) * np.sqrt(small_sample_factor(n) * (n - 1) / n)
    points, surface = emulated(centres, wide(2, scatter))
    found = posterior_of(surface, points, 1)
    middle = 0.5 * (0.5 + centres.mean())
    assert found.best[0] == pytest.approx(middle, abs=0.3 * scatter)
    assert found.samples[:, 0].mean() == pytest.approx(middle, abs=0.3 * scatter)
    assert found.samples[:, 0].std() == pytest.approx(scatter / np.sqrt(2.0), rel=0.25)
    # With a prior of two and a half times the width, what the rocks say is nearly all.
    nearly = (centres.mean() + 0.5 / 2.5**2) / (1.0 + 1.0 / 2.5**2)
    assert found.of_scores[:, 0].mean() == pytest.approx(nearly, abs=0.3 * scatter)
    assert found.of_scores[:, 0].std() == pytest.approx(scatter, rel=0.3)
    assert found.samples[:, 1].std() == pytest.approx(scatter, rel=0.2)


def test_rocks_that_are_left_out_do_not_count() -> None:
    centres = np.r_[np.full(20, 0.4), np.full(20, 0.6)]
    points, surface = emulated(centres)
    found = posterior_of(surface, points, 1)
    for half, expected in ((slice(0, 20), 0.4), (slice(20, 40), 0.6)):
        weights = np.zeros(40)
        weights[half] = 1.0
        assert minimum_without(surface, found, [weights])[0] == pytest.approx(expected, abs=0.08)


@pytest.mark.battery
@pytest.mark.parametrize(
    ("second", "contradict"), [pytest.param(0.5, False, marks=pytest.mark.battery), (0.9, True)]
)
def test_sites_contradict_if_the_common_best_suits_none(second: float, contradict: bool) -> None:
    rng = np.random.default_rng(4)
    points = first_design(wide(2), 160, 1)
    scores = [
        SiteScores(np.array([0, 1]), bowl(points, rng.normal(mean, 0.1, 25)) * 4.0 - 3.9)
        for mean in (0.5, second)
    ]
    surface = surface_of(points, scores, wide(2), 160)
    found = posterior_of(surface, points, 1)
    fits, told = site_fits(("one", "two"), surface, found, 1)
    assert told == contradict
    assert all(f.own_score <= f.score + 1e-6 for f in fits)


def test_small_samples_widen() -> None:
    assert small_sample_factor(3) == pytest.approx((4.3027 / 1.95996) ** 2 * 1.5, rel=1e-3)
    assert small_sample_factor(10_000) == pytest.approx(1.0, abs=1e-3)
