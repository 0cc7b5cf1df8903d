"""Histograms as they are drawn."""

from __future__ import annotations

import numpy as np

from sassgis.settings.results import Histogram
from sassgis.simulation.control_lines import QUANTITIES, trimmed


def of(quantity: str, values: list[float]) -> Histogram:
    unit, edges = QUANTITIES[quantity]
    inside = np.clip(values, edges[0], np.nextafter(edges[-1], 0.0))
    return Histogram(edges, np.histogram(inside, edges)[0], unit)


def test_even_bins_begin_at_zero_and_end_beyond_the_largest_value() -> None:
    fine = of("speed_mps", [4.1, 7.3, 7.4, 22.0])
    drawn = trimmed(fine)
    assert drawn.edges[0] == 0.0 and np.ptp(np.diff(drawn.edges)) < 1e-12
    assert drawn.counts.sum() == 4 and drawn.counts.size <= 16
    # Nothing went beyond what is counted: the last bin, which would be open, is empty.
    assert drawn.counts[-1] == 0 and drawn.counts[-2] == 1
    np.testing.assert_array_equal(drawn.counts, np.histogram([4.1, 7.3, 7.4, 22.0], drawn.edges)[0])


def test_energies_keep_the_factor_between_their_edges() -> None:
    values = [0.9, 35.0, 400.0, 410.0, 9000.0]
    drawn = trimmed(of("energy_kj", values))
    factors = drawn.edges[1:] / drawn.edges[:-1]
    assert np.ptp(factors) < 1e-9 and drawn.counts.size <= 16
    assert drawn.edges[0] <= 0.9 < drawn.edges[1] and drawn.edges[-1] > 9000.0
    np.testing.assert_array_equal(drawn.counts, np.histogram(values, drawn.edges)[0])


def test_what_lies_beyond_the_last_bin_is_open() -> None:
    drawn = trimmed(of("speed_mps", [10.0, 1000.0]))
    assert drawn.counts[-1] == 1


def test_nothing_counted() -> None:
    for quantity in ("speed_mps", "energy_kj"):
        assert trimmed(of(quantity, [])).counts.sum() == 0
