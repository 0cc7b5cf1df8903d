from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sassgis.hazard.significance import beyond_sampling, chance_of_difference


def shares(counts: np.ndarray, blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Share of the blocks that arrive, and its variance."""
    p = counts / blocks
    return p, p * (1.0 - p) / blocks


@pytest.mark.parametrize("blocks", [(10_000, 10_000), (10_000, 2_000)])
def test_p_values_of_one_share_are_not_too_small(blocks: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    true = np.repeat([2e-4, 1e-3, 1e-2, 0.3], 20_000)
    one, two = (shares(rng.binomial(n, true), n) for n in blocks)
    p = chance_of_difference(
        (one[0], two[0]), (one[1], two[1]), (1 / blocks[0], 1 / blocks[1])
    ).reshape(4, -1)
    for level in (0.05, 0.005):
        assert np.all((p <= level).mean(axis=1) <= 1.3 * level)
    # Not idle either, where blocks are many.
    assert (p[3] <= 0.05).mean() > 0.04


def test_few_blocks_by_the_binomial_test() -> None:
    one, two = shares(np.array([9.0, 0.0, 3.0]), 1000), shares(np.array([0.0, 0.0, 3.0]), 1000)
    p = chance_of_difference((one[0], two[0]), (one[1], two[1]), (1e-3, 1e-3))
    np.testing.assert_allclose(p, [stats.binomtest(9, 9).pvalue, 1.0, 1.0], rtol=1e-3)
    # Blocks that stand for half as much: of nine, six are expected in the second sample.
    p = chance_of_difference((one[0], two[0]), (one[1], two[1]), (1e-3, 5e-4))
    assert p[0] == pytest.approx(2 * (1 / 3) ** 9, rel=1e-3)


def test_two_samples_of_the_same_differ_nowhere_in_nineteen_of_twenty() -> None:
    rng = np.random.default_rng(6)
    true = np.exp(rng.uniform(np.log(1e-4), np.log(0.1), 2000))
    found = 0
    for _ in range(200):
        one, two = (shares(rng.binomial(5000, true), 5000) for _ in range(2))
        found += beyond_sampling((one[0], two[0]), (one[1], two[1]), (2e-4, 2e-4)).any()
    assert found <= 18  # 10 expected at most


def test_what_is_found_is_rarely_by_chance() -> None:
    rng = np.random.default_rng(7)
    true = np.full(4000, 0.02)
    other = true.copy()
    other[:400] = 0.05
    one, two = (shares(rng.binomial(5000, p), 5000) for p in (true, other))
    found = beyond_sampling((one[0], two[0]), (one[1], two[1]), (2e-4, 2e-4))
    assert found[:400].mean() > 0.95
    assert found[400:].sum() <= 0.08 * found.sum()


def test_unknown_errors_find_nothing() -> None:
    values = (np.array([0.5]), np.array([np.nan]))
    assert not beyond_sampling(values, (np.array([np.nan]), np.zeros(1)), (1e-3, 1e-3)).any()
    assert not beyond_sampling((np.zeros(0),) * 2, (np.zeros(0),) * 2, (1e-3, 1e-3)).size
