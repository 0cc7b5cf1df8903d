"""The table of statistics holds together."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.settings.statistics_table import (
    QUANTITIES,
    STATISTICS,
    SUM_NAMES,
    SUMS,
    default_bins,
    probability_of,
    wider,
)


def test_every_sum_is_kept_once_and_is_of_a_known_quantity() -> None:
    assert len(set(SUM_NAMES)) == len(SUMS)
    assert {s.quantity for s in SUMS} == {"", *QUANTITIES}
    assert len({row.stem for row in STATISTICS}) == len(STATISTICS)


@pytest.mark.parametrize("row", STATISTICS, ids=lambda row: row.stem)
def test_quantiles_have_a_histogram_and_the_first_band_is_in_the_title(row) -> None:
    shares = [p for b in row.bands if (p := probability_of(b)) is not None]
    histograms = {s.name for s in row.sums() if s.reducer == "histogram"}
    assert histograms == ({row.quantity} if shares else set())
    assert (row.edges is None) == (not shares)
    if shares:
        assert f"{100 * shares[0]:.0f} % quantile ({row.unit})" in row.title
        assert f"{100 * shares[0]:.0f} % quantile" in row.description(row.bands[0])


@pytest.mark.parametrize("strongest_kj", [300.0, 5000.0])
def test_edges_rise_from_0_and_those_of_a_larger_terrain_go_on(strongest_kj: float) -> None:
    limits = (0.0, 30.0, strongest_kj)
    small = default_bins(100.0, 10.0, 30.0, limits)
    large = default_bins(1e5, 200.0, 120.0, limits)
    assert set(small.edges) == set(large.edges) == set(QUANTITIES)
    for name, edges in small.edges.items():
        assert edges[0] == 0.0 and (np.diff(edges) > 0.0).all()
        # The last edge of speeds is open: beyond it is what the larger terrain has bins for.
        assert np.array_equal(large.edges[name][: edges.size], edges), name
    assert np.array_equal(large.threshold[: small.threshold.size], small.threshold)
    assert set(limits) <= set(small.threshold)


def test_edges_of_times_are_half_a_second_or_five_per_cent_apart() -> None:
    edges = default_bins().edges["arrival"]
    steps = np.diff(edges)
    assert steps.min() == pytest.approx(0.5) and edges[-1] >= 1800.0
    late = edges[:-1] >= 10.0
    assert steps[late] / edges[:-1][late] == pytest.approx(0.05)


def test_counts_keep_their_bins_on_a_larger_terrain() -> None:
    bins = default_bins(1e5, 200.0, 120.0)
    counts = np.arange(6, dtype=np.uint32).reshape(2, 3)
    out = wider("speed", counts, bins)
    assert out.shape == (2, bins.edges["speed"].size - 1) and out.dtype == counts.dtype
    assert np.array_equal(out[:, :3], counts) and not out[:, 3:].any()
    assert wider("speed_max", counts, bins) is counts
