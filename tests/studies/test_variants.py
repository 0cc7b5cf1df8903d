"""Designs and draws of variants, and what they say together, against independent computations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from sassgis.settings.ground import ParameterRange
from sassgis.studies.variants import (
    FAR,
    Variant,
    VariantFinding,
    answers,
    draw_of,
    effects,
    ends_of,
    farthest,
    filling,
    level_areas,
    sensitivity_maps,
    spread_bands,
    spread_maps,
)

RANGES = (
    ParameterRange("a", "eta_max", 0.5, 0.4, 0.8, "", False),
    ParameterRange("a", "mu_0", 0.5, 0.3, 0.6, "", True),
)
#: The first is cut at 1, the largest share that an impact can keep.
DRAWN = (
    ParameterRange("a", "eta_max", 0.9, 0.75, 1.0, "", False),
    ParameterRange("a", "mu_0", 0.5, 0.3, 0.6, "", True),
    ParameterRange("b", "mu_0", 0.5, 0.3, 0.6, "", True),
)
N = 20
NONE = np.empty(0)


# --- a sensitivity --------------------------------------------------------------------------


def finding(
    runout_m: int = 50, energy: float = 100.0, level: int = 1, cells: int = N
) -> VariantFinding:
    runout = np.zeros(runout_m + 1, np.int64)
    runout[runout_m] = 100
    every = np.arange(cells, dtype=np.int64)
    return VariantFinding(
        runout, every, np.full(cells, energy), np.full(cells, 10), every,
        np.full(cells, level, np.int64), np.array([energy]), np.array([0.5]), np.array([0.1]),
        np.array([3.0 * energy]),
    )  # fmt: skip


def test_the_design_fills_each_range_evenly() -> None:
    assert [v.values for v in ends_of(RANGES)] == [
        {("a", "eta_max"): 0.4}, {("a", "eta_max"): 0.8}, {("a", "mu_0"): 0.3}, {("a", "mu_0"): 0.6}
    ]  # fmt: skip
    points = filling(RANGES, 10, 1)
    for r in RANGES:
        drawn = [v.values["a", r.parameter] for v in points]
        tenth = np.floor(10 * (np.array(drawn) - r.low) / (r.high - r.low))
        assert sorted(tenth.tolist()) == list(range(10))
    assert filling(RANGES, 10, 1) == points != filling(RANGES, 10, 2)
    assert farthest(RANGES).values == {("a", "eta_max"): 0.8, ("a", "mu_0"): 0.3}


def test_effects_are_those_of_the_ends() -> None:
    base = finding()
    ends = [finding(40), finding(80, 200.0), finding(50), finding(52)]
    # Another seed, and the farthest, which does not count.
    done = [(Variant(""), found) for found in (finding(51), finding(99), *ends)]
    done += [
        (Variant("", {("a", "eta_max"): 0.1 * i, ("a", "mu_0"): 1.0 - 0.1 * i}), finding(40 + i))
        for i in range(5)
    ]
    table = answers(base, done, (("low",), ("road",), ("house",)), 4.0)
    found = {(e.range.parameter, e.measure): e for e in effects(RANGES, table)}
    run_out = found["eta_max", "run-out (95 %)"]
    assert (run_out.low, run_out.high) == pytest.approx((40.95, 80.95))
    assert run_out.largest_change == pytest.approx(30.0 / 50.95)
    assert run_out.beyond_chance and run_out.correlation == pytest.approx(1.0)
    weak = found["mu_0", "run-out (95 %)"]
    # Two metres, where another seed makes one.
    assert not weak.beyond_chance and weak.correlation == pytest.approx(-1.0)
    assert found["eta_max", "energy (95 %) on the map, over the base"].high == pytest.approx(2.0)
    assert found["eta_max", "energy (95 %) at road"].high == 200.0
    assert found["eta_max", "energy (95 %) at house"].high == 600.0
    assert found["mu_0", "reached area"].base == found["mu_0", "area of level low"].base == 4.0 * N
    assert found["mu_0", "share of blocks that reach house"].base == 0.1
    assert np.isnan(found["mu_0", "share of blocks that reach house"].correlation)


def test_maps_of_levels_reach_and_energy() -> None:
    base, farther = finding(cells=N), finding(cells=3 * N)
    up, wide = finding(level=3, energy=300.0), finding(level=1, cells=2 * N)
    down = finding(level=0, energy=50.0)
    cells, maps = sensitivity_maps([base, base, farther, *[base] * 4, up, wide, down, base], 2)
    assert cells.tolist() == list(range(2 * N))
    level, changed = maps["level_could_be"], maps["level_higher"]
    assert level["base"][:N].tolist() == [1] * N and not level["base"][N:].any()
    assert (level["highest"][0], level["lowest"][0], level["highest"][-1]) == (3, 0, 1)
    # Beyond the base one of four simulations has a level at all.
    assert (changed["higher"][0], changed["lower"][0], changed["higher"][-1]) == (0.25, 0.25, 0.25)
    reach = maps["reach_share"]
    assert (reach["share"][0], reach["share"][-1], reach["base"].sum()) == (1.0, 0.25, N)
    want = np.exp(np.quantile(np.log([3.0, 1.0, 0.5, 1.0]), [0.1, 0.5, 0.9]))
    energy = maps["energy_ratio"]
    assert [energy[q][0] for q in ("q10", "q50", "q90")] == pytest.approx(want, rel=1e-5)
    assert np.isnan(energy["q50"][-1])


def test_the_strongest_parameter_must_do_more_than_another_seed() -> None:
    base, chance = finding(), finding(energy=110.0)
    ends = [finding(energy=e) for e in (105.0, 95.0, 100.0, 130.0)]

    def strongest(last: VariantFinding) -> np.ndarray:
        _, maps = sensitivity_maps([base, chance, base, *ends[:3], last, base], 2)
        return maps["strongest_parameter"]["strongest"]

    assert (strongest(ends[3]) == 2).all()
    assert not strongest(base).any()


def test_without_levels_there_are_none() -> None:
    none = np.empty(0, np.int64)
    base = replace(finding(), places=none, level=none)
    _, maps = sensitivity_maps([base] * 8, 2)
    assert not maps["level_could_be"]["highest"].any() and not maps["level_higher"]["higher"].any()


# --- draws ----------------------------------------------------------------------------------


def drawn(ranges: tuple[ParameterRange, ...], n: int, seed: int = 5) -> np.ndarray:
    return np.array([list(draw_of(ranges, seed, k).values.values()) for k in range(n)])


def test_draws_are_normal_about_the_values_within_the_limits() -> None:
    values = drawn(DRAWN, 2000)
    for r, own in zip(DRAWN, values.T, strict=True):
        sd = (r.high - r.low) / 3.29
        top = (1.0 if r.parameter == "eta_max" else 10.0) - r.value
        expected = truncnorm(-r.value / sd, top / sd, r.value, sd)
        assert kstest(own, expected.cdf).pvalue > 0.01, r.label
    assert values[:, 0].max() <= 1.0
    assert np.abs(np.corrcoef(values.T)[np.triu_indices(3, 1)]).max() < 0.07


def test_a_draw_depends_on_seed_name_and_number_alone() -> None:
    values = drawn(DRAWN, 3)
    assert drawn(DRAWN[1:], 5)[:3].tolist() == values[:, 1:].tolist()
    assert not np.isin(drawn(DRAWN, 3, seed=6), values).any()
    assert np.unique(values[:, 1:]).size == values[:, 1:].size


def test_values_of_a_class_go_together_where_the_table_says_so() -> None:
    up, against = (replace(r, together=word) for r, word in zip(DRAWN, ("x", "-x"), strict=False))
    one, two = drawn((replace(up, value=0.5), against), 50).T
    shares = (one - 0.5) / up.sd, (two - 0.5) / against.sd
    assert shares[0] == pytest.approx(-shares[1], abs=1e-6)
    # Another class is another draw.
    other = drawn((replace(DRAWN[2], together="x"),), 50)[:, 0]
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.5


def any_finding(rng: np.random.Generator, cells: int = 40) -> VariantFinding:
    """Blocks on some of the cells, with levels on others."""
    reached = np.flatnonzero(rng.random(cells) < 0.7)
    zoned = np.flatnonzero(rng.random(cells) < 0.7)
    return VariantFinding(
        rng.integers(1, 9, 60), reached, np.full(reached.size, 10.0),
        rng.integers(1, 90, reached.size), zoned, rng.integers(1, 5, zoned.size),
        np.array([rng.choice([np.nan, 50.0])]), np.array([0.5]), NONE, NONE,
    )  # fmt: skip


def test_maps_hold_the_quantiles_of_each_cell() -> None:
    rng = np.random.default_rng(1)
    base, *draws = (any_finding(rng) for _ in range(8))
    cells, maps = spread_maps(base, lambda: iter(draws))
    assert cells.size == 40
    levels, reached = maps["ground_level"], maps["ground_reach"]
    for i in range(40):
        reach = [dict(zip(f.cells, f.reach, strict=True)).get(i, 0) / f.blocks for f in draws]
        level = sorted(dict(zip(f.places, f.level, strict=True)).get(i, 0) for f in draws)
        assert reached["low"][i] == pytest.approx(np.percentile(reach, 10), rel=1e-6)
        assert reached["high"][i] == pytest.approx(np.percentile(reach, 90), rel=1e-6)
        # 10 and 90 % lie 0.6 beyond the outermost of seven: those two are the outer neighbours.
        assert (levels["low"][i], levels["high"][i]) == (level[0], level[-1])
    _, in_parts = spread_maps(base, lambda: iter(draws), at_once=20)
    for key, bands in maps.items():
        for name, values in bands.items():
            assert np.array_equal(in_parts[key][name], values), (key, name)
    areas = level_areas(spread_maps(base, lambda: draws), 4.0)
    zoned = dict(zip(base.places, base.level, strict=True))
    assert areas == {
        "zoned": 4.0 * len(zoned),
        "higher": 4.0 * sum(levels["high"][i] > own for i, own in zoned.items()),
        "lower": 4.0 * sum(levels["low"][i] < own for i, own in zoned.items()),
        "beyond": 4.0 * sum(levels["high"][i] > 0 for i in range(40) if i not in zoned),
    }


def test_bands_of_measures_and_energy_zero_where_no_block_arrives() -> None:
    rng = np.random.default_rng(2)
    base, *draws = (any_finding(rng) for _ in range(12))
    done = [(Variant(""), own) for own in draws]
    table = answers(base, done, ((), ("road",), ()), 4.0)
    bands = {b.measure: b for b in spread_bands(table)}
    far = [np.percentile(np.repeat(np.arange(60), f.runout), 90) for f in draws]
    # Within a bin of a metre the blocks are spread evenly.
    assert bands[FAR].low == pytest.approx(np.percentile(far, 10), abs=1.0)
    assert bands[FAR].high == pytest.approx(np.percentile(far, 90), abs=1.0)
    energy = np.nan_to_num([f.line_energy_kj[0] for f in draws])
    assert 0.0 < energy.mean() < 50.0
    band = bands["energy (95 %) at road"]
    assert [band.low, band.middle, band.high] == np.percentile(energy, [10, 50, 90]).tolist()


def test_without_spread_a_band_is_the_base() -> None:
    base = any_finding(np.random.default_rng(3))
    cells, maps = spread_maps(base, lambda: [base] * 5)
    reach, level = maps["ground_reach"], maps["ground_level"]
    assert np.array_equal(reach["low"], reach["high"])
    own = np.isin(cells, base.cells)
    assert reach["low"][own].tolist() == (base.reach / base.blocks).astype(np.float32).tolist()
    assert np.array_equal(level["low"], level["base"])
    assert np.array_equal(level["high"], level["base"])
    table = answers(base, [(Variant(""), base)] * 5, ((), ("road",), ()), 4.0)
    for band in spread_bands(table):
        assert np.array_equal([band.low, band.high], [band.base] * 2, equal_nan=True), band.measure
