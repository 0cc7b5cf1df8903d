from __future__ import annotations

import numpy as np
import pytest

from sassgis.model.errors import InputError
from sassgis.model.results import ControlLine, Histogram, StopReason
from sassgis.report.figures import (
    convergence_figure,
    energy_profile_figure,
    fig9_figure,
    runout_counts_figure,
    runout_figure,
    runout_gap_figure,
    station_figure,
)
from sassgis.report.figures.runout_gap import quantile_rows


def histogram(counts: list[int], unit: str, width: float = 1.0) -> Histogram:
    return Histogram(np.arange(len(counts) + 1) * width, np.array(counts), unit)


COMPUTED = (
    histogram([0, 4, 6, 2, 0, 0], "m/s"),
    histogram([10, 2, 0], "Hz"),
    histogram([9, 2, 1], "m"),
)


def test_station_panels_hold_the_counts(find, texts) -> None:
    figure = station_figure("Camera 2", *COMPUTED, n=20)
    drawn = find(figure, "computed")
    assert [d.get_data().values.tolist() for d in drawn] == [h.counts.tolist() for h in COMPUTED]
    words = texts(figure)
    for word in ("Camera 2", "speed (m/s)", "rotation (Hz)", "passing height (m)", "12 of 20"):
        assert word in words
    assert "number of blocks" in words
    # Bins beyond the last rock are not shown; the open last bin is named where it holds rocks.
    assert figure.axes[0].get_xlim()[1] < 4.5
    assert len(find(figure, "open-bin")) == 1
    assert find(figure, "open-bin")[0].get_text() == "≥ 2"


def test_observed_of_another_number_is_compared_by_share(find, texts) -> None:
    observed = (
        histogram([0, 1, 1, 0, 0, 0], "m/s"),
        histogram([2, 0, 0], "Hz"),
        histogram([2, 0, 0], "m"),
    )
    figure = station_figure("Camera 2", *COMPUTED, observed=observed, n=20)
    solid, dashed = find(figure, "observed")[0], find(figure, "computed")[0]
    np.testing.assert_allclose(solid.get_data().values, [0, 50, 50, 0, 0, 0])
    np.testing.assert_allclose(dashed.get_data().values.sum(), 100.0)
    assert solid.get_linestyle() in ("-", "solid")
    assert dashed.get_linestyle() not in ("-", "solid")
    words = texts(figure)
    assert "share of the blocks" in words and "2 blocks" in words


def test_coarser_observed_bins_are_matched(find) -> None:
    observed = (histogram([3, 8, 1], "m/s", 2.0), COMPUTED[1], COMPUTED[2])
    figure = station_figure("x", *COMPUTED, observed=observed, n=12)
    solid, dashed = find(figure, "observed")[0], find(figure, "computed")[0]
    np.testing.assert_allclose(solid.get_data().edges, [0, 2, 4, 6])
    np.testing.assert_allclose(dashed.get_data().values, [4, 8, 0])
    np.testing.assert_allclose(solid.get_data().values, [3, 8, 1])


def test_histograms_that_cannot_be_compared_are_refused() -> None:
    shifted = Histogram(np.array([0.3, 1.3]), np.array([1]), "m/s")
    with pytest.raises(InputError, match="no bins in common"):
        station_figure("x", *COMPUTED, observed=(shifted, *COMPUTED[1:]), n=1)
    with pytest.raises(InputError, match="different units"):
        station_figure("x", *COMPUTED, observed=(histogram([1], "km/h"), *COMPUTED[1:]), n=1)
    two = Histogram(np.arange(3.0), np.zeros((2, 2), int), "m/s")
    with pytest.raises(InputError, match="one count for each bin"):
        station_figure("x", two, *COMPUTED[1:], n=1)


def test_station_that_no_rock_passes(texts) -> None:
    none = tuple(Histogram(h.edges, h.counts * 0, h.unit) for h in COMPUTED)
    words = texts(station_figure("x", *none, n=50))
    assert words.count("no block here") == 3 and "0 of 50" in words


def test_runout_bars_by_reason_and_exceedance(find, texts) -> None:
    values = np.array([10.0, 20.0, 20.0, 50.0, 100.0])
    reasons = np.array([4, 0, 1, 0, 2])
    figure = runout_figure(values, reasons, bin_m=10.0)
    curve = find(figure, "exceedance")[0]
    x, share = curve.get_data()
    # Share of rocks that get at least to 20 m: 4 of 5; to just beyond it: 2 of 5.
    at_20 = share[np.nonzero(x >= 20.0)[0][0]]
    beyond = share[np.nonzero(x > 20.0)[0][0]]
    assert (at_20, beyond) == (pytest.approx(80.0), pytest.approx(40.0))
    rest = find(figure, "reason-REST")[0].get_data()
    heights = rest.values - (rest.baseline if rest.baseline is not None else 0.0)
    assert heights.sum() == 2.0
    barrier = find(figure, "reason-BARRIER")[0].get_data()
    place = np.nonzero(barrier.values - barrier.baseline)[0]
    assert rest.edges[place].tolist() == [20.0]
    assert not find(figure, "reason-STEP_LIMIT")
    words = texts(figure)
    for word in ("at rest: 2", "stopped by a barrier: 1", "left the profile: 1"):
        assert word in words
    assert "1 block of 5 went on" in words


def test_runout_without_open_ends_has_no_warning(texts) -> None:
    assert "went on" not in texts(runout_figure(np.array([1.0, 2.0]), np.array([0, 1])))


@pytest.mark.parametrize("values", [[], [5.0], [5.0, 5.0]])
def test_runout_of_few_rocks(values: list[float], texts) -> None:
    words = texts(runout_figure(np.array(values), np.zeros(len(values), int)))
    assert ("no block" in words) == (not values)


def test_runout_counts(find) -> None:
    edges = np.array([0.0, 10.0, 20.0, 30.0])
    figure = runout_counts_figure(edges, {StopReason.REST: np.array([1, 2, 1])})
    x, share = find(figure, "exceedance")[0].get_data()
    np.testing.assert_allclose(share[1:], [100.0, 75.0, 25.0, 0.0])
    np.testing.assert_allclose(x[1:], edges)
    with pytest.raises(InputError, match="do not fit the bins"):
        runout_counts_figure(edges, {StopReason.REST: np.array([1, 2])})


def test_runouts_without_reason_or_number_are_refused() -> None:
    with pytest.raises(InputError, match="needs its reason"):
        runout_figure(np.array([1.0]), np.array([0, 1]))
    with pytest.raises(InputError, match="must be numbers"):
        runout_figure(np.array([np.nan]), np.array([0]))


S, Z = np.array([0.0, 50.0, 100.0]), np.array([160.0, 80.0, 60.0])
BINS = np.linspace(0.0, 100.0, 11)
QUANTILES = {0.95: np.linspace(500.0, 50.0, 10), 0.5: np.linspace(50.0, 5.0, 10)}


def test_energy_has_a_log_axis_and_named_curves(find, texts) -> None:
    control_lines = [(ControlLine("road", "station"), 80.0)]
    figure = energy_profile_figure(BINS, QUANTILES, S, Z, control_lines=control_lines)
    upper, lower = figure.axes
    assert upper.get_yscale() == "log"
    np.testing.assert_allclose(find(figure, "q0.95")[0].get_data().values, QUANTILES[0.95])
    np.testing.assert_allclose(find(figure, "slope")[0].get_xydata(), np.column_stack([S, Z]))
    assert lower.get_xlim() == (0.0, 100.0)
    words = texts(figure)
    for word in ("kinetic energy (kJ)", "median", "95 %", "road", "chainage (m)", "height (m)"):
        assert word in words


@pytest.mark.parametrize(("quantity", "label"), [("speed", "(m/s)"), ("height", "height (m)")])
def test_other_quantities_have_a_plain_axis(quantity, label, texts) -> None:
    figure = energy_profile_figure(BINS[:-1], QUANTILES, S, Z, quantity=quantity, title="Profile 3")
    assert figure.axes[0].get_yscale() == "linear"
    assert figure.axes[0].get_ylim()[0] == 0.0
    words = texts(figure)
    assert label in words and "Profile 3" in words


def test_energy_gaps_and_emptiness(find, texts) -> None:
    part = {0.5: np.where(np.arange(10) < 5, 8.0, np.nan), 0.9: np.full(10, np.nan)}
    assert "median" in texts(energy_profile_figure(BINS, part, S, Z))
    zero = {0.5: np.array([0.0, *np.full(9, 3.0)])}
    drawn = find(energy_profile_figure(BINS, zero, S, Z), "q0.5")[0].get_data().values
    assert np.isnan(drawn[0]) and drawn[1] == 3.0
    assert "no block passes" in texts(energy_profile_figure(BINS, {}, S, Z))
    with pytest.raises(InputError, match=r"quantile 0\.5 does not fit"):
        energy_profile_figure(BINS, {0.5: np.zeros(4)}, S, Z)


def test_fig9_has_a_surface_for_each_shape(find, texts) -> None:
    gamma, alpha = np.linspace(0.0, 180.0, 7), np.linspace(0.0, 90.0, 4)
    eta = np.outer(np.sin(np.radians(alpha)) ** 2, np.full(7, 70.0))
    figure = fig9_figure(gamma, alpha, [(0.76, eta), (0.40, eta / 2.0)])
    assert len(figure.axes) == 2
    words = texts(figure)
    for word in ("b/a = 0.76", "b/a = 0.40", "γ (°)", "α (°)", "(%)"):
        assert word in words
    surface = figure.axes[0].collections[0]
    assert surface.get_array().size == 6 * 3
    assert surface.get_array().max() == pytest.approx(70.0 * (1.0 + 0.75) / 2.0)
    with pytest.raises(InputError, match="does not fit the angles"):
        fig9_figure(gamma, alpha, [(0.5, eta.T)])
    with pytest.raises(InputError, match="at least one surface"):
        fig9_figure(gamma, alpha, [])


def test_convergence_is_sorted_with_intervals(texts) -> None:
    tolerances = np.array([1.0, 0.1, 0.5])
    values = np.array([12.0, 10.0, 11.0])
    series = {"run-out, 95 % (m)": (values, values - 1.0, values + 2.0)}
    figure = convergence_figure(tolerances, series)
    (ax,) = figure.axes
    line = ax.lines[0]
    np.testing.assert_allclose(line.get_xdata(), [0.1, 0.5, 1.0])
    np.testing.assert_allclose(line.get_ydata(), [10.0, 11.0, 12.0])
    bars = ax.containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose(bars[0][:, 1], [9.0, 12.0])
    assert ax.get_xscale() == "log"
    band = next(p for p in ax.patches if p.get_gid() == "finest")
    assert (band.get_y(), band.get_height()) == (9.0, 3.0)
    words = texts(figure)
    assert "run-out, 95 % (m)" in words and "segment tolerance (m)" in words


def test_convergence_without_series_or_with_wrong_ones(texts) -> None:
    assert "no data" in texts(convergence_figure(np.array([1.0]), {}))
    one = np.array([1.0])
    with pytest.raises(InputError, match="does not fit the tolerances"):
        convergence_figure(np.array([1.0, 2.0]), {"a": (one, one, one)})
    with pytest.raises(InputError, match="above zero"):
        convergence_figure(np.array([0.0]), {"a": (one, one, one)})


def test_gap_curves_table_and_stops(valley, find, texts) -> None:
    corner = np.array([valley.west, valley.north])
    seen, made = np.array([60.0, 80.0, np.nan]), np.array([70.0, 90.0, 110.0, 130.0])
    seen_xy = np.array([[100.0, -60.0], [110.0, -80.0]]) + corner
    made_xy = np.array([[100.0, -70.0]]) + corner
    figure = runout_gap_figure(seen, made, grid=valley, observed_xy=seen_xy, predicted_xy=made_xy)
    np.testing.assert_allclose(find(figure, "observed")[0].get_data()[1], [0, 50, 100])
    np.testing.assert_allclose(find(figure, "observed")[0].get_data()[0], [60, 60, 80])
    np.testing.assert_allclose(find(figure, "stops-observed")[0].get_xydata(), seen_xy)
    np.testing.assert_allclose(find(figure, "stops-predicted")[0].get_xydata(), made_xy)
    words = texts(figure)
    assert "2 observed rocks, 4 predicted rocks" in words
    assert "median | 70 | 100 | +30" in words


def test_gap_table() -> None:
    rows = {row[0]: row[1:] for row in quantile_rows(np.array([20.0]), np.array([17.5]))}
    assert rows["median"] == ("20.0", "17.5", "\u22122.5")
    assert quantile_rows(np.empty(0), np.array([1.0]))[2][1:] == ("–", "1.0", "–")


def test_gap_without_rocks_or_terrain(texts) -> None:
    assert "no data" in texts(runout_gap_figure(np.empty(0), np.empty(0)))
    with pytest.raises(InputError, match="only over a terrain"):
        runout_gap_figure(np.ones(1), np.ones(1), observed_xy=np.zeros((1, 2)))
