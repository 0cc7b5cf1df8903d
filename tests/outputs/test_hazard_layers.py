from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.hazard_samples import chances_of, curves_of, swiss

from sassgis.grid import Grid
from sassgis.hazard.curves import energy_at, rate_interval
from sassgis.hazard.levels import hazard_level, intensity_class
from sassgis.hazard.sampling_error import rocks_factor
from sassgis.inputs.presets import preset_names, read_preset
from sassgis.outputs.layers.hazard_maps import hazard_layers
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset
from sassgis.settings.results import Band, RasterLayer
from sassgis.settings.settings import OutputSettings

PRESET = swiss()
SHAPE = (3, 4)
#: Without heights nothing is said of cells that no block reached.
GRID = Grid(np.full(SHAPE, np.nan), 0.0, 0.0, 5.0)
W = 1e-4
#: Cells 1, 6, 7, 10 and 11; nothing comes to the last but its count is kept.
COUNT = np.array([[900, 600, 200, 0], [200, 3, 0, 0], [90, 90, 50, 40], [1, 0, 0, 0], [0, 0, 0, 0]])
CURVES = HazardCurves(
    np.array([1, 6, 7, 10, 11]),
    np.array([0.0, 30.0, 100.0, 300.0]),
    COUNT * W,
    COUNT * W**2,
    np.where(COUNT[:, 0] > 0, W, 0.0),
)
CAME = [1, 6, 7, 10]


def layers_of(
    curves: HazardCurves, preset: HazardPreset, grid: Grid, width_m: float, **periods: Any
) -> tuple[RasterLayer, ...]:
    chances = chances_of(curves, preset, np.isfinite(grid.values))
    return hazard_layers(curves, chances, preset, grid, width_m, **periods)


@pytest.fixture(scope="module")
def layers() -> dict[str, RasterLayer]:
    made = layers_of(CURVES, PRESET, GRID, 5.0, return_periods=(30.0, 100.0, 300.0))
    return {layer.stem: layer for layer in made}


def bands(layer: RasterLayer) -> dict[str, Band]:
    return {band.name: band for band in layer.bands}


def flat(band: Band, where: list[int] = CAME) -> list[float]:
    return [float(v) for v in band.values.ravel()[where]]


def test_the_set_of_layers(layers: dict[str, RasterLayer]) -> None:
    assert list(layers) == [
        "hazard_level", "intensity_30", "intensity_100", "intensity_300", "intensity_extreme",
        "energy_at_return_period", "return_period", "frequency", "confidence",
    ]  # fmt: skip
    for layer in layers.values():
        for band in layer.bands:
            assert band.values.shape == SHAPE
            assert band.values.dtype == np.float32
            # No rock comes there: nothing is said.
            nowhere = np.delete(band.values.ravel(), CAME)
            assert np.isnan(nowhere).all(), (layer.stem, band.name)
        assert bool(layer.classes) != bool(layer.breaks)
        assert list(layer.breaks) == sorted(set(layer.breaks))
        assert "Reference width 5 m" in layer.note


@pytest.mark.parametrize("stem", ["hazard_level", "confidence", "intensity_30"])
def test_notes_tell_the_preset_and_what_is_unverified(
    layers: dict[str, RasterLayer], stem: str
) -> None:
    assert "Preset test (A preset of the tests). Preset test, unverified: " in layers[stem].note
    assert ("95 % intervals" in layers[stem].note) == (stem == "confidence")


def test_level_and_intensity(layers: dict[str, RasterLayer]) -> None:
    level = layers["hazard_level"]
    assert flat(level.bands[0]) == hazard_level(CURVES, PRESET)[:4].tolist()
    expected = [(k, c.label, c.hatched, c.colour) for k, c in enumerate(PRESET.levels, start=1)]
    assert [(c.value, c.label, c.hatched, c.colour) for c in level.classes] == expected
    for stem, years in (("30", 30.0), ("100", 100.0), ("300", 300.0), ("extreme", None)):
        layer = layers[f"intensity_{stem}"]
        codes = intensity_class(CURVES, PRESET, years)[:4]
        np.testing.assert_array_equal(flat(layer.bands[0]), np.where(codes > 0, codes, np.nan))
        labels = ["low (below 30 kJ)", "mean (30 to 300 kJ)", "high (300 kJ and more)"]
        assert [c.label for c in layer.classes] == labels
    # 4 of 10000 rocks a year above 300 kJ: not within 30 or 300 years... but 40 are.
    assert flat(layers["intensity_300"].bands[0])[2] == 3.0
    assert np.isnan(flat(layers["intensity_30"].bands[0])[3])


def test_energy_and_return_period(layers: dict[str, RasterLayer]) -> None:
    energy = layers["energy_at_return_period"]
    # Classes as on the other maps of energies.
    assert tuple(energy.breaks) == (0.0, *OutputSettings().energy_classes_kj)
    # The rarest is shown.
    assert [b.name for b in energy.bands] == ["e300", "e30", "e100"]
    for band, years in zip(energy.bands, (300.0, 30.0, 100.0), strict=True):
        np.testing.assert_allclose(flat(band), energy_at(CURVES, years)[:4], rtol=1e-6)
    period = bands(layers["return_period"])
    assert list(period) == ["t0", "t30", "t300"]
    np.testing.assert_allclose(flat(period["t0"]), [1e4 / 900, 50, 1e4 / 90, 1e4], rtol=1e-6)
    np.testing.assert_allclose(flat(period["t300"]), [np.nan, np.nan, 250, np.nan], rtol=1e-6)
    assert {b.unit for b in period.values()} == {"years"}


def test_frequency(layers: dict[str, RasterLayer]) -> None:
    found = bands(layers["frequency"])
    assert list(found)[:5] == ["rate_0", "standard_error_0", "lower_0", "upper_0", "rate_30"]
    assert len(found) == 12
    np.testing.assert_allclose(flat(found["rate_30"]), [0.06, 0.0003, 0.009, 0.0], rtol=1e-6)
    np.testing.assert_allclose(flat(found["standard_error_0"])[0], 30 * W, rtol=1e-6)
    lower, upper = rate_interval(CURVES)
    np.testing.assert_allclose(flat(found["lower_300"]), lower[:4, 3], rtol=1e-6)
    np.testing.assert_allclose(flat(found["upper_300"]), upper[:4, 3], rtol=1e-6)
    # A cell without rocks of that energy has an upper limit all the same: −ln(0.025) rocks.
    assert flat(found["upper_300"])[0] == pytest.approx(3.6889 * W, rel=1e-4)


def test_confidence(layers: dict[str, RasterLayer]) -> None:
    found = bands(layers["confidence"])
    chances = chances_of(CURVES, PRESET)
    lowest, highest = chances.interval(0.95)
    assert np.nan_to_num(flat(found["lowest_level"])).tolist() == lowest[:4].tolist()
    assert flat(found["highest_level"]) == highest[:4].tolist()
    np.testing.assert_allclose(flat(found["change_chance"]), chances.changed[:4], rtol=1e-6)
    uncertain = chances.uncertain(0.95)[:4]
    assert flat(found["uncertain"]) == uncertain.astype(float).tolist()
    # Both are among the four cells, or the test would say little.
    assert set(flat(found["uncertain"])) == {0.0, 1.0}
    np.testing.assert_allclose(
        flat(found["rocks_factor"]), rocks_factor(CURVES, PRESET, chances, 0.95)[:4], rtol=1e-6
    )
    assert [(c.value, c.label) for c in layers["confidence"].classes] == [
        (0, "statistically certain"),
        (1, "statistically uncertain"),
    ]


def test_untold_errors_are_missing_and_the_cell_uncertain() -> None:
    curves = curves_of([[0.02, 0.004, 0.0]], [[np.nan, np.nan, 0.0]], 1e-6)
    one_cell = Grid(np.full((1, 1), np.nan), 0.0, 0.0, 2.0)
    made = {
        layer.stem: bands(layer)
        for layer in layers_of(curves, PRESET, one_cell, 2.0, return_periods=(100.0,))
    }
    assert flat(made["frequency"]["rate_30"], [0]) == [pytest.approx(0.004)]
    assert np.isnan(flat(made["frequency"]["lower_30"], [0]))
    assert flat(made["confidence"]["uncertain"], [0]) == [1.0]
    assert np.isnan(flat(made["confidence"]["rocks_factor"], [0]))


@pytest.mark.parametrize("name", preset_names())
def test_every_built_in_preset_makes_maps(name: str) -> None:
    made = layers_of(CURVES, read_preset(name), GRID, 5.0, return_periods=())
    assert [layer.stem for layer in made][:2] == ["hazard_level", "intensity_extreme"]
    assert "unverified: no level beyond 10\u202f000 years" in made[0].note
