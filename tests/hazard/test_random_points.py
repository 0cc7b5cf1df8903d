"""Intervals from few release points that were drawn at random, against a known truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.hazard_samples import chances_of

from sassgis.grid import FloatArray, IntArray
from sassgis.hazard.curves import hazard_curves, rate_interval, wide_variance
from sassgis.hazard.design import arrivals, value_limits
from sassgis.hazard.risk import RiskTable
from sassgis.hazard.significance import SampledRates, chance_of_difference
from sassgis.hazard.sources import Sampled
from sassgis.inputs.presets import read_preset
from sassgis.settings.hazard_rules import Source, SourceCounts
from sassgis.settings.results import PASSAGE_DTYPE, ControlLine
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import Sample, reach_limits

POINTS, BLOCKS, SAMPLES = 12, 50, 4000
STATION = ControlLine("s", "station")
#: Share of the blocks of a point that come to a place, by its place in the area (0 to 1).
PLACES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "below all of it": lambda x: 0.3 + 0.4 * x,
    "close below": lambda x: 0.9 + 0.1 * x,
    "below the half": lambda x: np.where(x < 0.5, 0.8, 0.0),
    "below a third": lambda x: 0.5 * np.maximum(1.0 - ((x - 0.5) / 0.17) ** 2, 0.0),
    "few from anywhere": lambda x: np.full(x.shape, 0.002),
}


def drawn(share: Callable[[FloatArray], FloatArray], rng: np.random.Generator) -> IntArray:
    """Blocks that come from each point, of samples of points and of blocks."""
    return rng.binomial(BLOCKS, share(rng.random((SAMPLES, POINTS))))


def mean_share(share: Callable[[FloatArray], FloatArray]) -> float:
    return float(share((np.arange(100_000) + 0.5) / 100_000).mean())


def held(low: FloatArray, high: FloatArray, truth: float, came: IntArray) -> float:
    """Share of the samples with any block whose interval holds the truth."""
    some = came > 0
    return float(((low <= truth) & (truth <= high))[some].mean())


def source(area: str = "cliff", frequency: float = 1.0) -> Source:
    return Source(area, "block", frequency, POINTS * BLOCKS, BLOCKS, random_points=True)


def counts(came: IntArray) -> SourceCounts:
    """Each sample as a place of its own, at one energy."""
    k, k2 = came.sum(axis=1), (came**2).sum(axis=1)
    reached = np.flatnonzero(k)
    return SourceCounts(reached, k[reached, None], k2[reached, None])


@pytest.mark.parametrize("name", PLACES)
def test_intervals_of_a_dozen_points_hold_the_truth(name: str) -> None:
    """Two standard errors on both sides hold 90 to 94 % where more than a few blocks come."""
    came = drawn(PLACES[name], np.random.default_rng(1))
    truth = mean_share(PLACES[name])
    curves = hazard_curves([source()], [counts(came)], [0.0])
    low, high = (end[:, 0] for end in rate_interval(curves))
    assert ((low <= truth) & (truth <= high)).mean() >= 0.93
    sample = Sample(POINTS * BLOCKS, BLOCKS, POINTS, random_points=True)
    on_map = reach_limits(came.sum(axis=1), (came**2).sum(axis=1), sample)
    assert held(*on_map, truth, came.sum(axis=1)) >= 0.93
    assert (on_map[1] <= 1.0).all() and (on_map[0] >= 0.0).all()


def test_points_that_all_send_all_blocks_do_not_make_certain() -> None:
    """With 12 of 12 points nothing is known of a twelfth of the area."""
    share = PLACES["below the half"]
    came = drawn(lambda x: share(0.6 * x) / 0.8, np.random.default_rng(2))
    truth = 5.0 / 6.0
    curves = hazard_curves([source()], [counts(came)], [0.0])
    low, high = (end[:, 0] for end in rate_interval(curves))
    assert (curves.rate[:, 0] == 1.0).mean() > 0.1 and (curves.variance == 0.0).any()
    assert ((low <= truth) & (truth <= high)).mean() >= 0.93


def test_intervals_of_two_areas_hold_by_their_joint_degrees_of_freedom() -> None:
    rng = np.random.default_rng(3)
    one, two = (drawn(PLACES[name], rng) for name in ("below a third", "below the half"))
    curves = hazard_curves([source("a"), source("b", 0.4)], [counts(one), counts(two)], [0.0])
    truth = mean_share(PLACES["below a third"]) + 0.4 * mean_share(PLACES["below the half"])
    low, high = (end[:, 0] for end in rate_interval(curves))
    assert ((low <= truth) & (truth <= high)).mean() >= 0.93
    assert curves.drawn is not None
    both = np.flatnonzero((one > 0).any(axis=1) & (two > 0).any(axis=1))
    freedom = curves.drawn.freedom[both, 0]
    assert freedom.min() > POINTS - 1.001 and freedom.max() <= 2.0 * (POINTS - 1) + 1e-9
    # v² / Σ v_s² / ν_s, by hand.
    v = []
    for own, came in ((source(), one), (source("b", 0.4), two)):
        alone = hazard_curves([own], [counts(came)], [0.0])
        v.append(alone.variance[np.searchsorted(alone.places, both[0]), 0])
    assert freedom[0] == pytest.approx(sum(v) ** 2 / (v[0] ** 2 + v[1] ** 2) * (POINTS - 1))


def test_scenarios_from_the_same_points_have_no_more_freedom() -> None:
    came = drawn(PLACES["below a third"], np.random.default_rng(4))
    second = Source("cliff", "large", 2.0, POINTS * BLOCKS, BLOCKS, random_points=True)
    curves = hazard_curves([source(), second], [counts(came)] * 2, [0.0])
    alone = hazard_curves([source()], [counts(came)], [0.0])
    assert curves.drawn is not None and alone.drawn is not None
    assert (curves.drawn.freedom == POINTS - 1).all()
    np.testing.assert_allclose(curves.rate_of_one, 3.0 * alone.rate_of_one)
    for both, single in zip(rate_interval(curves), rate_interval(alone), strict=True):
        np.testing.assert_allclose(both, 3.0 * single)


def test_on_a_lattice_nothing_is_widened() -> None:
    own = Source("cliff", "block", 1.0, POINTS * BLOCKS, BLOCKS)
    came = drawn(PLACES["below a third"], np.random.default_rng(5))
    curves = hazard_curves([own], [counts(came)], [0.0])
    assert curves.drawn is None and np.array_equal(wide_variance(curves), curves.variance)


def passages(points: IntArray, energy: FloatArray) -> np.ndarray:
    rows = np.zeros(points.size, PASSAGE_DTYPE)
    rows["line"], rows["energy_trans_kj"] = points, energy
    return rows


def test_limits_of_design_values_hold_the_truth() -> None:
    """Of a third of the area blocks come, with energies of an exponential law."""
    rng, share, station = np.random.default_rng(6), PLACES["below a third"], STATION
    rate = 0.2 * mean_share(share)
    truth = 50.0 * np.log(rate * 100.0)
    inside = asked = 0
    for came in rng.binomial(BLOCKS, share(rng.random((150, POINTS)))):
        sums = ControlLineSums((station,))
        points = np.repeat(np.arange(POINTS), came)
        sums.add(passages(points, rng.exponential(50.0, points.size)), random_points=True)
        own = Sampled(source(frequency=0.2), SourceCounts.none(1), SourceCounts.none(1), sums)
        low, high = value_limits(arrivals([own], 0, "energy_kj"), 0.01, 0.95)
        if np.isfinite(low):
            asked += 1
            inside += low <= truth and not high < truth
    assert asked > 130 and inside / asked >= 0.92


def test_squares_at_a_line_are_those_of_points_by_hand() -> None:
    sums = ControlLineSums((STATION, STATION))
    rows = passages(np.array([0, 0, 0, 1, 1, 0]), np.array([1.0, 1.0, 9.0, 9.0, 9.0, 5.0]))
    rows["control_line"][-1] = 1
    sums.add(rows, random_points=True)
    of_blocks = ControlLineSums((STATION, STATION))
    of_blocks.add(rows, weight=2)
    for own, at_all, at_9 in ((sums, 9 + 4, 1 + 4), (of_blocks, 5 * 4, 3 * 4)):
        found = own.distribution(0, "energy_kj")
        assert found.squares[0] == at_all
        assert found.squares[np.searchsorted(found.histogram.edges, 8.0)] == at_9
    assert sums.distribution(1, "energy_kj").squares[0] == 1


def test_limits_of_the_risk_hold_the_truth() -> None:
    name = "below a third"
    came = drawn(PLACES[name], np.random.default_rng(7))
    curves = hazard_curves([source()], [counts(came)], [0.0])
    values, variances = ({"loss": own[:, 0][None]} for own in (curves.rate, curves.variance))
    table = RiskTable((), (source(),), ("low",), np.zeros((1, 0, 1)), values, variances)
    low, high = table.limits("loss")
    truth = mean_share(PLACES[name])
    assert ((low <= truth) & (truth <= high)).mean() >= 0.93


def test_two_samples_of_the_same_points_seldom_differ() -> None:
    """Even shares from a dozen points: a normal difference calls 7 % of them significant."""
    rng = np.random.default_rng(8)
    share, variance = [], []
    for _ in range(2):
        k = drawn(PLACES["below all of it"], rng) / BLOCKS
        share.append(k.mean(axis=1))
        variance.append(k.var(axis=1, ddof=1) / POINTS)
    of_a_block = 1.0 / (POINTS * BLOCKS)
    known, few = (
        chance_of_difference(
            *(SampledRates(s, v, of_a_block, freedom) for s, v in zip(share, variance, strict=True))
        )
        for freedom in (np.inf, POINTS - 1.0)
    )
    assert (known < 0.05).mean() > 0.06
    assert (few < 0.05).mean() == pytest.approx(0.05, abs=0.01)


def test_levels_from_few_points_are_less_certain() -> None:
    came = drawn(PLACES["below a third"], np.random.default_rng(9))
    preset = read_preset("ch-so")
    k, k2 = came.sum(axis=1), (came**2).sum(axis=1)
    reached = np.flatnonzero(k)
    n = len(preset.thresholds_kj)
    own = SourceCounts(reached, *(np.repeat(v[reached, None], n, axis=1) for v in (k, k2)))
    few = hazard_curves([source(frequency=0.1)], [own], preset.thresholds_kj)
    many = replace(few, drawn=None)
    found = [chances_of(curves, preset, in_part=True).changed_share for curves in (few, many)]
    assert found[0] > 1.02 * found[1]
