from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.hazard_samples import BLUE, RED, RESIDUAL, YELLOW, chances_of, curves_of, swiss
from hypothesis import given
from hypothesis import strategies as st

from sassgis.errors import InputError
from sassgis.hazard.curves import meets
from sassgis.hazard.levels import deciding_energy, hazard_level, intensity_class
from sassgis.hazard.sampling_error import rocks_factor
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset

#: All that arrives has a level; and only what is not rarer than once in 10,000 years.
PRESET = swiss()
FLOOR = replace(PRESET, rarest_years=10_000.0)


def factor(curves: HazardCurves, preset: HazardPreset = PRESET) -> np.ndarray:
    return rocks_factor(curves, preset, chances_of(curves, preset), 0.95)


@pytest.mark.parametrize(
    ("rates", "level", "column"),
    [
        # Once in 50 years a rock, always weak: low intensity, 30 to 100 years.
        ((1 / 50, 0, 0), BLUE, 0),
        ((1 / 200, 0, 0), YELLOW, 0),
        ((1 / 301, 0, 0), RESIDUAL, 0),
        # Limits belong to the class below them.
        ((1 / 300, 0, 0), YELLOW, 0),
        ((1 / 100, 0, 0), BLUE, 0),
        ((1 / 100, 1 / 300, 0), BLUE, 0),
        ((1 / 30, 1 / 30, 0), RED, 1),
        ((1 / 30, 1 / 31, 0), BLUE, 0),
        # Mean intensity once in 250 years beats low intensity once in 120.
        ((1 / 120, 1 / 250, 1 / 1000), BLUE, 1),
        ((1 / 20, 1 / 40, 1 / 299), RED, 2),
        ((10.0, 1.0, 1.0), RED, 1),
        ((10.0, 0.02, 1 / 301), BLUE, 0),
        ((1e-9, 1e-9, 1e-9), RESIDUAL, 0),
    ],
)
def test_level_by_hand(rates: tuple[float, ...], level: int, column: int) -> None:
    curves = curves_of([rates])
    assert hazard_level(curves, PRESET).tolist() == [level + 1]
    assert deciding_energy(curves, PRESET).tolist() == [column]


def test_places_without_rocks() -> None:
    curves = curves_of([[0.0, 0.0, 0.0]], 0.0, 0.0)
    assert hazard_level(curves, PRESET).tolist() == [0]
    assert intensity_class(curves, PRESET, None).tolist() == [0]
    assert deciding_energy(curves, PRESET).tolist() == [-1]
    assert [x.tolist() for x in chances_of(curves, PRESET).interval(0.95)] == [[0], [0]]
    assert factor(curves).tolist() == [1.0]
    nothing = curves_of(np.zeros((0, 3)))
    assert hazard_level(nothing, PRESET).shape == (0,)
    assert factor(nothing).shape == (0,)


def test_intensity_by_hand() -> None:
    curves = curves_of([[1 / 20, 1 / 100, 1 / 1000], [1 / 31, 0, 0], [1 / 30, 1 / 30, 1 / 30]])
    assert intensity_class(curves, PRESET, 30.0).tolist() == [1, 0, 3]
    assert intensity_class(curves, PRESET, 100.0).tolist() == [2, 1, 3]
    assert intensity_class(curves, PRESET, 300.0).tolist() == [2, 1, 3]
    assert intensity_class(curves, PRESET, None).tolist() == [3, 1, 3]


rate = st.one_of(
    st.just(0.0), st.floats(1e-6, 1.0), st.sampled_from([1 / 30, 1 / 100, 1 / 300, 0.1])
)
falling = st.lists(rate, min_size=3, max_size=3).map(lambda r: sorted(r, reverse=True))


@given(falling, st.floats(1.0, 1e4), st.floats(1.0, 100.0))
def test_rarer_events_are_at_least_as_intense(r: list[float], years: float, by: float) -> None:
    curves = curves_of([r])
    often = intensity_class(curves, PRESET, years)
    rare = intensity_class(curves, PRESET, years * by)
    assert often[0] <= rare[0] <= intensity_class(curves, PRESET, None)[0]


fine = st.lists(rate, min_size=40, max_size=40).map(lambda r: sorted(r, reverse=True))


@given(fine)
def test_level_is_the_worst_that_a_fine_curve_crosses(r: list[float]) -> None:
    """Every point (e, λ(E >= e)) of the curve looked up in the matrix, one by one."""
    energies = np.unique([0.0, 30.0, 300.0, *np.geomspace(1.0, 2000.0, 37)])
    curves = curves_of([r[: energies.size]], energies=energies)
    worst = 0
    for energy, at in zip(energies, curves.rate[0], strict=True):
        if at == 0.0:
            continue
        i = 2 if energy >= 300.0 else 1 if energy >= 30.0 else 0
        j = next((j for j, t in enumerate((30.0, 100.0, 300.0)) if meets(at, t)), 3)
        worst = max(worst, PRESET.matrix[i][j] + 1)
    assert hazard_level(curves, PRESET).tolist() == [worst]


# ---------------------------------------------------------------------------------------------
# How sure it is


def counted(count: list[list[int]], w: float) -> HazardCurves:
    """Curves of rare rocks of one source, each of which stands for w."""
    k = np.array(count, np.float64)
    return curves_of(k * w, k * w * w, w)


def test_chance_is_that_of_two_samples_of_one_poisson_rate() -> None:
    """Where the rate is anything alike in its logarithm, pairs of samples by brute force."""
    w, k = 1 / 3000, 10  # ten blocks are once in 300 years: yellow from there on
    rng = np.random.default_rng(8)
    mean = np.exp(rng.uniform(np.log(0.1), np.log(200.0), 400_000))
    one, other = rng.poisson(mean), rng.poisson(mean)
    for n in (5, 9, 10, 14):
        seen = other[one == n] >= k
        chance = chances_of(counted([[n, 0, 0]], w), PRESET).at_least[0, YELLOW + 1]
        assert abs(seen.mean() - chance) < 4.0 * 0.5 / np.sqrt(seen.size)


def test_as_many_cells_rise_as_fall() -> None:
    """Over many places with rates of all sizes the stated share is what a second sample changes."""
    rng = np.random.default_rng(9)
    mean = np.exp(rng.uniform(np.log(0.05), np.log(5000.0), 60_000))
    one, other = (
        counted(np.c_[n, 0 * n, 0 * n].tolist(), 2e-5)
        for n in (rng.poisson(mean), rng.poisson(mean))
    )
    levels = [hazard_level(c, FLOOR) for c in (one, other)]
    changed = (levels[0] != levels[1]).sum() / (levels[0] > 0).sum()
    assert chances_of(one, FLOOR).changed_share == pytest.approx(changed, rel=0.05)
    caught = chances_of(one, FLOOR).uncertain(0.95)[levels[0] != levels[1]].mean()
    assert 0.9 <= caught <= 0.98


def tracks(rng: np.random.Generator, shape: tuple[int, int], blocks: int) -> np.ndarray:
    """How many of some blocks come to each cell: straight down, then scattered to both sides."""
    col = shape[1] / 2 + np.cumsum(rng.normal(0.0, 1.5, (blocks, shape[0])), axis=1)
    stop = rng.geometric(1.0 / (0.4 * shape[0]), blocks)[:, None]
    row = np.broadcast_to(np.arange(shape[0]), col.shape)
    there = (row < stop) & (col >= 0) & (col < shape[1])
    count = np.zeros(shape, np.int64)
    np.add.at(count, (row[there], col[there].astype(int)), 1)
    return count


@pytest.mark.parametrize("blocks", [40, 400])
def test_what_another_sample_reaches_first_is_said_too(blocks: int) -> None:
    """Pairs of samples of which one block is a level: what they change lies where it was said."""
    rng, shape, w = np.random.default_rng(blocks), (120, 90), 1.0 / 400
    known = np.ones(shape, bool)
    stated, changed, caught, new = [], [], [], []
    for _ in range(10):
        levels = []
        for count in (tracks(rng, shape, blocks), tracks(rng, shape, blocks)):
            cells = np.flatnonzero(count)
            few = counted(np.c_[count.ravel()[cells], 0 * cells, 0 * cells].tolist(), w)
            few = replace(few, places=cells)
            level = np.zeros(count.size)
            level[cells] = hazard_level(few, FLOOR)
            levels.append(level)
            chances = chances_of(few, FLOOR, known)
        unsure = np.zeros(known.size, bool)
        unsure[chances.places] = chances.uncertain(0.95)
        differ = levels[0] != levels[1]
        new.append([chances.raised.sum(), (levels[0] > levels[1]).sum()])
        stated.append(chances.changed_share)
        changed.append(differ.sum() / (levels[1] > 0).sum())
        caught.append((differ & unsure).sum() / differ.sum())
    assert np.mean(stated) == pytest.approx(np.mean(changed), rel=0.1)
    assert np.divide(*np.sum(new, axis=0)) == pytest.approx(1.0, abs=0.3)
    assert np.mean(caught) >= 0.9 and unsure.mean() < 0.85
    # Nothing is said of cells without a height.
    known[:, :45] = False
    few = chances_of(few, FLOOR, known).places
    assert not np.setdiff1d(few[few % 90 < 45], cells).size


def test_many_rocks_decide_few_do_not() -> None:
    w = 1 / 1000
    # Low intensity 40 times in 1000 years: T = 25 years, blue; yellow is below 10. Six times are
    # yellow; residual below 3.3 and blue from 10 on are both possible.
    curves = counted([[40, 0, 0], [6, 0, 0]], w)
    lowest, highest = chances_of(curves, PRESET).interval(0.95)
    assert lowest.tolist() == [BLUE + 1, RESIDUAL + 1]
    assert highest.tolist() == [BLUE + 1, BLUE + 1]
    assert chances_of(curves, PRESET).uncertain(0.95).tolist() == [False, True]
    # 20 times the blocks: 80 of them, with 66.7 for 300 years and 200 for 100 years.
    more = counted([[80, 0, 0], [100, 0, 0]], w / 20)
    assert chances_of(more, PRESET).uncertain(0.95).tolist() == [True, False]


def test_without_a_rarest_event_few_blocks_leave_it_open_whether_any_comes() -> None:
    curves = counted([[1, 0, 0], [9, 0, 0]], 1e-6)
    lowest, highest = chances_of(curves, PRESET).interval(0.95)
    assert lowest.tolist() == [0, RESIDUAL + 1]
    assert highest.tolist() == [RESIDUAL + 1] * 2
    np.testing.assert_allclose(chances_of(curves, PRESET).changed, [0.5, 0.5**9], rtol=0.05)


def test_rarer_than_the_rarest_event_has_no_level() -> None:
    curves = counted([[1, 0, 0], [5, 0, 0], [40, 0, 0]], 2e-5)  # five blocks: once in 10,000 years
    assert hazard_level(curves, FLOOR).tolist() == [0, RESIDUAL + 1, RESIDUAL + 1]
    assert intensity_class(curves, FLOOR, None).tolist() == [0, 1, 1]
    assert deciding_energy(curves, FLOOR).tolist() == [-1, 0, 0]
    lowest, highest = chances_of(curves, FLOOR).interval(0.95)
    assert (lowest != highest).tolist() == [False, True, False]
    with pytest.raises(InputError, match="within the classes of return period"):
        replace(PRESET, rarest_years=300.0)


def test_an_unknown_variance_leaves_everything_open() -> None:
    curves = curves_of([[0.02, 0.0, 0.0]], [[np.nan, 0.0, 0.0]], 1e-9)
    lowest, highest = chances_of(curves, PRESET).interval(0.95)
    assert (lowest[0], highest[0]) == (0, BLUE + 1)
    assert np.isnan(factor(curves)[0])
    # Unless other classes of intensity decide.
    red = curves_of([[1.0, 1.0, 1.0]], [[np.nan, 0.0, 0.0]], 1e-9)
    assert not chances_of(red, PRESET).uncertain(0.95)[0]


@given(
    st.lists(st.integers(0, 400), min_size=3, max_size=3).map(lambda c: sorted(c, reverse=True)),
    st.sampled_from([1e-2, 1e-3, 1e-4, 1e-5]),
    st.floats(0.5, 0.99),
)
def test_level_lies_in_its_interval(count: list[int], w: float, confidence: float) -> None:
    curves = counted([count], w)
    lowest, highest = chances_of(curves, PRESET).interval(confidence)
    level = hazard_level(curves, PRESET)
    assert lowest[0] <= level[0] <= highest[0]
    wider = chances_of(curves, PRESET).interval(0.5 + 0.5 * confidence)
    assert wider[0][0] <= lowest[0] <= highest[0] <= wider[1][0]


@given(
    st.lists(st.integers(40, 400), min_size=3, max_size=3).map(lambda c: sorted(c, reverse=True)),
    st.sampled_from([1e-3, 1e-4, 3e-5]),
)
def test_the_factor_of_rocks_about_decides(count: list[int], w: float) -> None:
    curves = counted([count], w)
    times = float(factor(curves)[0])

    def with_rocks(more: float) -> bool:
        rarer = replace(curves, variance=curves.variance / more)
        lowest, highest = chances_of(rarer, PRESET).interval(0.95)
        return bool(lowest[0] == highest[0])

    if with_rocks(1.0):
        assert times == 1.0
    elif np.isinf(times):
        assert not with_rocks(1e5)
    else:
        assert with_rocks(1.3 * times)
        assert times < 1.5 or not with_rocks(times / 1.3)


def test_no_sample_decides_a_rate_on_a_limit() -> None:
    k = 10
    curves = counted([[k, 0, 0]], 1 / (300.0 * k))
    assert hazard_level(curves, PRESET).tolist() == [YELLOW + 1]
    assert factor(curves).tolist() == [np.inf]


def test_the_factor_by_hand() -> None:
    # 80 blocks of 1/20000: 1/250 a year, short of 1/300 by 1/1500; 2 · 1.645² · 80/20000² · 1500².
    times = factor(counted([[80, 0, 0]], 1 / 20_000))[0]
    assert times == pytest.approx(2.4350, rel=1e-3)
