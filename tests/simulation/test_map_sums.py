"""Sums per cell are joined and read as the table of statistics says."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.settings.statistics_table import STATISTICS, SUMS, default_bins
from sassgis.simulation.accumulators import SourceSums
from sassgis.simulation.map_sums import MapSums, Sample, band_values, quantiles

EDGES = default_bins().edges
ARRIVAL = next(row for row in STATISTICS if row.stem == "arrival_time")


def sums_of(times: list[list[float]]) -> dict[str, np.ndarray]:
    """Sums of cells in which rocks arrived at some times (s); all else is 0."""
    n = len(times)
    out: dict[str, np.ndarray] = {}
    for kept in SUMS:
        bins = (EDGES[kept.name].size - 1,) if kept.reducer == "histogram" else ()
        out[kept.name] = np.zeros((n, *bins), kept.dtype)
    out["arrival"] = np.array([np.histogram(t, EDGES["arrival"])[0] for t in times], np.uint32)
    out["arrival_min"] = np.array([min(t, default=np.inf) for t in times])
    out["reach"] = np.array([len(t) for t in times])
    return out


def test_parts_are_joined_cell_by_cell() -> None:
    sums = MapSums(100)
    sums.add(np.array([7, 30]), sums_of([[8.0, 4.0], [2.0]]))
    # Cell 5 had no rock: it is left out. Cell 7 gets an earlier one, cell 30 a later.
    sums.add(np.array([5, 7, 30]), sums_of([[], [3.0], [2.5]]))
    assert sums.cells.tolist() == [7, 30]
    assert sums.column("arrival_min").tolist() == [3.0, 2.0]
    assert sums.column("reach").tolist() == [3, 2]
    want = np.histogram([8.0, 4.0, 3.0], EDGES["arrival"])[0]
    assert np.array_equal(sums.column("arrival")[0], want)


def test_many_cells_and_a_saved_state_keep_every_sum() -> None:
    rng = np.random.default_rng(1)
    sums, n = MapSums(5000), 3000
    times = rng.uniform(0.5, 60.0, n)
    for part in np.array_split(rng.permutation(n), 7):
        sums.add(part, sums_of([[t] for t in times[part]]))
    assert np.array_equal(sums.column("arrival_min"), times[sums.cells])
    again = MapSums.from_state(5000, sums.state())
    for name, values in sums.state().items():
        assert np.array_equal(again.state()[name], values), name
        assert again.state()[name].dtype == values.dtype, name


def test_more_blocks_are_counted_than_16_bits_can_hold() -> None:
    sums = MapSums(10)
    for blocks in (40_000, 30_000):
        more = sums_of([[2.0], [3.0]])
        more["reach"][0] = blocks
        more["arrival"][0] *= blocks
        sums.add(np.array([1, 2]), more)
    assert sums.column("arrival").sum(axis=1).tolist() == [70_000, 2]


def test_counts_of_a_source_stay_as_they_are_when_more_are_added() -> None:
    sums, ones = SourceSums(2), np.ones((2, 2), np.int64)
    sums.add(np.array([3, 5]), ones, ones)
    before = sums.counts()
    sums.add(np.array([4, 5]), ones, 7 * ones)
    assert before.places.tolist() == [3, 5] and (before.count == 1).all()
    after = sums.counts()
    assert after.places.tolist() == [3, 4, 5]
    assert after.count[:, 0].tolist() == [1, 1, 2] and after.square[:, 1].tolist() == [1, 7, 8]


@pytest.mark.parametrize("sign", [1, -1])
def test_counts_of_a_source_may_become_large(sign: int) -> None:
    sums, place, one = SourceSums(1), np.array([3]), np.array([[1]])
    largest = sign * np.array([[2**31 - 1]])
    for _ in range(3):
        sums.add(place, one, largest)
    sums.add(np.array([4]), one, one)
    found = sums.counts()
    assert found.count.tolist() == [[3], [1]] and found.square.tolist() == [3 * largest[0], [1]]


def test_the_early_quantile_of_counted_times() -> None:
    rng = np.random.default_rng(2)
    own = [np.sort(rng.gamma(4.0, 5.0, size)).tolist() for size in (1, 3, 40, 1000)]
    sums = MapSums(10)
    sums.add(np.arange(4), sums_of(own))
    found = band_values(ARRIVAL, sums, Sample(2000, 1, 2000, False), EDGES)
    assert list(found) == ["q5", "q50", "min"]
    edges = EDGES["arrival"]
    for k, times in enumerate(own):
        assert found["min"][k] == times[0]
        for band, p in (("q5", 0.05), ("q50", 0.5)):
            exact = times[int(np.ceil(p * len(times) - 1e-9)) - 1]
            i = int(np.searchsorted(edges, exact, side="right")) - 1
            assert max(edges[i], times[0]) <= found[band][k] <= edges[i + 1]


def test_no_quantile_is_beyond_the_extremes() -> None:
    counts, edges = np.array([[0, 10, 0]]), np.array([0.0, 1.0, 2.0, 3.0])
    shares = (0.01, 0.99)
    free = quantiles(counts, edges, shares)[:, 0]
    assert free == pytest.approx([1.01, 1.99])
    held = quantiles(counts, edges, shares, np.array([1.7]), np.array([1.4]))[:, 0]
    assert held.tolist() == [1.4, 1.7]
