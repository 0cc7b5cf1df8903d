"""Whether two samples differ by more than sampling explains."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from sassgis.hazard.significance import SampledRates, beyond_sampling, chance_of_difference


def shares(counts: np.ndarray, blocks: int, of_a_block: float | None = None) -> SampledRates:
    """Share of the blocks that arrive."""
    p = counts / blocks
    return SampledRates(p, p * (1.0 - p) / blocks, of_a_block or 1.0 / blocks)


@pytest.mark.parametrize("blocks", [(10_000, 10_000), (10_000, 2_000)])
def test_p_values_of_one_share_are_not_too_small(blocks: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    true = np.repeat([2e-4, 1e-3, 1e-2, 0.3], 20_000)
    p = chance_of_difference(*(shares(rng.binomial(n, true), n) for n in blocks)).reshape(4, -1)
    for level in (0.05, 0.005):
        assert np.all((p <= level).mean(axis=1) <= 1.3 * level)
    # Not idle either, where blocks are many.
    assert (p[3] <= 0.05).mean() > 0.04


def test_few_blocks_by_the_binomial_test() -> None:
    counts = np.array([9.0, 0.0, 3.0]), np.array([0.0, 0.0, 3.0])
    p = chance_of_difference(*(shares(k, 1000) for k in counts))
    np.testing.assert_allclose(p, [stats.binomtest(9, 9).pvalue, 1.0, 1.0], rtol=1e-3)
    # Blocks that stand for half as much: of nine, six are expected in the second sample.
    p = chance_of_difference(shares(counts[0], 1000), shares(counts[1], 1000, 5e-4))
    assert p[0] == pytest.approx(2 * (1 / 3) ** 9, rel=1e-3)


def test_two_samples_of_the_same_differ_nowhere_in_nineteen_of_twenty() -> None:
    rng = np.random.default_rng(6)
    true = np.exp(rng.uniform(np.log(1e-4), np.log(0.1), 2000))
    found = sum(
        beyond_sampling(*(shares(rng.binomial(5000, true), 5000) for _ in range(2))).any()
        for _ in range(200)
    )
    assert found <= 18  # 10 expected at most


def test_what_is_found_is_rarely_by_chance() -> None:
    rng = np.random.default_rng(7)
    true = np.full(4000, 0.02)
    other = true.copy()
    other[:400] = 0.05
    found = beyond_sampling(*(shares(rng.binomial(5000, p), 5000) for p in (true, other)))
    assert found[:400].mean() > 0.95
    assert found[400:].sum() <= 0.08 * found.sum()


def test_unknown_errors_find_nothing() -> None:
    unknown = SampledRates(np.array([0.5]), np.array([math.nan]), 1e-3)
    assert not beyond_sampling(unknown, SampledRates(np.zeros(1), np.zeros(1), 1e-3)).any()
    none = SampledRates(np.zeros(0), np.zeros(0), 1e-3)
    assert not beyond_sampling(none, none).size
