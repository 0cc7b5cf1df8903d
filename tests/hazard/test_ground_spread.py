"""Draws of ground classes and the bands of what they find, against independent computations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from sassgis.hazard.ground_spread import draw_of, level_areas, spread_bands, spread_maps
from sassgis.hazard.sensitivity import FAR, Names, VariantFinding
from sassgis.model.ground_ranges import ParameterRange

#: The first is cut at 1, the largest share that an impact can keep.
RANGES = (
    ParameterRange("a", "eta_max", 0.9, 0.75, 1.0, "", False),
    ParameterRange("a", "mu_0", 0.5, 0.3, 0.6, "", True),
    ParameterRange("b", "mu_0", 0.5, 0.3, 0.6, "", True),
)


def drawn(ranges: tuple[ParameterRange, ...], n: int, seed: int = 5) -> np.ndarray:
    return np.array([list(draw_of(ranges, seed, k).values.values()) for k in range(n)])


def test_draws_are_normal_about_the_values_within_the_limits() -> None:
    values = drawn(RANGES, 2000)
    for r, own in zip(RANGES, values.T, strict=True):
        sd = (r.high - r.low) / 3.29
        top = (1.0 if r.parameter == "eta_max" else 10.0) - r.value
        expected = truncnorm(-r.value / sd, top / sd, r.value, sd)
        assert kstest(own, expected.cdf).pvalue > 0.01, r.label
    assert values[:, 0].max() <= 1.0
    assert np.abs(np.corrcoef(values.T)[np.triu_indices(3, 1)]).max() < 0.07


def test_a_draw_depends_on_seed_name_and_number_alone() -> None:
    values = drawn(RANGES, 3)
    assert drawn(RANGES[1:], 5)[:3].tolist() == values[:, 1:].tolist()
    assert not np.isin(drawn(RANGES, 3, seed=6), values).any()
    assert np.unique(values[:, 1:]).size == values[:, 1:].size


def test_values_of_a_class_go_together_where_the_table_says_so() -> None:
    up, against = (replace(r, together=word) for r, word in zip(RANGES, ("x", "-x"), strict=False))
    one, two = drawn((replace(up, value=0.5), against), 50).T
    shares = (one - 0.5) / up.sd, (two - 0.5) / against.sd
    assert shares[0] == pytest.approx(-shares[1], abs=1e-6)
    # Another class is another draw.
    other = drawn((replace(RANGES[2], together="x"),), 50)[:, 0]
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.5


def finding(rng: np.random.Generator, cells: int = 40) -> VariantFinding:
    """Blocks on some of the cells, with levels on others."""
    reached = np.flatnonzero(rng.random(cells) < 0.7)
    zoned = np.flatnonzero(rng.random(cells) < 0.7)
    none = np.empty(0)
    return VariantFinding(
        100, rng.integers(1, 9, 60), reached, np.full(reached.size, 10.0),
        rng.integers(1, 90, reached.size), zoned, rng.integers(1, 5, zoned.size),
        np.array([rng.choice([np.nan, 50.0])]), np.array([0.5]), none, none,
    )  # fmt: skip


def test_maps_hold_the_quantiles_of_each_cell() -> None:
    rng = np.random.default_rng(1)
    base, *draws = (finding(rng) for _ in range(8))
    maps = spread_maps(base, lambda: iter(draws))
    assert maps.cells.size == 40
    for i in range(40):
        reach = [dict(zip(f.cells, f.reach, strict=True)).get(i, 0) / 100 for f in draws]
        level = sorted(dict(zip(f.places, f.level, strict=True)).get(i, 0) for f in draws)
        assert maps.reach_low[i] == pytest.approx(np.percentile(reach, 10), rel=1e-6)
        assert maps.reach_high[i] == pytest.approx(np.percentile(reach, 90), rel=1e-6)
        # 10 and 90 % lie 0.6 beyond the outermost of seven: those two are the outer neighbours.
        assert (maps.level_low[i], maps.level_high[i]) == (level[0], level[-1])
    parts = spread_maps(base, lambda: iter(draws), at_once=20)
    for name in ("reach_low", "reach_high", "level_low", "level_high"):
        assert np.array_equal(getattr(parts, name), getattr(maps, name)), name
    areas = level_areas(maps, 4.0)
    zoned = dict(zip(base.places, base.level, strict=True))
    assert areas.zoned == 4.0 * len(zoned)
    assert areas.higher == 4.0 * sum(maps.level_high[i] > own for i, own in zoned.items())
    assert areas.lower == 4.0 * sum(maps.level_low[i] < own for i, own in zoned.items())
    assert areas.beyond == 4.0 * sum(maps.level_high[i] > 0 for i in range(40) if i not in zoned)


def test_bands_of_measures_and_energy_zero_where_no_block_arrives() -> None:
    rng = np.random.default_rng(2)
    base, *draws = (finding(rng) for _ in range(12))
    bands = {b.measure: b for b in spread_bands(base, lambda: draws, Names((), ("road",), ()), 4.0)}
    far = [np.percentile(np.repeat(np.arange(60), f.runout), 90) for f in draws]
    # Within a bin of a metre the blocks are spread evenly.
    assert bands[FAR].low == pytest.approx(np.percentile(far, 10), abs=1.0)
    assert bands[FAR].high == pytest.approx(np.percentile(far, 90), abs=1.0)
    energy = np.nan_to_num([f.line_energy_kj[0] for f in draws])
    assert 0.0 < energy.mean() < 50.0
    band = bands["energy (95 %) at road"]
    assert [band.low, band.middle, band.high] == np.percentile(energy, [10, 50, 90]).tolist()


def test_without_spread_a_band_is_the_base() -> None:
    base = finding(np.random.default_rng(3))
    maps = spread_maps(base, lambda: [base] * 5)
    assert np.array_equal(maps.reach_low, maps.reach_high)
    own = np.isin(maps.cells, base.cells)
    assert maps.reach_low[own].tolist() == (base.reach / 100).astype(np.float32).tolist()
    assert np.array_equal(maps.level_low, maps.level) and np.array_equal(
        maps.level_high, maps.level
    )
    for band in spread_bands(base, lambda: [base] * 5, Names((), ("road",), ()), 4.0):
        assert np.array_equal([band.low, band.high], [band.base] * 2, equal_nan=True), band.measure
