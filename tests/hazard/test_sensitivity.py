"""What simulations of a design say together, on a handful of cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sassgis.hazard.sensitivity import (
    Names,
    Variant,
    VariantFinding,
    design,
    effects,
    farthest,
    sensitivity_maps,
)
from sassgis.model.ground_ranges import ParameterRange

RANGES = (
    ParameterRange("a", "eta_max", 0.5, 0.4, 0.8, "", False),
    ParameterRange("a", "mu_0", 0.5, 0.3, 0.6, "", True),
)
N = 20


def finding(
    runout_m: int = 50, energy: float = 100.0, level: int = 1, cells: int = N
) -> VariantFinding:
    runout = np.zeros(runout_m + 1, np.int64)
    runout[runout_m] = 100
    every = np.arange(cells, dtype=np.int64)
    return VariantFinding(
        100, runout, every, np.full(cells, energy), np.full(cells, 10), every,
        np.full(cells, level, np.int64), np.array([energy]), np.array([0.5]), np.array([0.1]),
        np.array([3.0 * energy]),
    )  # fmt: skip


def test_the_design_fills_each_range_evenly() -> None:
    ends, filling = design(RANGES, 10, 1)
    assert [v.values for v in ends] == [
        {("a", "eta_max"): 0.4}, {("a", "eta_max"): 0.8}, {("a", "mu_0"): 0.3}, {("a", "mu_0"): 0.6}
    ]  # fmt: skip
    for r in RANGES:
        drawn = [v.values["a", r.parameter] for v in filling]
        tenth = np.floor(10 * (np.array(drawn) - r.low) / (r.high - r.low))
        assert sorted(tenth.tolist()) == list(range(10))
    assert design(RANGES, 10, 1) == (ends, filling) != design(RANGES, 10, 2)
    assert farthest(RANGES).values == {("a", "eta_max"): 0.8, ("a", "mu_0"): 0.3}


def test_effects_are_those_of_the_ends() -> None:
    base, chance = finding(), finding(51)
    ends = [finding(40), finding(80, 200.0), finding(50), finding(52)]
    filling = [
        (Variant("", {("a", "eta_max"): 0.1 * i, ("a", "mu_0"): 1.0 - 0.1 * i}), finding(40 + i))
        for i in range(5)
    ]
    names = Names(("low",), ("road",), ("house",))
    found = {
        (e.range.parameter, e.measure): e
        for e in effects(RANGES, base, chance, ends, filling, names, 4.0)
    }
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
    base = finding(cells=N)
    up, wide = finding(level=3, energy=300.0), finding(level=1, cells=2 * N)
    down = finding(level=0, energy=50.0)
    maps = sensitivity_maps(base, base, [base] * 4, [up, wide, down, base])
    assert maps.cells.tolist() == list(range(2 * N))
    assert maps.level[:N].tolist() == [1] * N and not maps.level[N:].any()
    assert (maps.level_highest[0], maps.level_lowest[0], maps.level_highest[-1]) == (3, 0, 1)
    # Beyond the base one of four simulations has a level at all.
    assert (maps.higher[0], maps.lower[0], maps.higher[-1]) == (0.25, 0.25, 0.25)
    assert (maps.reached[0], maps.reached[-1]) == (1.0, 0.25)
    assert maps.reached_base.sum() == N
    want = np.quantile(np.log([3.0, 1.0, 0.5, 1.0]), [0.1, 0.5, 0.9])
    assert maps.energy_ratio[:, 0] == pytest.approx(np.exp(want), rel=1e-5)
    assert np.isnan(maps.energy_ratio[:, -1]).all()


def test_the_strongest_parameter_must_do_more_than_another_seed() -> None:
    base, chance = finding(), finding(energy=110.0)
    ends = [finding(energy=e) for e in (105.0, 95.0, 100.0, 130.0)]
    maps = sensitivity_maps(base, chance, ends, [base])
    assert (maps.strongest == 2).all()
    quiet = sensitivity_maps(base, chance, [*ends[:3], base], [base])
    assert not quiet.strongest.any()


def test_without_levels_there_are_none() -> None:
    none = np.empty(0, np.int64)
    base = replace(finding(), places=none, level=none)
    maps = sensitivity_maps(base, base, [base] * 4, [base])
    assert not maps.level_highest.any() and not maps.higher.any()


def test_a_finding_is_the_same_after_saving() -> None:
    found = finding()
    again = VariantFinding.from_arrays(found.arrays())
    for name, array in found.arrays().items():
        assert np.array_equal(getattr(again, name), array), name
    assert isinstance(again.blocks, int)
