from __future__ import annotations

import numpy as np
import pytest
from helpers.figure_parts import find, texts

from sassgis.report import figures
from sassgis.settings.results import ControlLine, Histogram, StopReason


def histogram(counts: list[int], unit: str, width: float = 1.0) -> Histogram:
    return Histogram(np.arange(len(counts) + 1) * width, np.array(counts), unit)


COMPUTED = (
    histogram([0, 4, 6, 2, 0, 0], "m/s"),
    histogram([10, 2, 0], "Hz"),
    histogram([9, 2, 1], "m"),
    Histogram(10.0 ** np.arange(4), np.array([3, 9, 0]), "kJ"),
)


def test_station_panels_hold_the_counts() -> None:
    figure = figures.station_figure("Camera 2", *COMPUTED, n=20)
    drawn = find(figure, "computed")
    assert [d.get_data().values.tolist() for d in drawn] == [h.counts.tolist() for h in COMPUTED]
    words = texts(figure)
    for word in ("rotation (Hz)", "kinetic energy (kJ)", "Camera 2", "12 of 20"):
        assert word in words
    # Bins beyond the last rock are not shown; the open last bin is named where it holds rocks.
    assert figure.axes[0].get_xlim()[1] < 4.5
    assert len(find(figure, "open-bin")) == 1
    assert find(figure, "open-bin")[0].get_text() == "≥ 2"


def test_station_that_no_rock_passes() -> None:
    none = tuple(Histogram(h.edges, h.counts * 0, h.unit) for h in COMPUTED)
    words = texts(figures.station_figure("x", *none, n=50))
    assert words.count("no block here") == 4 and "0 of 50" in words


EDGES = np.arange(0.0, 101.0, 1.0)


def counted(values: list[float], reasons: list[int]) -> dict[StopReason, np.ndarray]:
    return {
        r: np.histogram([v for v, own in zip(values, reasons, strict=True) if own == r], EDGES)[0]
        for r in StopReason
    }


def test_runout_bars_by_reason_and_exceedance() -> None:
    figure = figures.runout_figure(EDGES, counted([10.0, 20.0, 20.0, 50.0, 99.0], [4, 0, 1, 0, 2]))
    x, share = find(figure, "exceedance")[0].get_data()
    # One of five never started. Of the others all get at least to 20 m; beyond that metre 2 of 4.
    np.testing.assert_allclose(share[[0, 20, 21, 100]], [100.0, 100.0, 50.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(x, EDGES)
    rest = find(figure, "reason-REST")[0].get_data()
    assert (rest.values - rest.baseline).sum() == 2.0
    barrier = find(figure, "reason-BARRIER")[0].get_data()
    place = np.nonzero(barrier.values - barrier.baseline)[0]
    # Bars of 2 m: a thirtieth of 90 m, rounded to 1, 2 or 5.
    assert np.ptp(rest.edges[:2]) == 2.0 and rest.edges[place].tolist() == [20.0]
    assert not find(figure, "reason-STEP_LIMIT")
    words = texts(figure)
    for word in ("at rest: 2", "stopped by a barrier: 1", "left the profile: 1"):
        assert word in words
    assert "1 block of 4 was still moving" in words


@pytest.mark.parametrize("values", [[5.0], [5.0, 5.0]])
def test_runout_of_few_rocks(values: list[float]) -> None:
    words = texts(figures.runout_figure(EDGES, counted(values, [0] * len(values))))
    assert f"at rest: {len(values)}" in words and "still moving" not in words


S, Z = np.array([0.0, 50.0, 100.0]), np.array([160.0, 80.0, 60.0])
BINS = np.linspace(0.0, 100.0, 11)
QUANTILES = {0.95: np.linspace(500.0, 50.0, 10), 0.5: np.linspace(50.0, 5.0, 10)}


def test_energy_has_a_log_axis_and_named_curves() -> None:
    control_lines = [(ControlLine("road", "station"), 80.0)]
    figure = figures.energy_profile_figure(BINS, QUANTILES, S, Z, control_lines=control_lines)
    upper, lower = figure.axes
    assert upper.get_yscale() == "log"
    np.testing.assert_allclose(find(figure, "q0.95")[0].get_data().values, QUANTILES[0.95])
    np.testing.assert_allclose(find(figure, "slope")[0].get_xydata(), np.column_stack([S, Z]))
    assert lower.get_xlim() == (0.0, 100.0)
    words = texts(figure)
    for word in ("kinetic energy (kJ)", "median", "95 %", "road", "chainage (m)", "height (m)"):
        assert word in words


@pytest.mark.parametrize(
    ("quantity", "label", "name"),
    [("speed", "(m/s)", "Speed"), ("height", "height (m)", "Passing height")],
)
def test_other_quantities_have_a_plain_axis(quantity, label, name) -> None:
    figure = figures.energy_profile_figure(BINS, QUANTILES, S, Z, quantity=quantity)
    assert figure.axes[0].get_yscale() == "linear"
    assert figure.axes[0].get_ylim()[0] == 0.0
    words = texts(figure)
    assert label in words and f"{name} along the profile" in words


def test_energy_gaps_and_emptiness() -> None:
    part = {0.5: np.where(np.arange(10) < 5, 8.0, np.nan), 0.9: np.full(10, np.nan)}
    assert "median" in texts(figures.energy_profile_figure(BINS, part, S, Z))
    zero = {0.5: np.array([0.0, *np.full(9, 3.0)])}
    drawn = find(figures.energy_profile_figure(BINS, zero, S, Z), "q0.5")[0].get_data().values
    assert np.isnan(drawn[0]) and drawn[1] == 3.0
    assert "no block passes" in texts(figures.energy_profile_figure(BINS, {}, S, Z))
