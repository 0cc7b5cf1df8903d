"""Maps are Cloud-Optimised GeoTIFFs that say what they hold."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import rasterio
from helpers import made_up_result as made_up

from sassgis.errors import OutputError
from sassgis.grid import Grid
from sassgis.inputs.result_folder import level_classes
from sassgis.outputs.raster import NODATA, BlockMaps, finish_map, write_raster
from sassgis.settings.results import Band, RasterClass, RasterLayer


def layer_of(values: np.ndarray, unit: str = "kJ", **changes: object) -> RasterLayer:
    band = Band("a", "Some energy", unit, values.astype(np.float32))
    facts = {"breaks": (), "ramp": "viridis", "title": "A (kJ)", "note": "", **changes}
    return RasterLayer("a", bands=(band,), **facts)  # type: ignore[arg-type]


def flat(shape: tuple[int, int], crs: str = "") -> Grid:
    return Grid(np.zeros(shape), 100.0, 900.0, 5.0, crs, "LN02")


@pytest.fixture(scope="module")
def energy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RasterLayer]:
    dem = made_up.grid()
    layer = made_up.raster_layers(dem)["energy"]
    return write_raster(layer, dem, tmp_path_factory.mktemp("maps")), layer


def test_values_place_and_words_come_back(energy: tuple[Path, RasterLayer]) -> None:
    path, layer = energy
    with rasterio.open(path) as data:
        assert data.crs.to_epsg() == 2056
        assert data.bounds == (2_600_000.0, 1_199_200.0, 2_601_000.0, 1_200_000.0)
        assert data.dtypes == ("float32", "float32")
        assert data.nodata == NODATA
        assert data.units == ("kJ", "kJ")
        assert data.descriptions[1] == "Greatest energy (kJ)"
        assert data.tags(2)["NAME"] == "emax"
        tags = data.tags()
        assert tags["TITLE"] == layer.title
        assert "reference width 3 m" in tags["NOTE"]
        assert tags["VERTICAL_DATUM"] == "LN02"
        for number, band in enumerate(layer.bands, start=1):
            read = data.read(number, masked=True).filled(np.nan)
            np.testing.assert_array_equal(read, band.values)


def test_the_file_is_cloud_optimised_with_a_style(energy: tuple[Path, RasterLayer]) -> None:
    path, layer = energy
    with rasterio.open(path) as data:
        assert data.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert data.tags(ns="IMAGE_STRUCTURE")["COMPRESSION"] == "DEFLATE"
        assert data.overviews(1) == [2]
        assert data.block_shapes[0] == (256, 256)
        statistics = data.tags(1)
    root = ET.fromstring(path.with_suffix(".qml").read_text(encoding="utf-8"))
    labels = [item.get("label") for item in root.iter("item")]
    assert labels == ["< 30 kJ", "30 – 300 kJ", "≥ 300 kJ"]
    known = layer.bands[0].values[np.isfinite(layer.bands[0].values)]
    assert float(statistics["STATISTICS_MAXIMUM"]) == pytest.approx(known.max())
    assert float(statistics["STATISTICS_MINIMUM"]) == pytest.approx(known.min())


def two_lines(first: float, second: float) -> np.ndarray:
    """A wide and a narrow line of cells from north to south."""
    values = np.full((700, 700), np.nan)
    values[:, 100:104] = first
    values[:, 200] = second
    return values


@pytest.mark.parametrize("ramp", ["viridis", "hillshade", "classes"])
def test_overviews_invent_nothing(tmp_path: Path, ramp: str) -> None:
    values = two_lines(1.0, 3.0)
    layer = classes_of(values) if ramp == "classes" else layer_of(values, ramp=ramp)
    with rasterio.open(write_raster(layer, flat((700, 700)), tmp_path), overview_level=1) as data:
        read = data.read(1, masked=True)
    assert set(np.unique(read.compressed())) == {1.0, 3.0}
    if ramp == "classes":
        return
    assert read.mask.mean() > 0.95
    # A line of one cell is not lost from afar.
    assert (~read.mask[:, 50]).all()


def test_no_number_and_infinity_are_nodata(tmp_path: Path) -> None:
    values = np.array([[1.0, np.inf], [-np.inf, np.nan]])
    for breaks in ((), (30.0, 300.0)):
        for shown, mask in ((values, [False, True, True, True]), (values * np.nan, [True] * 4)):
            layer = layer_of(shown, breaks=breaks)
            with rasterio.open(write_raster(layer, flat((2, 2)), tmp_path)) as data:
                assert data.read(1, masked=True).mask.ravel().tolist() == mask
                assert data.crs is None


def test_equal_input_gives_equal_bytes(tmp_path: Path) -> None:
    dem = made_up.grid()
    for layer in made_up.raster_layers(dem).values():
        first, second = (write_raster(layer, dem, tmp_path / name) for name in "ab")
        assert first.read_bytes() == second.read_bytes()
        assert first.with_suffix(".qml").read_bytes() == second.with_suffix(".qml").read_bytes()


def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\(3, 4\)"):
        write_raster(layer_of(np.zeros((3, 4))), flat((4, 3)), tmp_path)
    with pytest.raises(ValueError, match=r"\[4\.0\], which are no classes"):
        write_raster(classes_of(np.array([[4.0, 1.0]])), flat((1, 2)), tmp_path)
    (tmp_path / "maps").write_text("in the way")
    with pytest.raises(OutputError, match=r"a\.tif: cannot be written"):
        write_raster(layer_of(np.zeros((2, 2))), flat((2, 2)), tmp_path / "maps")


LEVELS = (
    RasterClass(1, "residuo", "#ffdd00", hatched=True),
    RasterClass(2, "basso", "#ffdd00"),
    RasterClass(3, "elevato", "#e60000"),
)


def classes_of(values: np.ndarray, *more: Band, classes: tuple = LEVELS) -> RasterLayer:
    band = Band("level", "Level", "", values.astype(np.float32))
    return RasterLayer("a", "Level", "", (band, *more), (), "", classes)


def test_classes_are_bytes_that_keep_zero_and_nothing_apart(tmp_path: Path) -> None:
    values = np.array([[0.0, 1.0, 2.0], [3.0, np.nan, 3.0]])
    with rasterio.open(write_raster(classes_of(values), flat((2, 3)), tmp_path)) as data:
        assert (data.dtypes, data.nodata) == (("uint8",), 255)
        np.testing.assert_array_equal(data.read(1), [[0, 1, 2], [3, 255, 3]])
        assert data.tags(1)["CLASSES"] == "1 = residuo; 2 = basso; 3 = elevato"
        colours = data.colormap(1)
        assert data.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    # A hatch cannot be drawn on cells: half colour, half white.
    shown = [colours[value][:3] for value in (0, 1, 2, 3)]
    assert shown == [(255, 255, 255), (255, 238, 128), (255, 221, 0), (230, 0, 0)]


def test_classes_come_back_from_the_folder_whatever_their_labels(tmp_path: Path) -> None:
    labels = ("low; seldom", "mean = 2; often", "high")
    classes = tuple(replace(c, label=text) for c, text in zip(LEVELS, labels, strict=True))
    layer = replace(classes_of(np.array([[1.0, 3.0]]), classes=classes), stem="hazard_level")
    write_raster(layer, flat((1, 2)), tmp_path / "maps")
    found = [(c.value, c.label) for c in level_classes(tmp_path)]
    assert found == list(enumerate(labels, start=1))


TYPES = [(254, "uint8", 255), (255, "int16", -32768), (-1, "int16", -32768)]


@pytest.mark.parametrize(("number", "kind", "nodata"), [*TYPES, (32768, "int32", -(2**31))])
def test_the_type_holds_every_class(tmp_path: Path, number: int, kind: str, nodata: int) -> None:
    layer = classes_of(
        np.array([[number, np.nan]]), classes=(RasterClass(number, "it", "#123456"),)
    )
    with rasterio.open(write_raster(layer, flat((1, 2)), tmp_path)) as data:
        assert (data.dtypes, data.nodata) == ((kind,), nodata)
        assert data.read(1).tolist() == [[number, nodata]]


@pytest.mark.parametrize(
    ("beside", "kind", "nodata"), [(0.25, "float32", NODATA), (300.0, "int16", -32768)]
)
def test_numbers_beside_classes_are_not_rounded(
    tmp_path: Path, beside: float, kind: str, nodata: float
) -> None:
    more = Band("more", "More", "1", np.array([[beside, np.nan]], np.float32))
    layer = classes_of(np.array([[1.0, np.nan]]), more)
    with rasterio.open(write_raster(layer, flat((1, 2)), tmp_path)) as data:
        assert (data.dtypes, data.nodata) == ((kind, kind), nodata)
        assert data.read()[:, 0].tolist() == [[1.0, nodata], [beside, nodata]]


def test_the_style_of_classes_lists_the_most_severe_first(tmp_path: Path) -> None:
    path = write_raster(classes_of(np.array([[1.0, 2.0]])), flat((1, 2)), tmp_path)
    root = ET.fromstring(path.with_suffix(".qml").read_text(encoding="utf-8"))
    entries = [(e.get("value"), e.get("color"), e.get("label")) for e in root.iter("paletteEntry")]
    pale = ("1", "#ffee80", "residuo (pale)")
    assert entries == [("3", "#e60000", "elevato"), ("2", "#ffdd00", "basso"), pale]


def test_an_overview_is_made_of_the_one_before_however_wide_the_map(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    values = np.where(rng.random((260, 9000)) < 0.6, rng.random((260, 9000)), np.nan)
    wide = layer_of(values)
    wide = replace(wide, bands=tuple(replace(wide.bands[0], name=f"b{k}") for k in range(6)))
    with BlockMaps(flat(values.shape), tmp_path) as files:
        files.write(wide, 0, 0)
    (unfinished,) = files.unfinished
    finish_map(unfinished)
    with rasterio.open(unfinished.target, overview_level=0) as data:
        finer = data.read(1, masked=True).filled(np.nan).reshape(65, 2, 2250, 2)
    with rasterio.open(unfinished.target, overview_level=1) as data:
        read = data.read(1, masked=True).filled(np.nan)
    with warnings.catch_warnings(action="ignore"):
        mean = np.nanmean(finer, axis=(1, 3))
    np.testing.assert_allclose(read, mean, rtol=1e-5)
